"""Parallel sparse matrices that are sums of element matrices.

`InPlaceMatrix` fills them in place. The position of every entry has a closed form on the
structured grid, so that filling needs no search: `numpy.bincount` sums the entries of a batch of
elements directly into the arrays of values of PETSc. petsc4py gives no access to these arrays;
only `stored_values` calls PETSc's library itself.
"""

import ctypes
import hashlib
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

from .grid import indices

#: Points whose rows are created at a time.
CHUNK = 8192


class Field(NamedTuple):
    """Field ``number`` of a `Lattice`, at local points (m, n) of elements."""

    lattice: object
    number: int
    points: np.ndarray


class Unknowns:
    """The rows or columns of a matrix, numbered locally through a list of `Lattice`.

    ``numbers`` (n,) are their global numbers, and ``held`` (n,) says which are prescribed.
    """

    def __init__(self, lattices, numbers, held):
        self.lattices, self.numbers, self.held = lattices, numbers, held
        starts = np.cumsum([0] + [lattice.size * lattice.dof for lattice in lattices])
        self._starts = dict(zip(lattices, starts))
        self.owned = np.concatenate([start + lattice.owned_unknowns
                                     for lattice, start in self._starts.items()])

    def local(self, field):
        """Return the local numbers of a `Field`, (m, n)."""
        return self._starts[field.lattice] + field.points * field.lattice.dof + field.number


class ScatterAdd:
    """Adds the ``chosen`` numbers of a batch to ``positions`` (n,) of an array.

    Positions from the ``length`` of the array on are ignored. Most batches share the positions
    relative to the first one, which are ``known`` and thus remain in the cache.
    """

    def __init__(self, chosen, positions, length, known):
        inside = positions < length
        low, high = 0, 0
        if inside.any():
            low, high = positions[inside].min(), positions[inside].max() + 1
        relative = np.where(inside, positions - low, high - low).astype(np.intp)
        self._chosen, self._target = chosen, slice(low, high)
        self._positions = known.setdefault(hashlib.blake2b(relative).digest(), relative)

    def add(self, numbers, array):
        """Add the ``numbers`` (m,) of the batch to ``array``."""
        length = self._target.stop - self._target.start
        sums = np.bincount(self._positions, numbers[self._chosen], minlength=length + 1)
        array[self._target] += sums[:length]


def scatter_adds(begin, positions, lengths, known):
    """Return [(array number, `ScatterAdd`)] for the two arrays of `stored_values`.

    The numbers of the batch start at ``begin``. ``positions`` (n,) count through both arrays;
    larger ones are left out.
    """
    near, total = lengths[0], sum(lengths)
    sums = [(0, ScatterAdd(slice(begin, begin + positions.size), positions, near, known))]
    far = np.flatnonzero((positions >= near) & (positions < total))
    if far.size:
        sums.append((1, ScatterAdd(begin + far, positions[far] - near, lengths[1], known)))
    return sums


class InPlaceMatrix:
    """An AIJ or BAIJ matrix whose element matrices are summed in PETSc's own arrays.

    Its creation is collective. Prescribed rows and columns are empty; where ``rows`` is
    ``columns``, prescribed rows are rows of the identity. An element adds ``entries`` numbers.

    Parameters
    ----------
    rows, columns : Unknowns
    groups : list of list of (Field, Field)
        The coupled fields, in groups whose rows lie close together.
    batches : list of slice
        The elements of each batch.
    first : int
        The first of these entries among all entries of an element.
    blocked : bool
        Whether the matrix is BAIJ, with the unknowns of the points of one lattice as blocks.
    """

    def __init__(self, grid, rows, columns, groups, batches, first=0, blocked=False):
        self._grid, self._rows, self._columns = grid, rows, columns
        self._blocked = blocked
        self.entries = sum(len(row.points) * len(column.points)
                           for group in groups for row, column in group)
        sparsity = self._sparsity()
        self._unused = self._pattern(sparsity)
        with stored_values(self._unused) as arrays:
            lengths = [array.size for array in arrays]
        stored = _stored_positions(self._unused, sparsity, columns.numbers)
        self._sums = self._find_sums(sparsity, stored, lengths, groups, batches, first)
        self._ones = []
        if rows is columns:
            diagonal = self._unused.getDiagonal().array.astype(int)
            self._ones = stored[diagonal[rows.held[rows.owned]]]
        self._unused.zeroEntries()

    def _sparsity(self):
        return Sparsity(self._grid, self._rows.lattices, self._columns.lattices)

    def _find_sums(self, sparsity, stored, lengths, groups, batches, first):
        """The `scatter_adds` of each batch."""
        found, known = [], {}
        for batch in batches:
            sums, begin = [], first * (batch.stop - batch.start)
            for group in groups:
                positions = []
                for pair in group:
                    row, column = (field._replace(points=field.points[:, batch])
                                   for field in pair)
                    position = stored[sparsity.positions(row, column)]
                    held = (self._rows.held[self._rows.local(row)][:, None]
                            | self._columns.held[self._columns.local(column)])
                    position[held] = sum(lengths)
                    positions.append(position.ravel())
                positions = np.concatenate(positions)
                sums += scatter_adds(begin, positions, lengths, known)
                begin += positions.size
            found.append(sums)
        return found

    def _pattern(self, sparsity):
        """A matrix with all entries of ``sparsity``, whose values are entry numbers."""
        comm, numbers = self._grid.comm, self._columns.numbers
        ranks, n_rows, n_columns = comm.tompi4py(), self._rows.owned.size, self._columns.owned.size
        last, total = ranks.scan(n_columns), ranks.allreduce(n_columns)
        matrix = PETSc.Mat().create(comm=comm)
        matrix.setType(PETSc.Mat.Type.BAIJ if self._blocked else PETSc.Mat.Type.AIJ)
        matrix.setSizes(((n_rows, None), (n_columns, None)))
        matrix.setBlockSizes(*(part.lattices[0].dof if len(part.lattices) == 1 else 1
                               for part in (self._rows, self._columns)))
        size = self._rows.lattices[0].dof if self._blocked else 1
        near = np.zeros(n_rows, dtype=PETSc.IntType)
        for rows, start, column in sparsity.chunks():
            column = numbers[column]
            near[rows] = np.add.reduceat(
                (last - n_columns <= column) & (column < last), start[:-1], dtype=int)
        # In a cell of two elements a node is counted twice, as it is reached from both sides.
        far = np.minimum(np.diff(sparsity.start) - near, total - n_columns)
        matrix.setPreallocationNNZ([(counts[::size] // size).astype(PETSc.IntType)
                                    for counts in (np.minimum(near, n_columns), far)])
        above = ranks.scan(n_rows) - n_rows
        for rows, start, column in sparsity.chunks():
            matrix.setValuesIJV(
                start.astype(PETSc.IntType), numbers[column].astype(PETSc.IntType),
                sparsity.start[rows.start] + np.arange(column.size, dtype=PETSc.ScalarType),
                rowmap=np.arange(above + rows.start, above + rows.stop, dtype=PETSc.IntType))
        matrix.assemble()
        matrix.setOption(PETSc.Mat.Option.NO_OFF_PROC_ENTRIES, True)  # `filling` writes owned rows
        return matrix

    def create(self):
        """Return a new matrix of zeros, which belongs to the caller. Collective."""
        matrix, self._unused = self._unused, None
        if not matrix:
            matrix = self._pattern(self._sparsity())
            matrix.zeroEntries()
        return matrix

    @contextmanager
    def filling(self, matrix):
        """Give ``add(number, out)``, which adds the entries (n_all, n) of a batch. Collective."""
        with stored_values(matrix) as arrays:
            for array in arrays:
                array[:] = 0.0

            def add(number, out):
                for part, scatter in self._sums[number]:
                    scatter.add(out.ravel(), arrays[part])

            yield add
            arrays[0][self._ones] = 1.0
        matrix.assemble()


def fill(parts, batches, evaluate):
    """Fill pairs of InPlaceMatrix and PETSc.Mat from the same element matrices. Collective.

    ``evaluate(number, out)`` puts the entries of a batch of elements into ``out``, (n_all, n).
    """
    entries = sum(part.entries for part, _ in parts)
    with ExitStack() as stack:
        adds = [stack.enter_context(part.filling(matrix)) for part, matrix in parts]
        for number, batch in enumerate(batches):
            out = np.empty((entries, batch.stop - batch.start))
            evaluate(number, out)
            for add in adds:
                add(number, out)


class Sparsity:
    """The entries of the rows that a rank owns: all unknowns of the elements around each point.

    ``rows`` and ``columns`` are lists of `Lattice`; ``start`` has the first entry of each row.
    """

    def __init__(self, grid, rows, columns):
        self._columns, self._blocks = columns, {}
        starts, n_entries = [np.zeros(1, dtype=np.int64)], 0
        for lattice in rows:
            reach, dof = _reach(grid, lattice), lattice.dof
            widths = [np.prod(_span(reach, target)[1], axis=0) * target.dof for target in columns]
            ends = n_entries + np.cumsum(np.repeat(sum(widths), dof))
            owned = np.full(lattice.size, -1)
            owned[lattice.owned] = np.arange(lattice.owned.size)
            self._blocks[lattice] = (
                dof, owned, np.concatenate([[n_entries], ends[:-1]]), reach, widths)
            starts.append(ends)
            n_entries = ends[-1]
        self.start, self.size = np.concatenate(starts), int(n_entries)

    def chunks(self):
        """Yield (slice of owned rows, their first entries (n + 1,), local columns (m,))."""
        first = 0
        for dof, _, _, reach, widths in self._blocks.values():
            n_points = len(widths[0])
            for begin in range(0, n_points, CHUNK):
                chunk = slice(begin, min(begin + CHUNK, n_points))
                number, used = self._column_numbers([
                    [index[chunk] for index in span] for span in reach])
                column = np.repeat(number[:, None], dof, axis=1)[
                    np.repeat(used[:, None], dof, axis=1)]
                rows = slice(first + chunk.start * dof, first + chunk.stop * dof)
                start = self.start[rows.start:rows.stop + 1]
                yield rows, start - start[0], column
            first += n_points * dof

    def _column_numbers(self, reach):
        """Candidate local columns of each point of a reach, (n, m), and which exist."""
        numbers, used, offset = [], [], 0
        for target in self._columns:
            dof, (start, count) = target.dof, _span(reach, target)
            near = indices([(0, 2 * target.per_element + 1)] * len(reach))
            inside = np.all([part < size[:, None] for part, size in zip(near, count)], axis=0)
            point = target.position(*(first[:, None] + part for first, part in zip(start, near)))
            number = offset + point[:, :, None] * dof + np.arange(dof)
            numbers.append(number.reshape(len(point), -1))
            used.append(np.repeat(inside, dof, axis=1))
            offset += target.size * dof
        return np.hstack(numbers), np.hstack(used)

    def positions(self, row, column):
        """Return the numbers (n_a, n_b, n) of entries of two fields; ``size`` if not owned."""
        dof, owned, first, reach, widths = self._blocks[row.lattice]
        target = column.lattice
        start, count = _span(reach, target)
        point = owned[row.points]
        safe = np.where(point < 0, 0, point)
        before = sum(widths[:self._columns.index(target)], np.zeros_like(widths[0]))
        number = (first[safe * dof + row.number] + before[safe] + column.number)[:, None]
        stride = target.dof
        for axis, index in enumerate(target.index):
            number = number + (index[column.points] - start[axis][safe][:, None]) * stride
            stride = stride * count[axis][safe][:, None]
        return np.where(point[:, None] < 0, self.size, number)


def _reach(grid, lattice):
    """The elements around each owned point, [(first, last)] along each axis."""
    spans = []
    for index, n, wrap in zip(lattice.index, grid.shape, grid.periodic):
        index = index[lattice.owned]
        first, last = (index - 1) // lattice.per_element, index // lattice.per_element
        if not wrap:
            first, last = np.maximum(first, 0), np.minimum(last, n - 1)
        spans.append((first, last))
    return spans


def _span(reach, target):
    """First index and count, along each axis, of the points of ``target`` in those elements."""
    start = [target.per_element * first for first, _ in reach]
    count = [target.per_element * (last - first + 1) + 1 for first, last in reach]
    return start, count


def _stored_positions(matrix, sparsity, numbers):
    """Positions (size + 1,) in both arrays of entries whose values are their numbers."""
    with stored_values(matrix) as arrays:
        kept = np.concatenate(arrays).astype(PETSc.IntType)
    stored = np.full(sparsity.size + 1, kept.size, dtype=PETSc.IntType)
    stored[kept] = np.arange(kept.size, dtype=PETSc.IntType)
    lost = np.flatnonzero(stored[:-1] == kept.size)
    if lost.size:  # in a cell of two elements, the second of two equal entries
        column = numbers[np.concatenate([column for _, _, column in sparsity.chunks()])]
        key = np.repeat(np.arange(sparsity.start.size - 1), np.diff(sparsity.start)) * np.int64(
            matrix.getSize()[1]) + column
        order = np.argsort(key[kept])
        stored[lost] = order[np.searchsorted(key[kept], key[lost], sorter=order)]
    return stored


_petsc = ctypes.CDLL(PETSc.__file__)  # linked to petsc4py


@contextmanager
def stored_values(matrix):
    """Give the arrays of values of a matrix, for the columns of this rank and for the others."""
    if np.dtype(PETSc.ScalarType) != np.float64:
        raise RuntimeError(f"PETSc was built with scalars of type {np.dtype(PETSc.ScalarType)}; "
                           "pgran needs real scalars in double precision")

    def call(name, *arguments):
        if getattr(_petsc, name)(*arguments):
            raise RuntimeError(f"{name} failed")

    near, far = ctypes.c_void_p(matrix.handle), ctypes.c_void_p()
    kind = "BAIJ" if matrix.getType().endswith("baij") else "AIJ"
    if matrix.comm.size > 1:
        call(f"MatMPI{kind}GetSeq{kind}", ctypes.c_void_p(matrix.handle), ctypes.byref(near),
             ctypes.byref(far), None)
    count = PETSc.Mat.InfoType.LOCAL
    total = int(matrix.getInfo(count)["nz_used"])
    diagonal = int(matrix.getDiagonalBlock().getInfo(count)["nz_used"])
    arrays, pointers = [], []
    for part, length in ((near, diagonal), (far, total - diagonal)):
        pointer = ctypes.POINTER(ctypes.c_double)()
        if part:
            call(f"MatSeq{kind}GetArray", part, ctypes.byref(pointer))
            pointers.append((part, pointer))
        arrays.append(np.ctypeslib.as_array(pointer, (length,)) if length else np.empty(0))
    try:
        yield arrays
    finally:
        for part, pointer in pointers:
            call(f"MatSeq{kind}RestoreArray", part, ctypes.byref(pointer))
        matrix.stateIncrease()
