"""Galerkin operators of coarser grids, element by element: K_c = sum P_e^T K_e P_e.

The spaces of the grids are nested, so the element matrix of a coarse element is a sum over the fine
elements that are joined in it. While the fine matrix is filled, a rank sums those it owns, and from
these sums those of still coarser grids. Products of sparse matrices would need as much memory again
as the fine matrix, and another format than that which multiplies fastest.

`Hierarchy` gives PCMG these operators where ``-fieldsplit_0_pc_mg_galerkin external`` asks for it.
"""

from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from . import multigrid
from .element import NODES
from .matrix import ScatterAdd, stored_values

#: Coarse elements whose entries are summed at a time.
BATCH = 512


class GalerkinMatrix:
    """The operator of a `NodeLevel` as a sum of matrices of elements that it joins. Collective.

    It has the methods of a `pgran.space.matrix.InPlaceMatrix` that `pgran.space.matrix.fill` calls;
    its entries are those of the unknowns at nodes, which come first.

    Parameters
    ----------
    fine, coarse : pgran.space.multigrid.NodeLevel
        Two grids, the second one of joined elements.
    batches : list of (ndarray, ndarray, ndarray, ndarray)
        Of each batch of fine elements the columns of those that this rank sums, (n,), their indices
        i and j, and which of their unknowns are prescribed, field by field, (m, n) bool.
    blocked : bool
        Whether the matrix is BAIJ; AIJ otherwise.

    Attributes
    ----------
    coarser : tuple of (GalerkinMatrix, PETSc.Mat), or None
        The operator of the next coarser grid, which `filling` fills too.
    held : ndarray of bool, (m, n)
        Which unknowns of the local coarse elements are prescribed, field by field.
    """

    #: It takes the entries that another matrix has.
    entries = 0

    def __init__(self, fine, coarse, batches, blocked=True):
        self._level, self._dof, self._blocked, self.coarser = coarse, coarse.dof, blocked, None
        (of_x, kind_x, maps_x), (of_y, kind_y, maps_y) = (
            _children(fine, coarse, axis) for axis in range(2))
        i, j = (np.concatenate([batch[part] for batch in batches]) for part in (1, 2))
        corner, ends = (np.array([reach(of_x[i]), reach(of_y[j])]) for reach in (np.min, np.max))
        self._first, self._shape = corner, ends - corner + 1
        self.held = self._held()
        self._steps = []
        for columns, i, j, held in batches:
            steps = []
            target = (of_y[j] - corner[1]) * self._shape[0] + of_x[i] - corner[0]
            kind = kind_y[j] * len(maps_x) + kind_x[i]
            for one in np.unique(kind):
                chosen = np.flatnonzero(kind == one)
                up = np.kron(maps_y[one // len(maps_x)], maps_x[one % len(maps_x)])
                steps.append((_range(columns[chosen]), _range(target[chosen]), up.T.copy()))
            some = np.flatnonzero(held.any(axis=0))
            free = ~held[:, some].reshape(self._dof, NODES, -1)
            self._steps.append((steps, columns[some], free.astype(float)))

    @property
    def count(self):
        """How many coarse elements have matrices on this rank."""
        return int(np.prod(self._shape))

    def elements(self):
        """Return the local coarse elements as one batch, as ``batches`` has them."""
        columns = np.arange(self.count)
        j, i = np.divmod(columns, self._shape[0])
        return columns, self._first[0] + i, self._first[1] + j, self.held

    def create(self):
        """Return a new matrix of zeros, which belongs to the caller. Collective."""
        level, dof = self._level, self._dof
        size = level.held.size
        matrix = PETSc.Mat().create(comm=level.comm)
        matrix.setType(PETSc.Mat.Type.BAIJ if self._blocked else PETSc.Mat.Type.AIJ)
        matrix.setSizes(((size, None), (size, None)))
        matrix.setBlockSize(dof)
        matrix.setPreallocationNNZ([most if self._blocked else np.repeat(dof * most, dof)
                                    for most in self._most()])
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        for batch in self._batches():
            number = self._numbers(batch)
            m, n = number.shape
            matrix.setValuesIJV(
                (np.arange(n * m + 1) * m).astype(PETSc.IntType),
                np.repeat(number.T, m, axis=0).ravel().astype(PETSc.IntType),
                np.zeros(m * m * n), addv=True, rowmap=number.T.ravel().astype(PETSc.IntType))
        matrix.assemble()
        self._find_positions(matrix)
        return matrix

    def _most(self):
        """Most neighbours of owned nodes, among own ones and among those of others, (n,) each."""
        level = self._level
        widths, inside = [], []
        for (low, high), n, wrap in zip(level.range, level.shape, level.periodic):
            index = np.arange(low, high)
            reach = np.where(index % 2 == 0, 2, 1)
            first, last = index - reach, index + reach
            if not wrap:
                first, last = np.maximum(first, 0), np.minimum(last, 2 * n)
            widths.append(np.minimum(last - first + 1, 2 * n + (0 if wrap else 1)))
            inside.append((low <= first) & (last < high))
        total = np.multiply.outer(widths[1], widths[0]).ravel()
        own = level.held.size // self._dof
        others = level.comm.tompi4py().allreduce(own) - own
        alone = np.logical_and.outer(inside[1], inside[0]).ravel()
        return (np.minimum(total, own).astype(PETSc.IntType),
                np.where(alone, 0, np.minimum(total, others)).astype(PETSc.IntType))

    def _batches(self):
        """Slices of the local coarse elements, whole rows of them."""
        step = max(1, BATCH // self._shape[0]) * self._shape[0]
        return [slice(start, min(start + step, self.count))
                for start in range(0, self.count, step)]

    def _numbers(self, batch):
        """The global numbers of the unknowns of local coarse elements, field by field, (m, n)."""
        level, a = self._level, np.arange(NODES)[:, None]
        element = np.arange(batch.start, batch.stop)
        i, j = (2 * (first + index) + more for first, index, more in zip(
            self._first, np.divmod(element, self._shape[0])[::-1], (a % 3, a // 3)))
        i, j = (index % (2 * n) if wrap else index for index, n, wrap in zip(
            (i, j), level.shape, level.periodic))
        return np.concatenate([level.number(i, j) * self._dof + field
                               for field in range(self._dof)])

    def _held(self):
        """Which unknowns of the local coarse elements are prescribed, field by field, (m, n)."""
        numbers, place = np.unique(self._numbers(slice(0, self.count)), return_inverse=True)
        flags, found = self._level.vector(), PETSc.Vec().createSeq(numbers.size)
        flags.setArray(self._level.held.astype(float))
        wanted = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        PETSc.Scatter().create(flags, wanted, found, None).scatter(flags, found)
        return found.getArray()[place].reshape(NODES * self._dof, -1) > 0.5

    def _find_positions(self, matrix):
        """Find where each entry of the coarse element matrices goes in the arrays of a matrix."""
        size = self._level.held.size
        start, stop = matrix.getOwnershipRange()
        width = np.int64(matrix.getSize()[1])
        with stored_values(matrix) as arrays:
            lengths, last = [array.size for array in arrays], 0
            for array in arrays:
                array[:] = np.arange(last, last + array.size)
                last += array.size
        begin, column, place = matrix.getValuesCSR()
        matrix.zeroEntries()
        key = np.repeat(np.arange(size), np.diff(begin)) * width + column
        order = np.argsort(key)
        key, place = key[order], place[order].astype(np.int64)
        self._sums, known = [], {}
        for batch in self._batches():
            number, free = self._numbers(batch), ~self.held[:, batch]
            row, col = (self._in_order(part) for part in np.broadcast_arrays(
                number[:, None], number[None]))
            free = self._in_order(free[:, None] & free[None])
            mine = (start <= row) & (row < stop)
            where, inside = np.full(row.size, last), np.flatnonzero(free & mine)
            where[inside] = place[np.searchsorted(
                key, (row[inside] - start) * width + col[inside])]
            sums = [(0, ScatterAdd(slice(None), where, lengths[0], known))]
            beyond = np.flatnonzero((where >= lengths[0]) & (where < last))
            if beyond.size:
                sums.append((1, ScatterAdd(beyond, where[beyond] - lengths[0], lengths[1], known)))
            far = np.flatnonzero(free & ~mine)
            far = far[np.argsort(row[far], kind="stable")]
            rows, first = np.unique(row[far], return_index=True)
            self._sums.append((batch, sums, far, [part.astype(PETSc.IntType) for part in (
                rows, np.append(first, far.size), col[far])]))
        diagonal = np.flatnonzero(self._level.held)
        self._ones = place[np.searchsorted(key, diagonal * width + start + diagonal)]

    def _in_order(self, values):
        """Bring values (m, m, n) of rows and columns field by field to the order of `filling`."""
        parts = values.reshape(self._dof, NODES, self._dof, NODES, -1)
        return np.moveaxis(parts, 2, 1).ravel()

    @contextmanager
    def filling(self, matrix):
        """Give ``add(number, out)``, which adds the entries (n_all, n) of a batch. Collective.

        Entries of prescribed unknowns, which no other matrix takes, become zero in ``out``.
        """
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
        self._write(total, matrix)
        if self.coarser:
            part, other = self.coarser
            with part.filling(other) as add_all:
                add_all(0, total.reshape((NODES * dof)**2, -1))

    def _write(self, total, matrix):
        """Sum the matrices of coarse elements, blocks by (nodes, nodes, n), into a matrix."""
        others = []
        with stored_values(matrix) as arrays:
            for array in arrays:
                array[:] = 0.0
            for batch, sums, far, places in self._sums:
                values = total[..., batch].ravel()
                for part, batch_sum in sums:
                    batch_sum.add(values, arrays[part])
                others.append((*places, values[far]))
            arrays[0][self._ones] = 1.0
        for rows, first, column, values in others:
            matrix.setValuesIJV(first, column, values, addv=True, rowmap=rows)
        matrix.assemble()


def first_batches(form):
    """Return the elements of a form that this rank owns, as `GalerkinMatrix` takes them."""
    grid, found = form.grid, []
    owned = np.zeros(grid.n_elements, dtype=bool)
    owned[grid.elements.owned] = True
    rows = np.concatenate([grid.element_unknowns[grid.blocks[name]] for name in grid.fields])
    for batch in form.batches:
        columns = np.flatnonzero(owned[batch])
        found.append((columns, grid.element_i[batch][columns], grid.element_j[batch][columns],
                      form.held[rows[:, batch][:, columns]]))
    return found


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

    Raises
    ------
    ParameterError
        If options ask for more grids than the elements allow.
    """

    def __init__(self, ksp, form):
        self._ksp, self._split, self._up = ksp, ksp.getPC(), None
        names = ["velocity", "fluidity"] if form.grid.has_fluidity else ["velocity"]
        self._nodes = [multigrid.node_level(form, names)]
        count = PETSc.Options().getInt("fieldsplit_0_pc_mg_levels", self._nodes[0].depth + 1)
        for _ in range(count - 1):
            self._nodes.append(self._nodes[-1].coarser())
        parts, batches = [], first_batches(form)
        for fine, coarse in zip(self._nodes, self._nodes[1:]):
            # The coarsest grid has a direct solver.
            parts.append(GalerkinMatrix(fine, coarse, batches, coarse is not self._nodes[-1]))
            batches = [parts[-1].elements()]
        self._operators = [part.create() for part in parts]
        chain = list(zip(parts, self._operators))
        for part, coarser in zip(parts, chain[1:]):
            part.coarser = coarser
        self.filled = chain[:1]

    def update(self, matrix, preconditioner):
        """Hand over the operators that belong to the Jacobian that was filled last."""
        if self._up is None:
            self._ksp.setOperators(matrix, preconditioner)
            self._ksp.setUp()
        mg, count = self._split.getFieldSplitSubKSP()[0].getPC(), len(self._nodes)
        if self._up is None:
            self._up = [coarse.interpolation(fine)
                        for fine, coarse in zip(self._nodes, self._nodes[1:])]
            for coarser, up in enumerate(self._up, 1):
                mg.setMGInterpolation(count - coarser, up)
        for coarser, operator in enumerate(self._operators, 1):
            mg.getMGSmoother(count - 1 - coarser).setOperators(operator, operator)


def asked():
    """Return whether options ask for a `Hierarchy`."""
    wanted = {"pc_type": PETSc.PC.Type.FIELDSPLIT, "fieldsplit_0_pc_type": PETSc.PC.Type.MG,
              "fieldsplit_0_pc_mg_galerkin": "external"}
    return all(PETSc.Options().getString(name, "") == text
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
    _, one, kind = np.unique(np.round(maps, 12), axis=0, return_index=True, return_inverse=True)
    return element, kind.ravel(), maps[one]


def _range(index):
    """``index`` (n,) as a slice where it is a range with one step."""
    step = np.unique(np.diff(index))
    if index.size > 1 and step.size == 1 and step[0] > 0:
        return slice(index[0], index[-1] + 1, step[0])
    return index
