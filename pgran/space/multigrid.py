"""The unknowns as PETSc's preconditioners access them: fields by name, and coarser grids.

The fields velocity, fluidity and pressure can be split or joined, and a block of velocity and
fluidity has coarser grids. The preconditioner can therefore be chosen by options::

    -pc_type fieldsplit -pc_fieldsplit_0_fields 0,1 -pc_fieldsplit_1_fields 2
    -fieldsplit_0_pc_type mg

A coarser grid joins elements in pairs along each axis; the last one of an odd number is kept. The
Q2 spaces of the grids are nested.
"""

import numpy as np
from petsc4py import PETSc

from ..options import ParameterError
from .element import Geometry
from .grid import indices


def field_shell(form):
    """Return a DM with the fields by name and the coarser grids of a block. Collective."""
    grid = form.grid
    return _shell(grid.comm, grid.field_sets(), grid.create_vector(),
                  lambda names: node_level(form, names))


def flow_level(form):
    """Return the `NodeLevel` of all fields at the nodes."""
    return node_level(form, ["velocity", "fluidity"] if form.grid.has_fluidity else ["velocity"])


def node_level(form, names):
    """Return the `NodeLevel` of the fields ``names``, None if pressure is one of them."""
    if "pressure" in names:
        return None
    grid = form.grid
    velocity, fluidity, _ = grid.split(form.held)
    held = {"velocity": [*velocity], "fluidity": [fluidity]}
    held = np.array(sum((held[name] for name in names), []))[:, grid.nodes.owned]
    level = NodeLevel(grid.comm, [np.arange(2 * n + 1.0) for n in grid.shape], grid.periodic,
                      _starts(grid.nodes), len(held), held.T.ravel())
    few = np.ceil(np.log2(max(1.0, np.prod(grid.shape) / form.case.max_coarse_elements)) / grid.dim)
    level.depth = min(level.coarsenings, max(resolving(form), int(few)))
    return level


def corner_level(form):
    """Return the `NodeLevel` of the pressures, whose interpolation is linear."""
    grid, corners = form.grid, form.grid.corners
    return NodeLevel(grid.comm, [np.arange(n + 1.0) for n in grid.shape], grid.periodic,
                     _starts(corners), 1, grid.split(form.held)[2][corners.owned], degree=1)


def _starts(lattice):
    """First index of each part of the ranks, and the end, along each axis."""
    return [np.concatenate([[0], np.cumsum(part)]) for part in lattice.dm.getOwnershipRanges()]


def resolving(form):
    """Return how many coarsenings, at least 1, `Case.max_coarse_size` allows. Collective."""
    grid = form.grid
    weight = Geometry(form.case.coordinates(*grid.nodes.index)[:, grid.element_nodes]).weight
    volume = grid.comm.tompi4py().allreduce(weight[:, grid.elements.owned].sum())
    side = form.case.max_coarse_size * form.material.model.length
    return max(1, int(np.floor(np.log2(
        side * (np.prod(grid.shape) / volume)**(1.0 / grid.dim)))))


class NodeLevel:
    """The nodes of one grid of a hierarchy. Their unknowns are numbered as in a block of fields.

    A rank owns the coarse nodes that coincide with its fine nodes.

    Parameters
    ----------
    at : list of ndarray
        Coordinates of the nodes along each axis; if periodic, the first is repeated at the end.
    starts : list of ndarray
        First node index of each part of the ranks, and the end, along each axis.
    held : ndarray of bool, (n_owned,)
        Which of the ``dof`` unknowns of each node are prescribed, node by node.
    kept : list of ndarray, optional
        Numbers of the nodes of the finer level that this level has, along each axis.
    degree : int
        2 for Q2 nodes, 1 for corners.
    """

    #: Number of coarser levels that multigrid uses.
    depth = 0

    def __init__(self, comm, at, periodic, starts, dof, held, kept=None, degree=2):
        self.comm, self.at, self.periodic, self.starts = comm, at, periodic, starts
        self.dof, self.held, self.kept, self.degree = dof, held, kept, degree
        self.shape = tuple((len(x) - 1) // degree for x in at)
        parts = indices([(0, len(start) - 1) for start in starts])  # of all ranks
        self.ranges = [(start[k], start[k + 1]) for start, k in zip(starts, parts[:, comm.rank])]
        counts = np.prod([np.diff(start)[part] for start, part in zip(starts, parts)], axis=0)
        self._first = np.concatenate([[0], np.cumsum(counts)])
        #: Number of coarsenings until one element is left.
        self.coarsenings = (max(self.shape) - 1).bit_length()

    def coarser(self):
        """Return the `NodeLevel` of elements joined in pairs. Collective."""
        if not self.coarsenings:
            raise ParameterError("pc_mg_levels", None, "too many levels; a grid of one element "
                                 "cannot be coarsened", prefix="")
        kept = [_joined_nodes(n, self.degree) for n in self.shape]
        chosen = np.all([np.isin(index, nodes) for index, nodes in zip(
            indices(self.ranges), kept)], axis=0)
        return NodeLevel(self.comm, [x[nodes] for x, nodes in zip(self.at, kept)], self.periodic,
                         [np.searchsorted(nodes, start) for nodes, start in zip(kept, self.starts)],
                         self.dof, self.held.reshape(-1, self.dof)[chosen].ravel(), kept,
                         self.degree)

    def number(self, *index):
        """Return the numbers among the nodes of all ranks of global indices along each axis."""
        rank = local = 0
        ranks = stride = 1
        for start, along in zip(self.starts, index):
            part = np.searchsorted(start, along, side="right") - 1
            rank, ranks = rank + part * ranks, ranks * (len(start) - 1)
            local = local + (along - start[part]) * stride
            stride = stride * (start[part + 1] - start[part])
        return self._first[rank] + local

    def interpolation(self, fine):
        """Return the interpolation to the next finer level; it keeps prescribed unknowns."""
        dim, dof, n = len(self.at), self.dof, fine.held.size // self.dof
        nodes, weight, around = [], 1.0, (self.degree + 1)**dim
        for axis in range(dim):
            node, factor = self._along(axis, fine.ranges[axis], fine.at[axis])
            shape = [1] * 2 * dim  # fine and coarse nodes along the axes, the last axis first
            shape[dim - 1 - axis], shape[2 * dim - 1 - axis] = node.shape
            nodes.append(node.reshape(shape))
            weight = factor.reshape(shape) * weight
        weight, node = weight.reshape(n, around), self.number(*nodes).reshape(n, around)
        used = np.repeat(weight[:, None] != 0.0, dof, axis=1)  # (fine nodes, dof, coarse nodes)
        start = np.concatenate([[0], np.cumsum(used.sum(axis=2))])
        column = (node * dof)[:, None] + np.arange(dof)[:, None]
        value = np.where(fine.held.reshape(n, dof, 1), 0.0, weight[:, None])
        matrix = PETSc.Mat().createAIJ(
            ((fine.held.size, None), (self.held.size, None)), bsize=dof, comm=self.comm,
            csr=(start.astype(PETSc.IntType), column[used].astype(PETSc.IntType), value[used]))
        free = self.vector()
        free.setArray(np.where(self.held, 0.0, 1.0))
        matrix.diagonalScale(None, free)
        index = indices(self.ranges)
        rows, columns = ((level.number(*nodes)[:, None] * dof + np.arange(dof)).ravel()[
            self.held].astype(PETSc.IntType) for level, nodes in (
                (fine, [kept[part] for kept, part in zip(self.kept, index)]), (self, index)))
        matrix.setValuesIJV(np.arange(rows.size + 1, dtype=PETSc.IntType), columns,
                            np.ones(rows.size), rowmap=rows)
        matrix.assemble()
        return matrix

    def _along(self, axis, span, finer):
        """Nodes of this level and weights, (n, degree + 1) each, at fine nodes of a ``span``."""
        kept, x, degree = self.kept[axis], self.at[axis], self.degree
        fine = np.arange(*span)
        element = np.searchsorted(kept[degree:-1:degree], fine)
        node = degree * element[:, None] + np.arange(degree + 1)
        weight = lagrange(x[node], finer[fine])
        if self.periodic[axis]:
            node %= degree * self.shape[axis]
            if self.shape[axis] == 1:  # both ends of the element are one node
                weight[:, 0] += weight[:, -1]
                weight[:, -1] = 0.0
        return node, weight

    def vector(self):
        """Return an empty vector of this level's unknowns. Collective."""
        return PETSc.Vec().createMPI((self.held.size, None), bsize=self.dof, comm=self.comm)


def _joined_nodes(n, degree):
    """The nodes of ``n`` elements that remain when they are joined in pairs."""
    pairs = np.arange(0, 2 * degree * (n // 2) + 1, 2)
    return np.concatenate([pairs, pairs[-1] + np.arange(1, degree + 1)]) if n % 2 else pairs


def lagrange(nodes, x):
    """Return the weights (n, m) at ``x`` (n,) of polynomials with values at ``nodes`` (n, m)."""
    diagonal = np.eye(nodes.shape[1])
    distances = nodes[:, :, None] - nodes[:, None, :] + diagonal
    factors = np.where(diagonal > 0.0, 1.0, x[:, None, None] - nodes[:, None, :])
    return np.prod(factors / distances, axis=2)


def _shell(comm, sets, vector, level):
    """A DM of the fields ``sets``; ``level(names)`` gives their `NodeLevel` or None."""
    names = list(sets)

    def decompose(dm):
        return list(names), list(sets.values()), [
            _block(comm, {name: sets[name]}, level)[1] for name in names]

    def sub_dm(dm, fields):
        if max(fields) >= len(names):
            known = ", ".join(f"{number} {name}" for number, name in enumerate(names))
            raise ParameterError("pc_fieldsplit_..._fields", ",".join(map(str, fields)),
                                 f"the fields of this model are {known}", prefix="")
        return _block(comm, {names[k]: sets[names[k]] for k in fields}, level)

    dm = PETSc.DMShell().create(comm=comm)
    dm.setGlobalVector(vector)
    dm.setCreateFieldDecomposition(decompose)
    dm.setCreateSubDM(sub_dm)
    return dm


def _block(comm, chosen, level):
    """The index set and the DM of the ``chosen`` fields together."""
    joined = PETSc.IS().createGeneral(
        np.sort(np.concatenate([part.indices for part in chosen.values()])), comm=comm)
    vector = PETSc.Vec().createMPI((joined.getLocalSize(), None), comm=comm)
    # Each rank's numbers are contiguous within the block.
    start = vector.getOwnershipRange()[0]
    inner = {name: PETSc.IS().createGeneral(
        (start + np.searchsorted(joined.indices, part.indices)).astype(PETSc.IntType), comm=comm)
        for name, part in chosen.items()}
    dm = _shell(comm, inner, vector, level)
    nodes = level(list(chosen))
    if nodes:
        _add_levels(dm, nodes)
        dm.setRefineLevel(nodes.depth)
    return joined, dm


def _add_levels(dm, nodes, finer=None):
    """Let PCMG coarsen ``dm``, and interpolate from it to the ``finer`` level."""

    def coarsen(dm, comm):
        coarse = nodes.coarser()
        shell = PETSc.DMShell().create(comm=nodes.comm)
        shell.setGlobalVector(coarse.vector())
        _add_levels(shell, coarse, nodes)
        return shell

    dm.setCoarsen(coarsen)
    if finer:
        dm.setCreateInterpolation(lambda coarse, fine: (nodes.interpolation(finer), None))
