"""Parallel sparse matrices that are sums of element matrices, filled in place.

The place of every entry has a closed form on the structured grid, so nothing is
searched while a matrix is filled: the entries of a batch of elements are summed by
`numpy.bincount` straight into the arrays in which PETSc keeps the values. petsc4py
gives no access to those; `stored_values` is the one place that asks PETSc itself.
"""

import ctypes
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc


class Field(NamedTuple):
    """One field at the points of the elements: where its unknowns are.

    ``part`` numbers the pairs (lattice, dof) of a matrix, ``number`` the field among the unknowns
    of a point, and ``points`` (m, n) are the local points of each element.
    """

    part: int
    number: int
    points: np.ndarray


class Block(NamedTuple):
    """The entries of element matrices that couple two fields."""

    row: Field
    column: Field


class BatchSum:
    """Adds some of the numbers of a batch to an array, each at its place.

    Parameters
    ----------
    chosen : slice or ndarray, (n,)
        Positions of the numbers in the batch.
    places : ndarray, (n,)
        Their places in the array; its length or more for numbers that are left out.
    length : int
        Length of the array.
    """

    def __init__(self, chosen, places, length):
        inside = places < length
        low, high = (places[inside].min(), places[inside].max() + 1) if inside.any() else (0, 0)
        self._chosen, self._target = chosen, slice(low, high)
        self._places = np.where(inside, places - low, high - low).astype(np.int32)

    def add(self, numbers, array):
        """Add the ``numbers`` (m,) of the batch to ``array``."""
        length = self._target.stop - self._target.start
        sums = np.bincount(self._places, numbers[self._chosen], minlength=length + 1)
        array[self._target] += sums[:length]


class ElementMatrix:
    """Matrices of one pattern, filled with the entries of element matrices. Collective.

    Parameters
    ----------
    grid : pgran.space.grid.Grid
    parts : list of (Lattice, int)
        The lattices of the rows and columns, and how many unknowns their points have.
    global_number : ndarray, (n_local,)
        Global numbers of the columns.
    groups : list of list of Block
        The blocks of an element matrix, in groups whose rows lie close together.
    batches : list of slice
        The elements, batch by batch.
    held : ndarray of bool, (n_local,)
        The columns that are prescribed: they stay empty, and their rows are those of the identity.
    """

    def __init__(self, grid, parts, global_number, groups, batches, held):
        self._comm, self._global_number = grid.comm, global_number
        sparsity = Sparsity(grid, parts, parts)
        self._rows = grid, parts
        pattern = self._pattern(sparsity)
        where = _places(pattern, sparsity, global_number)
        with stored_values(pattern) as arrays:
            lengths = [array.size for array in arrays]
        pattern.destroy()
        offsets = np.cumsum([0] + [lattice.size * dof for lattice, dof in parts])

        def held_at(field, points):
            return held[offsets[field.part] + points * parts[field.part][1] + field.number]

        self._batches, self._sums = batches, []
        for batch in batches:
            sums, first = [], 0
            for group in groups:
                places = []
                for block in group:
                    row, column = (field._replace(points=field.points[:, batch])
                                   for field in block)
                    place = where[sparsity.places(Block(row, column))]
                    place[held_at(row, row.points)[:, None]
                          | held_at(column, column.points)] = sum(lengths)
                    places.append(place.ravel())
                places = np.concatenate(places)
                sums.append((0, BatchSum(slice(first, first + places.size), places, lengths[0])))
                far = np.flatnonzero((places >= lengths[0]) & (places < sum(lengths)))
                if far.size:
                    sums.append((1, BatchSum(first + far, places[far] - lengths[0], lengths[1])))
                first += places.size
            self._sums.append(sums)
        self._size = first
        ones = []
        for number, (lattice, dof) in enumerate(parts):
            for unknown in range(dof):
                field = Field(number, unknown, lattice.owned[None])
                place = sparsity.places(Block(field, field))[0, 0]
                ones.append(where[place][held_at(field, lattice.owned)])
        self._ones = np.concatenate(ones)

    def _pattern(self, sparsity):
        """A matrix with all entries of ``sparsity``, each holding its own number."""
        start = sparsity.start.astype(PETSc.IntType)
        column = self._global_number[sparsity.column].astype(PETSc.IntType)
        n_rows = start.size - 1
        matrix = PETSc.Mat().create(comm=self._comm)
        matrix.setType(PETSc.Mat.Type.AIJ)
        matrix.setSizes(((n_rows, None), (n_rows, None)))
        ranks = self._comm.tompi4py()
        last, size = ranks.scan(n_rows), ranks.allreduce(n_rows)
        here = np.add.reduceat((last - n_rows <= column) & (column < last), start[:-1], dtype=int)
        # A cell of two elements reaches a node from both sides, and counts it twice.
        there = np.minimum(np.diff(start) - here, size - n_rows)
        matrix.setPreallocationNNZ((np.minimum(here, n_rows).astype(PETSc.IntType),
                                    there.astype(PETSc.IntType)))
        matrix.setValuesCSR(start, column, np.arange(column.size, dtype=PETSc.ScalarType))
        matrix.assemble()
        return matrix

    @property
    def entries(self):
        """The number of entries of one element."""
        batch = self._batches[-1]
        return self._size // (batch.stop - batch.start)

    def create(self):
        """Return a new matrix of zeros, which belongs to the caller. Collective."""
        grid, parts = self._rows
        matrix = self._pattern(Sparsity(grid, parts, parts))
        matrix.zeroEntries()
        return matrix

    def fill(self, matrix, evaluate):
        """Fill ``matrix``; ``evaluate(number, out)`` gives the entries (entries, n) of a batch."""
        with stored_values(matrix) as arrays:
            for array in arrays:
                array[:] = 0.0
            for number, (batch, sums) in enumerate(zip(self._batches, self._sums)):
                out = np.empty((self.entries, batch.stop - batch.start))
                evaluate(number, out)
                for part, batch_sum in sums:
                    batch_sum.add(out.ravel(), arrays[part])
            arrays[0][self._ones] = 1.0
        matrix.assemble()


class Sparsity:
    """Where the entries of element matrices go in the rows that a rank owns.

    The rows and columns belong to lattices of `Grid`. A row of a node or corner reaches the
    unknowns of all elements around it, so the place of every entry has a closed form and nothing
    is searched or sorted.

    Parameters
    ----------
    grid : pgran.space.grid.Grid
    rows, columns : list of (Lattice, int)
        Lattices and unknowns of a point. Local column numbers count through ``columns``, row
        numbers through the owned points of ``rows``.
    """

    def __init__(self, grid, rows, columns):
        self.columns = columns
        starts, indices, self._blocks = [np.zeros(1, dtype=np.int64)], [], []
        n_entries = 0
        for lattice, dof in rows:
            reach = _reach(grid, lattice)
            number, used, widths = self._column_numbers(lattice, reach)
            lengths = np.repeat(used.sum(axis=1), dof)
            indices.append(np.repeat(number[:, None], dof, axis=1)[
                np.repeat(used[:, None], dof, axis=1)])
            first = n_entries + np.concatenate([[0], np.cumsum(lengths)])
            place = np.full(lattice.size, -1)
            place[lattice.owned] = np.arange(lattice.owned.size)
            self._blocks.append((dof, place, first[:-1], reach, widths))
            starts.append(first[1:])
            n_entries = first[-1]
        self.start = np.concatenate(starts)
        self.column = np.concatenate(indices)
        self.size = int(n_entries)

    def _column_numbers(self, lattice, reach):
        """For each owned point: candidate local columns (n, m), which are used, block widths."""
        numbers, used, widths = [], [], []
        offset = 0
        owned = lattice.owned
        for target, dof in self.columns:
            start, count = _span(reach, target)
            most = 2 * target.per_element + 1
            b, a = np.mgrid[:most, :most]
            a, b = a.ravel(), b.ravel()
            inside = (a < count[0][:, None]) & (b < count[1][:, None])
            point = target.index(start[0][:, None] + a, start[1][:, None] + b)
            number = offset + point[:, :, None] * dof + np.arange(dof)
            numbers.append(number.reshape(owned.size, -1))
            used.append(np.repeat(inside, dof, axis=1))
            widths.append(count[0] * count[1] * dof)
            offset += target.size * dof
        return np.hstack(numbers), np.hstack(used), widths

    def places(self, block):
        """Return where the entries of a `Block` stand among the values, (n_a, n_b, n).

        Rows that another rank owns give ``size``.
        """
        row, column = block
        dof, place_of, first, reach, widths = self._blocks[row.part]
        target, target_dof = self.columns[column.part]
        start, count = _span(reach, target)
        place = place_of[row.points]
        safe = np.where(place < 0, 0, place)
        before = sum(widths[:column.part], np.zeros_like(widths[0]))
        base = first[safe * dof + row.number] + before[safe] + column.number
        across = target.i[column.points][None] - start[0][safe][:, None]
        up = target.j[column.points][None] - start[1][safe][:, None]
        where = base[:, None] + (up * count[0][safe][:, None] + across) * target_dof
        return np.where(place[:, None] < 0, self.size, where)


def _reach(grid, lattice):
    """The elements around each owned point: (first, last) in x1 and in x2."""
    spans = []
    for index, n, wrap in zip((lattice.i, lattice.j), grid.shape, grid.periodic):
        index = index[lattice.owned]
        if lattice.per_element == 2:
            first, last = (index - 1) // 2, index // 2
        else:
            first, last = index - 1, index
        if not wrap:
            first, last = np.maximum(first, 0), np.minimum(last, n - 1)
        spans.append((first, last))
    return spans


def _span(reach, target):
    """First index and count, in each direction, of the points of ``target`` in those elements."""
    start = [target.per_element * first for first, _ in reach]
    count = [target.per_element * (last - first + 1) + 1 for first, last in reach]
    return start, count


def _places(matrix, sparsity, global_number):
    """Where PETSc keeps each entry of a matrix whose entries hold their own numbers.

    (size + 1,): counted through `stored_values`, and their total length for what has no place.
    """
    start, column = sparsity.start, global_number[sparsity.column]
    with stored_values(matrix) as arrays:
        kept = np.concatenate(arrays).astype(PETSc.IntType)
    where = np.full(column.size + 1, kept.size, dtype=PETSc.IntType)
    where[kept] = np.arange(kept.size)
    lost = np.flatnonzero(where[:-1] == kept.size)
    if lost.size:  # in a cell of two elements: the second of two entries of one place
        key = np.repeat(np.arange(start.size - 1), np.diff(start)) * np.int64(
            matrix.getSize()[1]) + column
        order = np.argsort(key[kept])
        where[lost] = order[np.searchsorted(key[kept], key[lost], sorter=order)]
    return where


_petsc = ctypes.CDLL(PETSc.__file__)  # the library that petsc4py itself is linked to


@contextmanager
def stored_values(matrix):
    """Give the arrays (n,), (m,) in which PETSc keeps the values of an AIJ matrix, to change them.

    The first is of the columns that this rank owns, the second of the others; in both, row
    after row, and within a row in the order of global columns. Raises RuntimeError where PETSc's
    scalars are not real numbers in double precision.
    """
    if np.dtype(PETSc.ScalarType) != np.float64:
        raise RuntimeError(f"PETSc was built with scalars of type {np.dtype(PETSc.ScalarType)}; "
                           "pgran needs real scalars in double precision")

    def call(name, *arguments):
        if getattr(_petsc, name)(*arguments):
            raise RuntimeError(f"{name} failed")

    near, far = ctypes.c_void_p(matrix.handle), ctypes.c_void_p()
    if matrix.comm.size > 1:
        call("MatMPIAIJGetSeqAIJ", ctypes.c_void_p(matrix.handle), ctypes.byref(near),
             ctypes.byref(far), None)
    count = PETSc.Mat.InfoType.LOCAL
    total = int(matrix.getInfo(count)["nz_used"])
    diagonal = int(matrix.getDiagonalBlock().getInfo(count)["nz_used"])
    arrays, pointers = [], []
    for part, length in ((near, diagonal), (far, total - diagonal)):
        pointer = ctypes.POINTER(ctypes.c_double)()
        if part:
            call("MatSeqAIJGetArray", part, ctypes.byref(pointer))
            pointers.append((part, pointer))
        arrays.append(np.ctypeslib.as_array(pointer, (length,)) if length else np.empty(0))
    try:
        yield arrays
    finally:
        for part, pointer in pointers:
            call("MatSeqAIJRestoreArray", part, ctypes.byref(pointer))
        matrix.stateIncrease()
