"""The Galerkin operator of the next coarser grid, element by element: K_c = sum P_e^T K_e P_e.

The spaces of the grids are nested, so the element matrix of a coarse element is a sum over the fine
elements that are joined in it. A rank sums those it owns, while the fine matrix is filled. Products
of sparse matrices would need as much memory again as the fine matrix.

`Hierarchy` gives PCMG this operator where ``-fieldsplit_0_pc_mg_galerkin external`` asks for it.
The operators of still coarser grids, which are small, are products of sparse matrices.
"""

from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from . import multigrid
from .element import NODES
from .matrix import BatchSum, stored_values

#: Coarse elements whose entries are summed at a time.
BATCH = 512


class GalerkinMatrix:
    """The operator of a coarse `NodeLevel` as a sum of fine element matrices. Collective.

    It has the methods of an `pgran.space.matrix.ElementMatrix` that `pgran.space.matrix.fill`
    calls; its entries are those of the unknowns at nodes, which come first.

    Parameters
    ----------
    form : pgran.space.weakform.WeakForm
    fine, coarse : pgran.space.multigrid.NodeLevel
        The nodes of the form's grid, with all unknowns at nodes, and those of joined elements.
    """

    #: It takes the entries that another matrix has.
    entries = 0

    def __init__(self, form, fine, coarse):
        grid, self._level, self._dof = form.grid, coarse, form.grid.dof
        owned = np.zeros(grid.n_elements, dtype=bool)
        owned[grid.elements.owned] = True
        along = [_children(fine, coarse, axis) for axis in range(2)]
        (of_x, kind_x, maps_x), (of_y, kind_y, maps_y) = along
        i, j = grid.element_i[owned], grid.element_j[owned]
        self._first = [of[index].min() for of, index in ((of_x, i), (of_y, j))]
        self._shape = [of[index].max() - first + 1 for of, index, first in zip(
            (of_x, of_y), (i, j), self._first)]
        self.count = int(np.prod(self._shape))
        held = form.held[:grid.n_flow].reshape(-1, self._dof)
        self._steps = []
        for batch in form.batches:
            steps, here = [], np.flatnonzero(owned[batch])
            i, j = grid.element_i[batch][here], grid.element_j[batch][here]
            target = (of_y[j] - self._first[1]) * self._shape[0] + of_x[i] - self._first[0]
            kind = kind_y[j] * len(maps_x) + kind_x[i]
            for one in np.unique(kind):
                chosen = np.flatnonzero(kind == one)
                up = np.kron(maps_y[one // len(maps_x)], maps_x[one % len(maps_x)])
                steps.append((_range(here[chosen]), _range(target[chosen]), up.T.copy()))
            free = ~held[grid.element_nodes[:, batch]]                     # (nodes, n, dof)
            some = np.flatnonzero(~free.all(axis=(0, 2)))
            self._steps.append((steps, some, np.moveaxis(free[:, some], 2, 0).astype(float)))

    def create(self):
        """Return a new matrix of zeros, which belongs to the caller. Collective."""
        level, dof = self._level, self._dof
        size = level.held.size
        matrix = PETSc.Mat().create(comm=level.comm)
        matrix.setType(PETSc.Mat.Type.AIJ)
        matrix.setSizes(((size, None), (size, None)))
        matrix.setBlockSize(dof)
        matrix.setPreallocationNNZ([np.repeat(most, dof) for most in self._most()])
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        for batch in self._batches():
            number = self._numbers(batch)                                   # (entries, n)
            n, m = number.shape
            matrix.setValuesIJV(
                (np.arange(n * m + 1) * n).astype(PETSc.IntType),
                np.repeat(number.T, n, axis=0).ravel().astype(PETSc.IntType),
                np.zeros(n * n * m), addv=True, rowmap=number.T.ravel().astype(PETSc.IntType))
        matrix.assemble()
        self._find_places(matrix)
        return matrix

    def _most(self):
        """Most entries of owned nodes in own columns, and in those of others, (n,) each."""
        level = self._level
        widths, inside = [], []
        for axis in range(2):
            (low, high), n = level.range[axis], level.shape[axis]
            index, wrap = np.arange(low, high), level.periodic[axis]
            corner = index % 2 == 0
            first, last = np.where(corner, index - 2, index - 1), np.where(
                corner, index + 2, index + 1)
            if not wrap:
                first, last = np.maximum(first, 0), np.minimum(last, 2 * n)
            widths.append(np.minimum(last - first + 1, 2 * n + (0 if wrap else 1)))
            inside.append((low <= first) & (last < high))
        total = np.multiply.outer(widths[1], widths[0]).ravel() * self._dof
        own = np.minimum(total, level.held.size)
        alone = np.logical_and.outer(inside[1], inside[0]).ravel()
        others = level.comm.tompi4py().allreduce(level.held.size) - level.held.size
        return own.astype(PETSc.IntType), np.where(
            alone, 0, np.minimum(total, others)).astype(PETSc.IntType)

    def _batches(self):
        """Slices of the local coarse elements, row by row where rows are long."""
        rows = max(1, BATCH // self._shape[0]) * self._shape[0]
        starts = range(0, self.count, rows)
        return [slice(start, min(start + rows, self.count)) for start in starts]

    def _numbers(self, batch):
        """The global numbers of the unknowns of local coarse elements, field by field, (m, n)."""
        level = self._level
        element = np.arange(batch.start, batch.stop)
        corner = [2 * (self._first[0] + element % self._shape[0]),
                  2 * (self._first[1] + element // self._shape[0])]
        a = np.arange(NODES)[:, None]
        i, j = (index + more for index, more in zip(corner, (a % 3, a // 3)))
        i, j = (index % (2 * n) if wrap else index for index, n, wrap in zip(
            (i, j), level.shape, level.periodic))
        return np.concatenate([level.number(i, j) * self._dof + field
                               for field in range(self._dof)])

    def _find_places(self, matrix):
        """Find where each entry of the coarse element matrices goes in the arrays of a matrix."""
        level, size = self._level, self._level.held.size
        start, stop = matrix.getOwnershipRange()
        width = matrix.getSize()[1]
        with stored_values(matrix) as arrays:
            lengths, last = [array.size for array in arrays], 0
            for array in arrays:
                array[:] = np.arange(last, last + array.size)
                last += array.size
        begin, column, place = matrix.getValuesCSR()
        matrix.zeroEntries()
        key = np.repeat(np.arange(size), np.diff(begin)) * np.int64(width) + column
        order = np.argsort(key)
        key, place = key[order], place[order].astype(np.int64)
        held = np.zeros(width, dtype=bool)
        held[np.concatenate(level.comm.tompi4py().allgather(
            start + np.flatnonzero(level.held)))] = True
        self._sums, known = [], {}
        for batch in self._batches():
            number = self._numbers(batch)
            row, col = np.broadcast_arrays(number[:, None], number[None])
            row, col = self._in_order(row), self._in_order(col)
            free, mine = ~(held[row] | held[col]), (start <= row) & (row < stop)
            where = np.full(row.size, last)
            inside = np.flatnonzero(free & mine)
            where[inside] = place[np.searchsorted(
                key, (row[inside] - start) * np.int64(width) + col[inside])]
            sums = [(0, BatchSum(slice(None), where, lengths[0], known))]
            beyond = np.flatnonzero((where >= lengths[0]) & (where < last))
            if beyond.size:
                sums.append((1, BatchSum(beyond, where[beyond] - lengths[0], lengths[1], known)))
            far = np.flatnonzero(free & ~mine)
            far = far[np.argsort(row[far], kind="stable")]
            rows, first = np.unique(row[far], return_index=True)
            self._sums.append((batch, sums, (far, *(part.astype(PETSc.IntType) for part in (
                rows, np.append(first, far.size), col[far])))))
        diagonal = start + np.flatnonzero(level.held)
        self._ones = place[np.searchsorted(key, (diagonal - start) * np.int64(width) + diagonal)]

    def _in_order(self, values):
        """Bring values (m, m, n) of rows and columns field by field to the order of `filling`."""
        parts = values.reshape(self._dof, NODES, self._dof, NODES, -1)
        return np.moveaxis(parts, 2, 1).ravel()

    @contextmanager
    def filling(self, matrix):
        """Give ``add(number, out)``, which adds the entries (n_all, n) of a batch. Collective."""
        dof = self._dof
        total = np.zeros((dof * dof, NODES, NODES, self.count))

        def add(number, out):
            fine = out[:(NODES * dof)**2].reshape(dof * dof, NODES, NODES, -1)
            steps, some, free = self._steps[number]
            if some.size:  # prescribed unknowns
                both = free[:, None, :, None] * free[None, :, None, :]
                fine[..., some] *= both.reshape(dof * dof, NODES, NODES, -1)
            for chosen, target, down in steps:
                part = np.matmul(down, fine[..., chosen].reshape(dof * dof * NODES, NODES, -1))
                part = np.matmul(down, part.reshape(dof * dof, NODES, -1))
                total[..., target] += part.reshape(dof * dof, NODES, NODES, -1)

        yield add
        others = []
        with stored_values(matrix) as arrays:
            for array in arrays:
                array[:] = 0.0
            for batch, sums, (far, *places) in self._sums:
                values = total[..., batch].ravel()
                for part, batch_sum in sums:
                    batch_sum.add(values, arrays[part])
                others.append((*places, values[far]))
            arrays[0][self._ones] = 1.0
        for rows, first, column, values in others:
            matrix.setValuesIJV(first, column, values, addv=True, rowmap=rows)
        matrix.assemble()


class Hierarchy:
    """The operators of coarser grids for PCMG in the first split of PCFIELDSPLIT. Collective.

    Parameters
    ----------
    ksp : PETSc.KSP
        Of the whole system.
    form : pgran.space.weakform.WeakForm

    Attributes
    ----------
    filled : list of (GalerkinMatrix, PETSc.Mat)
        What `pgran.space.weakform.WeakForm.jacobian` fills besides the Jacobian.
    """

    def __init__(self, ksp, form):
        self._ksp, self._split, self._up = ksp, ksp.getPC(), None
        names = ["velocity", "fluidity"] if form.grid.has_fluidity else ["velocity"]
        self._nodes, self.filled, self._operators = [multigrid.node_level(form, names)], [], []
        if self._nodes[0].coarsenings:
            self._nodes.append(self._nodes[0].coarser())
            part = GalerkinMatrix(form, *self._nodes)
            self._operators.append(part.create())
            self.filled.append((part, self._operators[0]))

    def update(self, matrix, preconditioner):
        """Hand over the operators that belong to the Jacobian that was filled last."""
        if self._up is None:
            self._ksp.setOperators(matrix, preconditioner)
            self._ksp.setUp()
            self._begin(self._multigrid())
        mg = self._multigrid()
        for coarser, up in enumerate(self._up[1:], 1):
            finer, known = self._operators[coarser - 1], self._operators[coarser:coarser + 1]
            operator = finer.ptap(up, *known)
            if not known:
                self._operators.append(operator)
        for coarser, operator in enumerate(self._operators[:len(self._up)], 1):
            mg.getMGSmoother(len(self._up) - coarser).setOperators(operator, operator)

    def _multigrid(self):
        return self._split.getFieldSplitSubKSP()[0].getPC()

    def _begin(self, mg):
        """Make the interpolations, from the finest one on."""
        self._up, count = [], mg.getMGLevels()
        for coarser in range(1, count):
            if coarser == len(self._nodes):
                self._nodes.append(self._nodes[-1].coarser())
            self._up.append(self._nodes[coarser].interpolation(self._nodes[coarser - 1]))
            mg.setMGInterpolation(count - coarser, self._up[-1])


def asked(prefix=""):
    """Return whether options ask for a `Hierarchy`; ``prefix`` is that of the whole system."""
    wanted = {"pc_type": PETSc.PC.Type.FIELDSPLIT, "fieldsplit_0_pc_type": PETSc.PC.Type.MG,
              "fieldsplit_0_pc_mg_galerkin": "external"}
    return all(PETSc.Options().getString(prefix + name, "") == text
               for name, text in wanted.items())


def _children(fine, coarse, axis):
    """How fine elements are joined along one direction.

    Returns the coarse element of each fine one, (n,), its kind, (n,), and for each kind the matrix
    (3, 3) that takes values at the coarse nodes to the fine ones.
    """
    kept, count = coarse.kept[axis], fine.shape[axis]
    element = np.searchsorted(kept[2:-1:2], 2 * np.arange(count) + 1)
    ends, inner = coarse.at[axis], fine.at[axis]
    maps = np.array([multigrid.lagrange(np.repeat(ends[None, 2 * c:2 * c + 3], 3, axis=0),
                                        inner[2 * e:2 * e + 3]) for e, c in enumerate(element)])
    maps, kind = np.unique(np.round(maps, 12), axis=0, return_inverse=True)
    return element, kind.ravel(), maps


def _range(index):
    """``index`` (n,) as a slice where it is a range with one step."""
    step = np.unique(np.diff(index))
    if index.size > 1 and step.size == 1 and step[0] > 0:
        return slice(index[0], index[-1] + 1, step[0])
    return index
