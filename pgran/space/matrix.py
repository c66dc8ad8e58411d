"""Parallel sparse matrices that are sums of element matrices.

`InPlaceMatrix` fills them in place. The position of every entry has a closed form on the
structured grid, so that filling needs no search: `numpy.bincount` sums the entries of a batch of
elements directly into the arrays in which PETSc keeps the values. petsc4py gives no access to
these arrays; `stored_values` is the one place that calls PETSc's library itself.
"""

import ctypes
import hashlib
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np
from petsc4py import PETSc

#: Points whose rows are laid out at a time.
CHUNK = 8192


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


class ScatterAdd:
    """Adds some of the numbers of a batch to an array, each at its place.

    Parameters
    ----------
    chosen : slice or ndarray, (n,)
        Positions of the numbers in the batch.
    places : ndarray, (n,)
        Their places in the array; its length or more for numbers that are left out.
    length : int
        Length of the array.
    known : dict
        Places that other batches have, from the first of theirs on. On a structured grid those of
        most batches are the same, so that they are kept once and stay in the cache.
    """

    def __init__(self, chosen, places, length, known):
        inside = places < length
        low, high = (places[inside].min(), places[inside].max() + 1) if inside.any() else (0, 0)
        self._chosen, self._target = chosen, slice(low, high)
        self._positions = _kept(np.where(inside, places - low, high - low), known)

    def add(self, numbers, array):
        """Add the ``numbers`` (m,) of the batch to ``array``."""
        length = self._target.stop - self._target.start
        sums = np.bincount(self._positions, numbers[self._chosen], minlength=length + 1)
        array[self._target] += sums[:length]


def _kept(places, known):
    """``places``, or the array of ``known`` that has the same numbers."""
    places = places.astype(np.intp)
    return known.setdefault(hashlib.blake2b(places).digest(), places)


class DofLayout(NamedTuple):
    """Rows or columns of a matrix: ``dof`` unknowns of each point of a lattice."""

    lattice: object
    dof: int

    @property
    def owned(self):
        """Local numbers of the owned unknowns, (n,)."""
        return (self.lattice.owned[:, None] * self.dof + np.arange(self.dof)).ravel()


class InPlaceMatrix:
    """An AIJ or BAIJ matrix whose element matrices are summed where PETSc keeps the values.

    Making it is collective. BAIJ, with ``blocked``, keeps the unknowns of a point as blocks. Its
    rows and columns are those of one lattice, and all unknowns of a point couple.

    Parameters
    ----------
    grid : pgran.space.grid.Grid
    rows, columns : list of DofLayout
        Local numbers count through them.
    numbers : (ndarray, ndarray)
        Global numbers of the local rows and of the local columns.
    held : (ndarray of bool, ndarray of bool)
        Rows and columns that are prescribed: they stay empty. In a square matrix (``rows`` is
        ``columns``) these rows are those of the identity.
    groups : list of list of Block
        The blocks of an element matrix, in groups whose rows lie close together.
    batches : list of slice
        The elements, batch by batch.
    first : int
        The first of these blocks' entries among all entries of an element.
    blocked : bool
        Whether the matrix is BAIJ.

    Attributes
    ----------
    entries : int
        How many entries of an element go into this matrix.
    """

    def __init__(self, grid, rows, columns, numbers, held, groups, batches, first=0,
                 blocked=False):
        self._grid, self._rows, self._columns = grid, rows, columns
        self._numbers, self._held, self._batches = numbers, held, batches
        self._groups, self._first, self._blocked = groups, first, blocked
        self._starts = [np.cumsum([0] + [part.lattice.size * part.dof for part in parts])
                        for parts in (rows, columns)]
        self.entries = sum(len(block.row.points) * len(block.column.points)
                           for group in groups for block in group)
        sparsity = self._sparsity()
        self._made = self._pattern(sparsity)
        with stored_values(self._made) as arrays:
            lengths = [array.size for array in arrays]
        self._lay_out(sparsity, _positions(self._made, sparsity, self._numbers[1]), lengths)
        self._made.zeroEntries()

    def _local(self, side, field):
        """The local rows (``side`` 0) or columns (1) of a `Field`, (m, n)."""
        dof = (self._rows, self._columns)[side][field.part].dof
        return self._starts[side][field.part] + field.points * dof + field.number

    def _owned(self, side):
        """The local numbers of the owned rows (``side`` 0) or columns (1), (n,)."""
        return np.concatenate([start + part.owned for start, part in zip(
            self._starts[side], (self._rows, self._columns)[side])])

    @property
    def _square(self):
        return self._rows is self._columns

    def _sparsity(self):
        return Sparsity(self._grid, self._rows, self._columns)

    def _lay_out(self, sparsity, where, lengths):
        """Find the places of all batches; ``where`` is from `_places`, ``lengths`` of the parts."""
        self._sums, known = [], {}
        for batch in self._batches:
            sums, begin = [], self._first * (batch.stop - batch.start)
            for group in self._groups:
                places = []
                for block in group:
                    row, column = (field._replace(points=field.points[:, batch])
                                   for field in block)
                    place = where[sparsity.positions(Block(row, column))]
                    row, column = (held[self._local(side, field)] for side, (held, field)
                                   in enumerate(zip(self._held, (row, column))))
                    place[row[:, None] | column] = sum(lengths)
                    places.append(place.ravel())
                places = np.concatenate(places)
                sums.append((0, ScatterAdd(slice(begin, begin + places.size), places, lengths[0],
                                         known)))
                far = np.flatnonzero((places >= lengths[0]) & (places < sum(lengths)))
                if far.size:
                    sums.append((1, ScatterAdd(begin + far, places[far] - lengths[0], lengths[1],
                                             known)))
                begin += places.size
            self._sums.append(sums)
        ones = [np.empty(0, dtype=int)]
        for number, (lattice, dof) in enumerate(self._rows if self._square else ()):
            for unknown in range(dof):
                field = Field(number, unknown, lattice.owned[None])
                place = sparsity.positions(Block(field, field))[0, 0]
                ones.append(where[place][self._held[0][self._local(0, field)[0]]])
        self._ones = np.concatenate(ones)

    def _pattern(self, sparsity):
        """A matrix with all entries of ``sparsity``, each holding its own number."""
        comm = self._grid.comm
        ranks, n_rows = comm.tompi4py(), sparsity.start.size - 1
        n_columns = self._owned(1).size
        last, total = ranks.scan(n_columns), ranks.allreduce(n_columns)
        matrix = PETSc.Mat().create(comm=comm)
        matrix.setType(PETSc.Mat.Type.BAIJ if self._blocked else PETSc.Mat.Type.AIJ)
        matrix.setSizes(((n_rows, None), (n_columns, None)))
        matrix.setBlockSizes(*(parts[0].dof if len(parts) == 1 else 1
                               for parts in (self._rows, self._columns)))
        size = self._rows[0].dof if self._blocked else 1
        here = np.zeros(n_rows, dtype=PETSc.IntType)
        for rows, start, column in sparsity.chunks():
            column = self._numbers[1][column]
            here[rows] = np.add.reduceat(
                (last - n_columns <= column) & (column < last), start[:-1], dtype=int)
        # A cell of two elements reaches a node from both sides, and counts it twice.
        there = np.minimum(np.diff(sparsity.start) - here, total - n_columns)
        matrix.setPreallocationNNZ([(most[::size] // size).astype(PETSc.IntType) for most in (
            np.minimum(here, n_columns), there)])
        above = ranks.scan(n_rows) - n_rows
        for rows, start, column in sparsity.chunks():
            matrix.setValuesIJV(
                start.astype(PETSc.IntType), self._numbers[1][column].astype(PETSc.IntType),
                sparsity.start[rows.start] + np.arange(column.size, dtype=PETSc.ScalarType),
                rowmap=np.arange(above + rows.start, above + rows.stop, dtype=PETSc.IntType))
        matrix.assemble()
        matrix.setOption(PETSc.Mat.Option.NO_OFF_PROC_ENTRIES, True)  # `filling` writes own rows
        return matrix

    def create(self):
        """Return a new matrix of zeros, which belongs to the caller. Collective."""
        matrix, self._made = self._made, None
        if matrix is None:
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
                for part, batch_sum in self._sums[number]:
                    batch_sum.add(out.ravel(), arrays[part])

            yield add
            arrays[0][self._ones] = 1.0
        matrix.assemble()


def fill(parts, batches, evaluate):
    """Fill matrices from the same element matrices. Collective.

    Parameters
    ----------
    parts : list of (InPlaceMatrix, PETSc.Mat)
    batches : list of slice
        The elements, batch by batch.
    evaluate : callable
        ``evaluate(number, out)`` puts the entries of a batch into ``out``, (n_all, n).
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
    """Where the entries of element matrices go in the rows that a rank owns.

    The rows and columns belong to lattices of `Grid`. A row of a node or corner reaches the
    unknowns of all elements around it, so the place of every entry has a closed form and nothing
    is searched or sorted.

    Parameters
    ----------
    grid : pgran.space.grid.Grid
    rows, columns : list of DofLayout
        Local column numbers count through ``columns``, row numbers through the owned points of
        ``rows``.

    Attributes
    ----------
    start : ndarray, (n_rows + 1,)
        The first entry of each row.
    """

    def __init__(self, grid, rows, columns):
        self._columns, self._blocks = columns, []
        starts, n_entries = [np.zeros(1, dtype=np.int64)], 0
        for lattice, dof in rows:
            reach = _reach(grid, lattice)
            widths = [np.prod(_span(reach, target)[1], axis=0) * target_dof
                      for target, target_dof in columns]
            ends = n_entries + np.cumsum(np.repeat(sum(widths), dof))
            place = np.full(lattice.size, -1)
            place[lattice.owned] = np.arange(lattice.owned.size)
            self._blocks.append(
                (dof, place, np.concatenate([[n_entries], ends[:-1]]), reach, widths))
            starts.append(ends)
            n_entries = ends[-1]
        self.start = np.concatenate(starts)
        self.size = int(n_entries)

    def chunks(self):
        """Yield (rows, start, column) of some rows at a time, in their order.

        ``rows`` is a slice of the owned rows, ``start`` (n + 1,) the first entry of each among
        these, and ``column`` (m,) the local columns.
        """
        first = 0
        for dof, place, _, reach, _ in self._blocks:
            owned = np.count_nonzero(place >= 0)
            for begin in range(0, owned, CHUNK):
                chunk = slice(begin, min(begin + CHUNK, owned))
                number, used = self._column_numbers([
                    [index[chunk] for index in span] for span in reach])
                column = np.repeat(number[:, None], dof, axis=1)[
                    np.repeat(used[:, None], dof, axis=1)]
                rows = slice(first + chunk.start * dof, first + chunk.stop * dof)
                start = self.start[rows.start:rows.stop + 1]
                yield rows, start - start[0], column
            first += owned * dof

    def _column_numbers(self, reach):
        """For each point of a reach: candidate local columns (n, m), and which are used."""
        numbers, used, offset = [], [], 0
        for target, dof in self._columns:
            start, count = _span(reach, target)
            most = 2 * target.per_element + 1
            b, a = np.mgrid[:most, :most]
            a, b = a.ravel(), b.ravel()
            inside = (a < count[0][:, None]) & (b < count[1][:, None])
            point = target.index(start[0][:, None] + a, start[1][:, None] + b)
            number = offset + point[:, :, None] * dof + np.arange(dof)
            numbers.append(number.reshape(len(point), -1))
            used.append(np.repeat(inside, dof, axis=1))
            offset += target.size * dof
        return np.hstack(numbers), np.hstack(used)

    def positions(self, block):
        """Return where the entries of a `Block` stand among the values, (n_a, n_b, n).

        Rows that another rank owns give ``size``.
        """
        row, column = block
        dof, place_of, first, reach, widths = self._blocks[row.part]
        target, target_dof = self._columns[column.part]
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


def _positions(matrix, sparsity, numbers):
    """Where PETSc keeps each entry of a matrix whose entries hold their own numbers.

    (size + 1,): counted through `stored_values`, and their total length for what has no place.
    """
    with stored_values(matrix) as arrays:
        kept = np.concatenate(arrays).astype(PETSc.IntType)
    where = np.full(sparsity.size + 1, kept.size, dtype=PETSc.IntType)
    where[kept] = np.arange(kept.size, dtype=PETSc.IntType)
    lost = np.flatnonzero(where[:-1] == kept.size)
    if lost.size:  # in a cell of two elements: the second of two entries of one place
        column = numbers[np.concatenate([column for _, _, column in sparsity.chunks()])]
        key = np.repeat(np.arange(sparsity.start.size - 1), np.diff(sparsity.start)) * np.int64(
            matrix.getSize()[1]) + column
        order = np.argsort(key[kept])
        where[lost] = order[np.searchsorted(key[kept], key[lost], sorter=order)]
    return where


_petsc = ctypes.CDLL(PETSc.__file__)  # the library that petsc4py itself is linked to


@contextmanager
def stored_values(matrix):
    """Give the arrays (n,), (m,) in which PETSc keeps the values of a matrix, to change them.

    The first is of the columns that this rank owns, the second of the others. For AIJ they hold row
    after row, and within a row go by global columns; for BAIJ they hold block after block. Raises
    RuntimeError where PETSc's scalars are not real numbers in double precision.
    """
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
