"""The unknowns as PETSc's preconditioners see them: fields by name, and coarser grids.

The fields velocity, fluidity and pressure can be split one by one or joined. A block
of velocity and fluidity knows its coarser grids. Options therefore suffice to choose the
preconditioner::

    -pc_type fieldsplit -pc_fieldsplit_0_fields 0,1 -pc_fieldsplit_1_fields 2
    -fieldsplit_0_pc_type mg

Multigrid joins elements in pairs, in both directions; of an odd number the last one stays as it
is. The interpolation is that of the Q2 elements themselves, whose spaces are nested, and coarse
operators are Galerkin products.
"""

import numpy as np
from petsc4py import PETSc

from ..options import ParameterError
from ..versions import set_schur_matrix
from .element import Geometry
from .schur import SchurPreconditioner


def field_shell(form):
    """Return a DM that knows the fields by name and the coarser grids of a block. Collective.

    PCFIELDSPLIT takes its splits from this DM: one by one by name, or joined by number with
    ``-pc_fieldsplit_0_fields 0,1``; the prefixes are those of PETSc. Corrections of coarser
    grids do not change the prescribed unknowns.
    """
    grid = form.grid
    return _shell(grid.comm, grid.field_sets(), grid.create_vector(),
                  lambda names: node_level(form, names))


def node_level(form, names):
    """Return the `NodeLevel` of the fields ``names``, None where pressure is one of them."""
    if "pressure" in names:
        return None
    grid = form.grid
    velocity, fluidity, _ = grid.split(form.held)
    held = {"velocity": [*velocity], "fluidity": [fluidity]}
    held = np.array(sum((held[name] for name in names), []))[:, grid.nodes.owned]
    starts = [np.concatenate([[0], np.cumsum(part)])
              for part in grid.nodes.dm.getOwnershipRanges()]
    at = [np.arange(2 * n + 1.0) for n in grid.shape]
    level = NodeLevel(grid.comm, at, grid.periodic, starts, len(held), held.T.ravel())
    few = np.ceil(np.log2(max(1.0, np.prod(grid.shape) / form.case.max_coarse_elements)) / 2.0)
    level.depth = min(level.coarsenings, max(resolving(form), int(few)))
    return level


def resolving(form):
    """Return how often elements can be joined in pairs until they just resolve what couples.

    At least once. `pgran.cases.Case.max_coarse_size` says how large they may be. Collective.
    """
    grid = form.grid
    x = form.case.coordinates(grid.nodes.i, grid.nodes.j)
    area, = grid.comm.tompi4py().allreduce(form.integrals(
        np.empty((0, grid.nodes.size)), Geometry(x[:, grid.element_nodes])))
    side = form.case.max_coarse_size * form.material.model.length
    return max(1, int(np.floor(np.log2(side * np.sqrt(np.prod(grid.shape) / area)))))


def corner_level(form):
    """Return the level of the pressures, whose interpolation is linear."""
    corners = form.grid.corners
    starts = [np.concatenate([[0], np.cumsum(part)]) for part in corners.dm.getOwnershipRanges()]
    held = form.grid.split(form.held)[2][corners.owned]
    return NodeLevel(form.grid.comm, [np.arange(n + 1.0) for n in form.grid.shape],
                     form.grid.periodic, starts, 1, held, degree=1)


def configure(ksp, form):
    """Hand PCFIELDSPLIT what ``-pc_fieldsplit_schur_precondition user`` asks for. Collective.

    Returns a `SchurPreconditioner` to fill, or None where the options ask for something else.
    """
    pc = ksp.getPC()
    prefix = pc.getOptionsPrefix() or ""
    asked = PETSc.Options().getString(f"{prefix}pc_fieldsplit_schur_precondition", "")
    if pc.getType() != PETSc.PC.Type.FIELDSPLIT or asked != "user":
        return None
    schur = SchurPreconditioner(form)
    set_schur_matrix(pc, schur.viscous)
    return schur


class NodeLevel:
    """The nodes of one grid of a hierarchy, numbered as the unknowns of a block are.

    A rank owns the coarse nodes that coincide with its fine ones.

    Parameters
    ----------
    comm : PETSc.Comm
    at : tuple of ndarray
        Where the nodes are along x1 and x2, in any unit; a periodic grid ends with its first node.
    periodic : tuple of bool
    starts : list of ndarray
        First node index of each part of the ranks, and the end, in x1 and x2.
    dof : int
        Unknowns of a node.
    held : ndarray of bool, (n_owned,)
        Which unknowns are prescribed, node by node.
    kept : tuple of ndarray, optional
        The nodes of the finer level that this one has, along x1 and x2, as ``at`` has them.
    degree : int
        2 for Q2 nodes, 1 for corners.

    Attributes
    ----------
    shape : tuple of int
        Elements along x1 and x2.
    depth : int
        How many coarser levels are worth having.
    """

    depth = 0

    def __init__(self, comm, at, periodic, starts, dof, held, kept=None, degree=2):
        self.comm, self.at, self.periodic, self.starts = comm, at, periodic, starts
        self.dof, self.held, self.kept, self.degree = dof, held, kept, degree
        self.shape = tuple((len(x) - 1) // degree for x in at)
        part = comm.rank % (len(starts[0]) - 1), comm.rank // (len(starts[0]) - 1)
        self.range = [(start[k], start[k + 1]) for start, k in zip(starts, part)]
        counts = np.outer(np.diff(starts[1]), np.diff(starts[0])).ravel()
        self._first = np.concatenate([[0], np.cumsum(counts)])

    @property
    def coarsenings(self):
        """How often elements can be joined, until one is left."""
        return (max(self.shape) - 1).bit_length()

    def coarser(self):
        """Return the `NodeLevel` of elements joined in pairs. Collective.

        Raises `ParameterError` if there is only one element.
        """
        if not self.coarsenings:
            raise ParameterError("pc_mg_levels", None, "too many, as one element cannot be joined "
                                 "with others", prefix="")
        kept = [_joined_nodes(n, self.degree) for n in self.shape]
        mine = np.ix_(*(np.isin(np.arange(*span), nodes)
                        for span, nodes in zip(reversed(self.range), reversed(kept))))
        held = self.held.reshape([np.diff(span)[0] for span in reversed(self.range)] + [self.dof])
        return NodeLevel(self.comm, [x[nodes] for x, nodes in zip(self.at, kept)], self.periodic,
                         [np.searchsorted(nodes, start) for nodes, start in zip(kept, self.starts)],
                         self.dof, held[mine].ravel(), kept, self.degree)

    def number(self, i, j):
        """Return the place of nodes among those of all ranks; ``i``, ``j`` global indices."""
        parts = [np.searchsorted(start, index, side="right") - 1
                 for start, index in zip(self.starts, (i, j))]
        (i0, i1), (j0, _) = [(start[part], start[part + 1])
                             for start, part in zip(self.starts, parts)]
        rank = parts[1] * (len(self.starts[0]) - 1) + parts[0]
        return self._first[rank] + (j - j0) * (i1 - i0) + i - i0

    def interpolation(self, fine):
        """Return the matrix that takes unknowns of this level to the next finer one. Collective.

        The elements' own interpolation between free unknowns, the identity between prescribed ones.
        """
        (i, across), (j, up) = (
            self._along(axis, fine.range[axis], fine.at[axis]) for axis in range(2))
        dof, n, around = self.dof, fine.held.size // self.dof, (self.degree + 1)**2
        weight = (up[:, None, :, None] * across[None, :, None, :]).reshape(n, around)
        node = self.number(i[None, :, None, :], j[:, None, :, None]).reshape(n, around)
        used = np.repeat(weight[:, None] != 0.0, dof, axis=1)  # (fine nodes, dof, coarse nodes)
        start = np.concatenate([[0], np.cumsum(used.sum(axis=2))])
        column = (node * dof)[:, None] + np.arange(dof)[:, None]
        value = np.where(fine.held.reshape(n, dof, 1), 0.0, weight[:, None])
        matrix = PETSc.Mat().createAIJ(
            ((fine.held.size, None), (self.held.size, None)), bsize=dof, comm=self.comm,
            csr=(start.astype(PETSc.IntType), column[used].astype(PETSc.IntType), value[used]))
        matrix.diagonalScale(None, self._free())
        (i0, i1), (j0, j1) = self.range
        j, i = (index.ravel() for index in np.mgrid[j0:j1, i0:i1])
        rows, columns = ((level.number(*nodes)[:, None] * dof + np.arange(dof)).ravel()[
            self.held].astype(PETSc.IntType) for level, nodes in (
                (fine, (self.kept[0][i], self.kept[1][j])), (self, (i, j))))
        matrix.setValuesIJV(np.arange(rows.size + 1, dtype=PETSc.IntType), columns,
                            np.ones(rows.size), rowmap=rows)
        matrix.assemble()
        return matrix

    def _along(self, axis, span, finer):
        """Nodes of this level (n, degree + 1) and their weights at fine nodes in one direction.

        The fine nodes are those of a ``span``, and ``finer`` says where all of them are.
        """
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

    def _free(self):
        vector = self.vector()
        vector.setArray(np.where(self.held, 0.0, 1.0))
        return vector

    def vector(self):
        """Return an empty vector of this level's unknowns. Collective."""
        return PETSc.Vec().createMPI((self.held.size, None), bsize=self.dof, comm=self.comm)


def _joined_nodes(n, degree):
    """The nodes of ``n`` elements that are left when they are joined in pairs."""
    pairs = np.arange(0, 2 * degree * (n // 2) + 1, 2)
    return np.concatenate([pairs, pairs[-1] + np.arange(1, degree + 1)]) if n % 2 else pairs


def lagrange(nodes, x):
    """The weights (n, m) at ``x`` (n,) of the polynomials through values at ``nodes`` (n, m)."""
    m = nodes.shape[1]
    apart = nodes[:, :, None] - nodes[:, None, :] + np.eye(m)
    there = np.where(np.eye(m, dtype=bool), 1.0, x[:, None, None] - nodes[:, None, :])
    return np.prod(there / apart, axis=2)


def _shell(comm, sets, vector, level):
    """A DM of the fields ``sets``; ``level(names)`` gives their `NodeLevel`, None where none is."""
    names = list(sets)

    def decompose(dm):
        return list(names), [sets[name] for name in names], [
            _block(comm, {name: sets[name]}, level) for name in names]

    def sub_dm(dm, fields):
        if max(fields) >= len(names):
            known = ", ".join(f"{number} {name}" for number, name in enumerate(names))
            raise ParameterError("pc_fieldsplit_..._fields", ",".join(map(str, fields)),
                                 f"the fields of this model are {known}", prefix="")
        chosen = {names[k]: sets[names[k]] for k in fields}
        return _joined(comm, chosen), _block(comm, chosen, level)

    dm = PETSc.DMShell().create(comm=comm)
    dm.setGlobalVector(vector)
    dm.setCreateFieldDecomposition(decompose)
    dm.setCreateSubDM(sub_dm)
    return dm


def _block(comm, chosen, level):
    joined = _joined(comm, chosen)
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
    return dm


def _joined(comm, sets):
    return PETSc.IS().createGeneral(
        np.sort(np.concatenate([part.indices for part in sets.values()])), comm=comm)


def _add_levels(dm, nodes, finer=None):
    """Let PCMG coarsen ``dm``, and interpolate from it to the ``finer`` level it came from."""

    def coarsen(dm, comm):
        coarse = nodes.coarser()
        shell = PETSc.DMShell().create(comm=nodes.comm)
        shell.setGlobalVector(coarse.vector())
        _add_levels(shell, coarse, nodes)
        return shell

    dm.setCoarsen(coarsen)
    if finer:
        dm.setCreateInterpolation(lambda coarse, fine: (nodes.interpolation(finer), None))
