"""Galerkin operators of coarser grids, element by element: K_c = sum P_e^T K_e P_e.

The element matrix of a coarse element is a sum over the fine elements that it joins. While the fine
matrix is filled, a rank sums the matrices of its own elements, level by level. Products of sparse
matrices would double the memory and need AIJ, which multiplies more slowly than BAIJ.
"""

from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from . import multigrid
from .element import NODES
from .matrix import scatter_adds, stored_values

#: Coarse elements whose entries are summed at a time.
BATCH = 512


class GalerkinMatrix:
    """The operator of a `NodeLevel` as a sum of element matrices of the finer level. Collective.

    It has the methods of an `InPlaceMatrix` that `pgran.space.matrix.fill` calls, and uses the
    entries of the unknowns at nodes, which come first.

    Parameters
    ----------
    fine, coarse : pgran.space.multigrid.NodeLevel
    batches : list of (ndarray, ndarray, ndarray, ndarray)
        For each batch of fine elements, the columns of the elements that this rank sums, (n,),
        their indices i and j, and their prescribed unknowns, field by field, (m, n) bool.
    blocked : bool
        Whether the matrix is BAIJ; AIJ otherwise.
    """

    entries = 0  # it adds none to the entries of the fine matrix
    #: (GalerkinMatrix, PETSc.Mat) of the next coarser grid, which `filling` fills too.
    coarser = None

    def __init__(self, fine, coarse, batches, blocked=True):
        self._level, self._dof, self._blocked = coarse, coarse.dof, blocked
        (of_x, kind_x, maps_x), (of_y, kind_y, maps_y) = (
            _children(fine, coarse, axis) for axis in range(2))
        i, j = (np.concatenate([batch[part] for batch in batches]) for part in (1, 2))
        corner, ends = (np.array([reach(of_x[i]), reach(of_y[j])]) for reach in (np.min, np.max))
        self._first, self._shape = corner, ends - corner + 1
        self._count = int(np.prod(self._shape))
        self._held, self._steps = self._prescribed(), []
        for columns, i, j, held in batches:
            steps = []
            target = (of_y[j] - corner[1]) * self._shape[0] + of_x[i] - corner[0]
            kind = kind_y[j] * len(maps_x) + kind_x[i]
            for number in np.unique(kind):
                chosen = np.flatnonzero(kind == number)
                up = np.kron(maps_y[number // len(maps_x)], maps_x[number % len(maps_x)])
                steps.append((_range(columns[chosen]), _range(target[chosen]), up.T.copy()))
            some = np.flatnonzero(held.any(axis=0))
            free = ~held[:, some].reshape(self._dof, NODES, -1)
            self._steps.append((steps, columns[some], free.astype(float)))

    def elements(self):
        """Return the local coarse elements as one of the ``batches`` of a coarser matrix."""
        columns = np.arange(self._count)
        j, i = np.divmod(columns, self._shape[0])
        return columns, self._first[0] + i, self._first[1] + j, self._held

    def create(self):
        """Return a new matrix of zeros, which belongs to the caller. Collective."""
        level, dof = self._level, self._dof
        size = level.held.size
        matrix = PETSc.Mat().create(comm=level.comm)
        matrix.setType(PETSc.Mat.Type.BAIJ if self._blocked else PETSc.Mat.Type.AIJ)
        matrix.setSizes(((size, None), (size, None)))
        matrix.setBlockSize(dof)
        matrix.setPreallocationNNZ([counts if self._blocked else np.repeat(dof * counts, dof)
                                    for counts in self._neighbours()])
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

    def _neighbours(self):
        """Maximum numbers of neighbours of owned nodes on this rank and on others, (n,) each."""
        level, widths, inside = self._level, [], []
        for low, high in level.range:
            index = np.arange(low, high)
            reach = np.where(index % 2 == 0, 2, 1)
            widths.append(2 * reach + 1)
            inside.append((low <= index - reach) & (index + reach < high))
        total = np.multiply.outer(widths[1], widths[0]).ravel()
        own = level.held.size // self._dof
        others = level.comm.tompi4py().allreduce(own) - own
        interior = np.logical_and.outer(inside[1], inside[0]).ravel()
        return [counts.astype(PETSc.IntType) for counts in (
            np.minimum(total, own), np.where(interior, 0, np.minimum(total, others)))]

    def _batches(self):
        """Slices of the local coarse elements that are complete rows."""
        step = max(1, BATCH // self._shape[0]) * self._shape[0]
        return [slice(start, min(start + step, self._count))
                for start in range(0, self._count, step)]

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

    def _prescribed(self):
        """The prescribed unknowns of the local coarse elements, field by field, (m, n)."""
        numbers, inverse = np.unique(self._numbers(slice(0, self._count)), return_inverse=True)
        flags, found = self._level.vector(), PETSc.Vec().createSeq(numbers.size)
        flags.setArray(self._level.held.astype(float))
        wanted = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        PETSc.Scatter().create(flags, wanted, found, None).scatter(flags, found)
        return found.getArray()[inverse].reshape(NODES * self._dof, -1) > 0.5

    def _find_positions(self, matrix):
        """Find the positions of the entries of the coarse element matrices in a matrix."""
        start, stop = matrix.getOwnershipRange()
        width = np.int64(matrix.getSize()[1])
        with stored_values(matrix) as arrays:
            lengths = [array.size for array in arrays]
            arrays[0][:], arrays[1][:] = np.arange(lengths[0]), lengths[0] + np.arange(lengths[1])
        begin, column, stored = matrix.getValuesCSR()
        self._ones = matrix.getDiagonal().array[self._level.held].astype(int)
        matrix.zeroEntries()
        key = np.repeat(np.arange(stop - start), np.diff(begin)) * width + column
        order = np.argsort(key)
        key, stored = key[order], stored[order].astype(np.int64)
        self._sums, known = [], {}
        for batch in self._batches():
            number, free = self._numbers(batch), ~self._held[:, batch]
            row, col = (self._in_order(part) for part in np.broadcast_arrays(
                number[:, None], number[None]))
            free = self._in_order(free[:, None] & free[None])
            local = (start <= row) & (row < stop)
            positions, inside = np.full(row.size, sum(lengths)), np.flatnonzero(free & local)
            positions[inside] = stored[np.searchsorted(
                key, (row[inside] - start) * width + col[inside])]
            remote = np.flatnonzero(free & ~local)
            remote = remote[np.argsort(row[remote], kind="stable")]
            rows, first = np.unique(row[remote], return_index=True)
            self._sums.append((
                batch, scatter_adds(0, positions, lengths, known), remote,
                [part.astype(PETSc.IntType) for part in (
                    rows, np.append(first, remote.size), col[remote])]))

    def _in_order(self, values):
        """Values (m, m, n) of rows and columns, field by field, in the order of `filling`."""
        parts = values.reshape(self._dof, NODES, self._dof, NODES, -1)
        return np.moveaxis(parts, 2, 1).ravel()

    @contextmanager
    def filling(self, matrix):
        """Give ``add(number, out)``, which adds the entries (n_all, n) of a batch. Collective."""
        dof = self._dof
        total = np.zeros((dof * dof, NODES, NODES, self._count))

        def add(number, out):
            fine = out[:(NODES * dof)**2].reshape(dof * dof, NODES, NODES, -1)
            steps, some, free = self._steps[number]
            if some.size:  # entries of prescribed unknowns, which no other matrix uses
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
            for batch, sums, remote, entries in self._sums:
                values = total[..., batch].ravel()
                for part, scatter in sums:
                    scatter.add(values, arrays[part])
                others.append((*entries, values[remote]))
            arrays[0][self._ones] = 1.0
        for rows, first, column, values in others:
            matrix.setValuesIJV(first, column, values, addv=True, rowmap=rows)
        matrix.assemble()


def first_batches(form):
    """Return the elements of a form that this rank owns as the ``batches`` of `GalerkinMatrix`."""
    grid, found = form.grid, []
    rows = grid.element_unknowns[:grid.blocks["P"].start]
    for batch in form.batches:
        chosen = grid.elements.owned
        chosen = chosen[(batch.start <= chosen) & (chosen < batch.stop)]
        found.append((chosen - batch.start, grid.element_i[chosen], grid.element_j[chosen],
                      form.held[rows[:, chosen]]))
    return found


class Hierarchy:
    """The operators of coarser grids for PCMG in the first split of PCFIELDSPLIT. Collective.

    ``ksp`` solves the entire system, and `WeakForm.jacobian` fills the matrices ``filled``. Raises
    `ParameterError` if options request more grids than the elements allow.
    """

    def __init__(self, ksp, form):
        self._ksp, self._up = ksp, []
        self._nodes = [multigrid.flow_level(form)]
        count = PETSc.Options().getInt("fieldsplit_0_pc_mg_levels", self._nodes[0].depth + 1)
        for _ in range(count - 1):
            self._nodes.append(self._nodes[-1].coarser())
        parts, batches = [], first_batches(form)
        for fine, coarse in zip(self._nodes, self._nodes[1:]):
            # The coarsest grid has a direct solver, which needs AIJ.
            parts.append(GalerkinMatrix(fine, coarse, batches, coarse is not self._nodes[-1]))
            batches = [parts[-1].elements()]
        self._operators = [part.create() for part in parts]
        chain = list(zip(parts, self._operators))
        for part, coarser in zip(parts, chain[1:]):
            part.coarser = coarser
        self.filled = chain[:1]

    def update(self, matrix, preconditioner):
        """Pass the operators of the latest Jacobian to PCMG."""
        first, finest = not self._up, len(self._operators)
        if first:
            self._ksp.setOperators(matrix, preconditioner)
            self._ksp.setUp()
        mg = self._ksp.getPC().getFieldSplitSubKSP()[0].getPC()
        if first:
            self._up = [coarse.interpolation(fine)
                        for fine, coarse in zip(self._nodes, self._nodes[1:])]
            for level, up in enumerate(self._up):
                mg.setMGInterpolation(finest - level, up)
        for level, operator in enumerate(self._operators, 1):
            mg.getMGSmoother(finest - level).setOperators(operator, operator)


def requested():
    """Return whether options request a `Hierarchy`."""
    wanted = {"pc_type": PETSc.PC.Type.FIELDSPLIT, "fieldsplit_0_pc_type": PETSc.PC.Type.MG,
              "fieldsplit_0_pc_mg_galerkin": "external"}
    return all(PETSc.Options().getString(name, "") == text for name, text in wanted.items())


def _children(fine, coarse, axis):
    """Coarse element and kind of each fine element, and the interpolation of each kind."""
    kept, count = coarse.kept[axis], fine.shape[axis]
    element = np.searchsorted(kept[2:-1:2], 2 * np.arange(count) + 1)
    ends, inner = coarse.at[axis], fine.at[axis]
    maps = np.array([multigrid.lagrange(np.repeat(ends[None, 2 * c:2 * c + 3], 3, axis=0),
                                        inner[2 * e:2 * e + 3]) for e, c in enumerate(element)])
    _, first, kind = np.unique(np.round(maps, 12), axis=0, return_index=True, return_inverse=True)
    return element, kind.ravel(), maps[first]


def _range(index):
    """``index`` (n,) as a slice if it is a range."""
    step = np.unique(np.diff(index))
    if index.size > 1 and step.size == 1 and step[0] > 0:
        return slice(index[0], index[-1] + 1, step[0])
    return index
