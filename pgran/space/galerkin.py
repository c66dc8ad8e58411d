"""Galerkin operators of coarser grids, element by element: K_c = sum P_e^T K_e P_e.

The element matrix of a coarse element is a sum over the fine elements that it joins. While the fine
matrix is filled, a rank sums the matrices of its own elements, level by level. Products of sparse
matrices would double the memory and need AIJ, which multiplies more slowly than BAIJ.
"""

from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from . import multigrid
from .element import element
from .grid import indices
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
    batches : list of (ndarray, ndarray, ndarray)
        For each batch of fine elements, the columns of the elements that this rank sums, (n,),
        their indices (dim, n), and their prescribed unknowns, field by field, (m, n) bool.
    blocked : bool
        Whether the matrix is BAIJ; AIJ otherwise.
    """

    entries = 0  # it adds none to the entries of the fine matrix
    #: (GalerkinMatrix, PETSc.Mat) of the next coarser grid, which `filling` fills too.
    coarser = None

    def __init__(self, fine, coarse, batches, blocked=True):
        self._level, self._dof, self._blocked = coarse, coarse.dof, blocked
        self._element = element(len(coarse.at))
        parents, kinds, maps = zip(*(
            _children(fine, coarse, axis) for axis in range(self._element.dim)))
        fine_index = np.concatenate([index for _, index, _ in batches], axis=1)
        parent = [of[index] for of, index in zip(parents, fine_index)]
        self._ranges = [(of.min(), of.max() + 1) for of in parent]
        self._shape = [stop - start for start, stop in self._ranges]
        self._count = int(np.prod(self._shape))
        self._index = indices(self._ranges)
        self._held, self._steps = self._prescribed(), []
        for columns, index, held in batches:
            steps, target, kind, stride = [], 0, 0, 1
            for axis, along in enumerate(index):
                target = target + (parents[axis][along] - self._ranges[axis][0]) * stride
                kind = kind * len(maps[axis]) + kinds[axis][along]
                stride *= self._shape[axis]
            for number in np.unique(kind):
                chosen = np.flatnonzero(kind == number)
                up = np.ones((1, 1))
                for one, along in zip(maps, np.unravel_index(number, [len(one) for one in maps])):
                    up = np.kron(one[along], up)
                steps.append((_range(columns[chosen]), _range(target[chosen]), up.T.copy()))
            some = np.flatnonzero(held.any(axis=0))
            free = ~held[:, some].reshape(self._dof, self._element.nodes, -1)
            self._steps.append((steps, columns[some], free.astype(float)))

    def elements(self):
        """Return the local coarse elements as one of the ``batches`` of a coarser matrix."""
        return np.arange(self._count), self._index, self._held

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
        level = self._level
        index = indices(level.ranges)
        reach = np.where(index % 2 == 0, 2, 1)
        low, high = (np.array(ends)[:, None] for ends in zip(*level.ranges))
        interior = ((low <= index - reach) & (index + reach < high)).all(axis=0)
        total = np.prod(2 * reach + 1, axis=0)
        own = level.held.size // self._dof
        others = level.comm.tompi4py().allreduce(own) - own
        return [counts.astype(PETSc.IntType) for counts in (
            np.minimum(total, own), np.where(interior, 0, np.minimum(total, others)))]

    def _batches(self):
        """Slices of the local coarse elements that are complete rows."""
        row = self._shape[0]
        step = max(1, BATCH // row) * row
        return [slice(start, min(start + step, self._count))
                for start in range(0, self._count, step)]

    def _numbers(self, batch):
        """The global numbers of the unknowns of local coarse elements, field by field, (m, n)."""
        level = self._level
        index = 2 * self._index[:, None, batch] + self._element.offsets[:, :, None]
        number = level.number(*(part % (2 * n) if wrap else part for part, n, wrap in zip(
            index, level.shape, level.periodic)))
        return np.concatenate([number * self._dof + field for field in range(self._dof)])

    def _prescribed(self):
        """The prescribed unknowns of the local coarse elements, field by field, (m, n)."""
        numbers, inverse = np.unique(self._numbers(slice(0, self._count)), return_inverse=True)
        flags, found = self._level.vector(), PETSc.Vec().createSeq(numbers.size)
        flags.setArray(self._level.held.astype(float))
        wanted = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        PETSc.Scatter().create(flags, wanted, found, None).scatter(flags, found)
        return found.getArray()[inverse].reshape(self._element.nodes * self._dof, -1) > 0.5

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
        nodes = self._element.nodes
        parts = values.reshape(self._dof, nodes, self._dof, nodes, -1)
        return np.moveaxis(parts, 2, 1).ravel()

    @contextmanager
    def filling(self, matrix):
        """Give ``add(number, out)``, which adds the entries (n_all, n) of a batch. Collective."""
        dof, nodes = self._dof, self._element.nodes
        total = np.zeros((dof * dof, nodes, nodes, self._count))

        def add(number, out):
            fine = out[:(nodes * dof)**2].reshape(dof * dof, nodes, nodes, -1)
            steps, some, free = self._steps[number]
            if some.size:  # entries of prescribed unknowns, which no other matrix uses
                both = free[:, None, :, None] * free[None, :, None, :]
                fine[..., some] *= both.reshape(dof * dof, nodes, nodes, -1)
            for chosen, target, down in steps:
                part = np.matmul(down, fine[..., chosen].reshape(dof * dof * nodes, nodes, -1))
                part = np.matmul(down, part.reshape(dof * dof, nodes, -1))
                total[..., target] += part.reshape(dof * dof, nodes, nodes, -1)

        yield add
        self._write(total, matrix)
        if self.coarser:
            part, other = self.coarser
            with part.filling(other) as add_all:
                add_all(0, total.reshape((nodes * dof)**2, -1))

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
        found.append((chosen - batch.start, grid.elements.index[:, chosen],
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
    parent = np.searchsorted(kept[2:-1:2], 2 * np.arange(count) + 1)
    ends, inner = coarse.at[axis], fine.at[axis]
    maps = np.array([multigrid.lagrange(np.repeat(ends[None, 2 * c:2 * c + 3], 3, axis=0),
                                        inner[2 * e:2 * e + 3]) for e, c in enumerate(parent)])
    _, first, kind = np.unique(np.round(maps, 12), axis=0, return_index=True, return_inverse=True)
    return parent, kind.ravel(), maps[first]


def _range(index):
    """``index`` (n,) as a slice if it is a range."""
    step = np.unique(np.diff(index))
    if index.size > 1 and step.size == 1 and step[0] > 0:
        return slice(index[0], index[-1] + 1, step[0])
    return index
