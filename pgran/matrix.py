"""Parallel sparse matrices that are sums of element matrices, filled in place.

The place of every entry has a closed form on the structured grid, so nothing is
searched while a matrix is filled: the entries of a batch of elements are summed by
`numpy.bincount` straight into the arrays in which PETSc keeps the values. petsc4py
gives no access to those; `stored_values` is the one place that asks PETSc itself.
"""

import ctypes
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc


class BatchSum:
    """Adds some of the numbers of a batch to an array, each at its place.

    Parameters: ``chosen``, a slice or the positions (n,) of the numbers; ``places`` (n,) in the
    array, the array's length or more for numbers that are left out; ``length`` of the array.
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

    Parameters: ``grid``; ``blocks``, the pairs (lattice, dof) of rows and columns;
    ``global_number`` of the columns; ``groups`` of entries, each a list of the arguments
    that `Sparsity.places` takes, whose rows lie close together; ``batches``, slices of the
    elements; ``held``, the columns that are prescribed: they stay empty, and their
    rows are those of the identity.
    """

    def __init__(self, grid, blocks, global_number, groups, batches, held):
        sparsity = Sparsity(grid, blocks, blocks)
        self._pattern, where = _lay_out(grid.comm, sparsity, global_number)
        with stored_values(self._pattern) as arrays:
            lengths = [array.size for array in arrays]
        offsets = np.cumsum([0] + [lattice.size * dof for lattice, dof in blocks])

        def held_at(block, field, points):
            return held[offsets[block] + points * blocks[block][1] + field]

        self._batches, self._sums, self._given = batches, [], False
        for batch in batches:
            sums, first = [], 0
            for group in groups:
                places = []
                for row, row_field, row_points, column, column_field, column_points in group:
                    rows, columns = row_points[:, batch], column_points[:, batch]
                    place = where[sparsity.places(row, row_field, rows,
                                                  column, column_field, columns)]
                    place[held_at(row, row_field, rows)[:, None]
                          | held_at(column, column_field, columns)] = sum(lengths)
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
        for block, (lattice, dof) in enumerate(blocks):
            points = lattice.owned[None]
            for field in range(dof):
                place = sparsity.places(block, field, points, block, field, points)[0, 0]
                ones.append(where[place][held_at(block, field, lattice.owned)])
        self._ones = np.concatenate(ones)

    @property
    def entries(self):
        """The number of entries of one element."""
        batch = self._batches[-1]
        return self._size // (batch.stop - batch.start)

    def create(self):
        """Return a matrix, whose values are not yet set. Collective."""
        if self._given:
            return self._pattern.duplicate()
        self._given = True
        return self._pattern

    def fill(self, matrix, evaluate):
        """Fill ``matrix``; ``evaluate(batch, out)`` gives the entries, (entries, elements)."""
        with stored_values(matrix) as arrays:
            for array in arrays:
                array[:] = 0.0
            for batch, sums in zip(self._batches, self._sums):
                out = np.empty((self.entries, batch.stop - batch.start))
                evaluate(batch, out)
                for part, batch_sum in sums:
                    batch_sum.add(out.ravel(), arrays[part])
            arrays[0][self._ones] = 1.0
        matrix.assemble()


class Sparsity:
    """Where the entries of element matrices go in the rows that a rank owns.

    The rows and columns are blocks of the lattices of `Grid`: a row of a node or
    corner reaches the unknowns of all elements around it, so the place of every
    entry has a closed form and nothing is searched or sorted.

    Parameters: ``rows`` and ``columns`` list pairs (lattice, dof). Local column
    numbers count through ``columns``; row numbers through the owned ``rows``.
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

    def places(self, row, row_field, row_points, column, column_field, column_points):
        """Return where entries of element blocks stand among the values, (n_a, n_b, n).

        ``row`` and ``column`` number the pairs given at the start; ``row_points``
        (n_a, n) and ``column_points`` (n_b, n) are local points. Rows that another
        rank owns give ``size``.
        """
        dof, place_of, first, reach, widths = self._blocks[row]
        target, target_dof = self.columns[column]
        start, count = _span(reach, target)
        place = place_of[row_points]
        safe = np.where(place < 0, 0, place)
        before = sum(widths[:column], np.zeros_like(widths[0]))
        base = first[safe * dof + row_field] + before[safe] + column_field
        across = target.i[column_points][None] - start[0][safe][:, None]
        up = target.j[column_points][None] - start[1][safe][:, None]
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


def _lay_out(comm, sparsity, global_number):
    """A matrix with the places of ``sparsity``, and where PETSc keeps each of its entries.

    (size + 1,): counted through `stored_values`, and their total length for what has no place.
    """
    start = sparsity.start.astype(PETSc.IntType)
    column = global_number[sparsity.column].astype(PETSc.IntType)
    n_rows = start.size - 1
    matrix = PETSc.Mat().create(comm=comm)
    matrix.setType(PETSc.Mat.Type.AIJ)
    matrix.setSizes(((n_rows, None), (n_rows, None)))
    ranks = comm.tompi4py()
    last, size = ranks.scan(n_rows), ranks.allreduce(n_rows)
    here = np.add.reduceat((last - n_rows <= column) & (column < last), start[:-1], dtype=int)
    # A cell of two elements reaches a node from both sides, and counts it twice.
    there = np.minimum(np.diff(start) - here, size - n_rows)
    matrix.setPreallocationNNZ((np.minimum(here, n_rows).astype(PETSc.IntType),
                                there.astype(PETSc.IntType)))
    # Each entry carries its own number, and PETSc sorts them.
    matrix.setValuesCSR(start, column, np.arange(column.size, dtype=PETSc.ScalarType))
    matrix.assemble()
    with stored_values(matrix) as arrays:
        kept = np.concatenate(arrays).real.astype(PETSc.IntType)
    where = np.full(column.size + 1, kept.size, dtype=PETSc.IntType)
    where[kept] = np.arange(kept.size)
    lost = np.flatnonzero(where[:-1] == kept.size)
    if lost.size:  # in that cell: the second of two entries of one place
        key = np.repeat(np.arange(n_rows), np.diff(start)) * np.int64(size) + column
        order = np.argsort(key[kept])
        where[lost] = order[np.searchsorted(key[kept], key[lost], sorter=order)]
    return matrix, where


_petsc = ctypes.CDLL(PETSc.__file__)  # the library that petsc4py itself is linked to


@contextmanager
def stored_values(matrix):
    """Give the arrays (n,), (m,) in which PETSc keeps the values of an AIJ matrix, to change them.

    The first is of the columns that this rank owns, the second of the others; in both, row
    after row, and within a row in the order of global columns.
    """
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
