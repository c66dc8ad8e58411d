"""The structured grid on DMDA: numbering, fields, this rank's elements, ghost exchange.

Two DMDAs in a DMComposite hold the unknowns: the first has velocity and fluidity at the Q2 nodes,
and the second has the pressure at the corners.

A rank owns elements, and the nodes on their lower and left sides. It also evaluates the layer of
its neighbours' elements below and to the left, so that every row that it owns is complete: residual
and Jacobian need one ghost exchange of the unknowns and no other communication.
"""

from types import SimpleNamespace

import numpy as np
from petsc4py import PETSc

from ..options import ParameterError
from .element import (
    CORNER_AT_NODES,
    CORNERS,
    DIM,
    GAUSS_TO_NODES,
    NODES,
    SIDE_NODES,
    Geometry,
)


class Lattice:
    """The points of one DMDA on this rank: Q2 nodes or corners, x1 fastest, ghosts included.

    ``i`` and ``j`` (n,) are global indices, below zero or beyond the end if periodic, and ``owned``
    (n_owned,) the local positions of the owned points in global order.
    """

    def __init__(self, comm, shape, periodic, parts, per_element, dof):
        kind, ranges = PETSc.DM.BoundaryType, []
        for part, wrap in zip(parts, periodic):
            ranges.append(per_element * np.asarray(part, dtype=PETSc.IntType))
            ranges[-1][-1] += not wrap
        self.per_element, self.dof = per_element, dof
        self.shape = tuple(per_element * n + (not wrap) for n, wrap in zip(shape, periodic))
        self.dm = PETSc.DMDA().create(
            dim=2, dof=dof, sizes=self.shape, proc_sizes=[len(part) for part in parts],
            boundary_type=tuple(kind.PERIODIC if wrap else kind.NONE for wrap in periodic),
            stencil_type=PETSc.DMDA.StencilType.BOX, stencil_width=per_element,
            ownership_ranges=ranges, comm=comm)
        (i0, i1), (j0, j1) = self.dm.getGhostRanges()
        (self.i0, self.i1), (self.j0, self.j1) = self.dm.getRanges()
        self.ghost_start, self.row = (i0, j0), i1 - i0
        j, i = np.mgrid[j0:j1, i0:i1]
        self.i, self.j = i.ravel(), j.ravel()
        inside = (self.i0 <= self.i) & (self.i < self.i1) & (self.j0 <= self.j) & (self.j < self.j1)
        self.owned = np.flatnonzero(inside)
        self.owned_unknowns = (self.owned[:, None] * dof + np.arange(dof)).ravel()
        self.size = self.i.size

    def index(self, i, j):
        """Return the local positions of global indices ``i``, ``j``."""
        return (j - self.ghost_start[1]) * self.row + i - self.ghost_start[0]


class Grid:
    """A structured grid of Q2-Q1 elements over ranks.

    The local unknowns of a rank are one array: node by node v1, v2 (and g), then the pressures of
    the corners, ghosts included. Raises `ParameterError` if there are too many ranks.

    Attributes
    ----------
    shape : tuple of int
        Elements along x1 and x2.
    element_nodes, element_corners, element_unknowns : ndarray, (..., n)
        Local nodes, corners and unknowns of each element, the last block by block.
    blocks : dict
        The rows of ``element_unknowns`` of v1, v2, g and P, {name: slice}.
    elements : SimpleNamespace
        The local elements, with attributes of a `Lattice`: shape, i, j, owned, and the ranges i0 to
        i1 and j0 to j1 of the owned ones.
    """

    def __init__(self, comm, shape, periodic=(False, False), fluidity=True):
        self.comm, self.shape, self.periodic = comm, tuple(shape), tuple(periodic)
        self.velocities = tuple(f"v{i + 1}" for i in range(DIM))
        self.fields = self.velocities + (("g",) if fluidity else ())
        self.dof, self.has_fluidity = len(self.fields), fluidity
        self.blocks, rows = {}, 0
        for name, size in [*((field, NODES) for field in self.fields), ("P", CORNERS)]:
            self.blocks[name] = slice(rows, rows + size)
            rows += size
        self._parts, self._cells = self._partition(), {}
        self.nodes = Lattice(comm, shape, periodic, self._parts, 2, self.dof)
        self.corners = Lattice(comm, shape, periodic, self._parts, 1, 1)
        self.dm = PETSc.DMComposite().create(comm=comm)
        self.dm.addDM(self.nodes.dm)
        self.dm.addDM(self.corners.dm)
        self.dm.setUp()
        self._local = self.nodes.dm.createLocalVec(), self.corners.dm.createLocalVec()
        self.n_flow = self.nodes.size * self.dof
        self.n_local = self.n_flow + self.corners.size
        self.owned = np.concatenate([self.nodes.owned_unknowns,
                                     self.n_flow + self.corners.owned_unknowns])
        self.n_owned = self.owned.size
        self.global_number = np.concatenate([part.indices for part in self.dm.getLGMaps()])
        self._number_elements()

    def _partition(self):
        """The numbers of elements of the ranks in x1 and x2, which a DMDA chooses."""
        try:
            cells = PETSc.DMDA().create(dim=2, dof=1, sizes=self.shape, stencil_width=0,
                                        comm=self.comm)
        except PETSc.Error:
            raise ParameterError(
                "n", self.comm.size, f"{self.comm.size} ranks are too many for {self.shape[0]} x "
                f"{self.shape[1]} elements, or do not divide them", prefix="") from None
        return [np.array(part) for part in cells.getOwnershipRanges()]

    def _number_elements(self):
        """Number the elements of this rank, and their nodes and unknowns."""
        nodes, corners = self.nodes, self.corners
        below, left = (int(wrap or start > 0) for wrap, start in zip(
            self.periodic[::-1], (corners.j0, corners.i0)))
        i1, j1 = min(corners.i1, self.shape[0]), min(corners.j1, self.shape[1])
        j, i = np.mgrid[corners.j0 - below:j1, corners.i0 - left:i1]
        self.element_i, self.element_j = i.ravel(), j.ravel()
        self.n_elements = self.element_i.size
        owned = (self.element_i >= corners.i0) & (self.element_j >= corners.j0)
        self.elements = SimpleNamespace(
            shape=self.shape, i=self.element_i, j=self.element_j, owned=np.flatnonzero(owned),
            i0=corners.i0, j0=corners.j0, i1=i1, j1=j1)
        a, b = np.arange(NODES), np.arange(CORNERS)
        self.element_nodes = nodes.index(2 * self.element_i + a[:, None] % 3,
                                         2 * self.element_j + a[:, None] // 3)
        self.element_corners = corners.index(self.element_i + b[:, None] % 2,
                                             self.element_j + b[:, None] // 2)
        self.element_unknowns = np.concatenate(
            [self.element_nodes * self.dof + field for field in range(self.dof)]
            + [self.n_flow + self.element_corners])

    def layer(self, side):
        """Return how many elements lie between the local elements and a side, (n_elements,) int."""
        return {"left": self.element_i, "right": self.shape[0] - 1 - self.element_i,
                "bottom": self.element_j, "top": self.shape[1] - 1 - self.element_j}[side]

    def side_elements(self, side):
        """Return the local elements, owned or not, that lie on a side of the domain."""
        return np.flatnonzero(self.layer(side) == 0)

    def side_nodes(self, side):
        """Return the local nodes (3, n) of `side_elements`, in the order of `SIDE_NODES`."""
        return self.element_nodes[np.array(SIDE_NODES[side])][:, self.side_elements(side)]

    # Vectors

    def create_vector(self):
        """Return a global vector of all unknowns. Collective."""
        return self.dm.createGlobalVec()

    def to_local(self, vector):
        """Return the local unknowns (n_local,) of a global vector, ghosts included. Collective."""
        self.dm.scatter(vector, self._local)
        return np.concatenate([local.array_r for local in self._local])

    def from_local(self, local, vector):
        """Put the owned entries of local unknowns (n_local,) into a global vector. Collective."""
        vector.setArray(local[self.owned])

    def split(self, local):
        """Return views of the local unknowns: velocity (2, n), fluidity (n,) or None, pressure."""
        flow = local[:self.n_flow].reshape(-1, self.dof)
        return (flow[:, :DIM].T, flow[:, DIM] if self.has_fluidity else None,
                local[self.n_flow:])

    def join(self, velocity, fluidity, pressure):
        """Return the local unknowns (n_local,) of nodal fields or numbers; inverts `split`."""
        local = np.empty(self.n_local)
        for part, values in zip(self.split(local), (velocity, fluidity, pressure)):
            if part is not None:
                part[:] = values
        return local

    def field_sets(self):
        """Return {name: index set} of the fields that solvers may split. Collective."""
        flow, pressure = (part.indices for part in self.part_sets())
        flow = flow.reshape(-1, self.dof)
        sets = {"velocity": flow[:, :DIM].ravel(), "fluidity": flow[:, DIM:], "pressure": pressure}
        return {name: PETSc.IS().createGeneral(numbers.ravel(), comm=self.comm)
                for name, numbers in sets.items() if name != "fluidity" or self.has_fluidity}

    def part_sets(self):
        """Return the index sets of all unknowns at nodes and of the pressures. Collective."""
        return self.dm.getGlobalISs()

    def largest(self, values):
        """Return the entry of largest size among the ``values`` (n,) of all ranks. Collective."""
        return max(self.comm.tompi4py().allgather(values[np.argmax(np.abs(values))]), key=abs)

    def element_ring(self, values):
        """Return values (..., m) of owned elements as (..., rows + 2, columns + 2). Collective.

        A ring of neighbours surrounds the owned elements; it is zero outside the domain.
        """
        cells, before = self.elements, values.shape[:-1]
        dof = int(np.prod(before))
        if dof not in self._cells:
            kind = PETSc.DM.BoundaryType
            dm = PETSc.DMDA().create(
                dim=2, dof=dof, sizes=self.shape, proc_sizes=[len(part) for part in self._parts],
                boundary_type=tuple(kind.PERIODIC if wrap else kind.GHOSTED
                                    for wrap in self.periodic),
                stencil_type=PETSc.DMDA.StencilType.BOX, stencil_width=1,
                ownership_ranges=[part.astype(PETSc.IntType) for part in self._parts],
                comm=self.comm)
            self._cells[dof] = dm, dm.createGlobalVec(), dm.createLocalVec()
        dm, owned, ring = self._cells[dof]
        owned.setArray(values.reshape(dof, -1).T.ravel())  # element by element
        dm.globalToLocal(owned, ring)
        return ring.array_r.reshape(-1, dof).T.reshape(
            *before, cells.j1 - cells.j0 + 2, cells.i1 - cells.i0 + 2).copy()

    def with_ghost_elements(self, values):
        """Return values (..., n) of all local elements from the owned ones (..., m). Collective."""
        cells = self.elements
        return self.element_ring(values)[..., cells.j - cells.j0 + 1, cells.i - cells.i0 + 1]

    def period(self, values):
        """Return the change (2, k) of nodal values (k, n_nodes) across a period. Collective.

        It is along i and along j, and zero where the grid is not periodic.
        """
        nodes, found = self.nodes, np.zeros((DIM, len(values)))

        def owns(i, j):
            return nodes.i0 <= i < nodes.i1 and nodes.j0 <= j < nodes.j1

        for axis in np.flatnonzero(self.periodic):
            last, end = [0, 0], [0, 0]
            last[axis], end[axis] = nodes.shape[axis] - 1, nodes.shape[axis]
            if owns(*last):
                found[axis] += values[:, nodes.index(*end)]
            if owns(0, 0):
                found[axis] -= values[:, nodes.index(0, 0)]
        return self.comm.tompi4py().allreduce(found)

    def sum_at_nodes(self, values):
        """Return sums (n_nodes,) of ``values`` (nodes, n) of elements, complete at owned nodes."""
        return np.bincount(self.element_nodes.ravel(), values.ravel(), minlength=self.nodes.size)

    def at_nodes(self, values):
        """Return nodal values (..., n_nodes) of fields at the Gauss points, (..., points, n).

        The biquadratics of the elements are averaged at each node; complete at owned nodes.
        """
        if values.ndim > 2:
            return np.array([self.at_nodes(part) for part in values])
        total = self.sum_at_nodes(GAUSS_TO_NODES @ values)
        return total / np.maximum(self.sum_at_nodes(np.ones_like(values)), 1.0)

    def corner_field(self, corners):
        """Return nodal values (n_nodes,) of corner values (n_corners,); 1 at unused ghosts."""
        nodal = np.ones(self.nodes.size)
        nodal[self.element_nodes] = CORNER_AT_NODES @ corners[self.element_corners]
        return nodal

    def gradient(self, values, x):
        """Return d values_i/d x_j, (2, 2, points, n), of nodal values (2, n_nodes) on nodes x."""
        geometry = Geometry(x[:, self.element_nodes])
        return np.array([geometry.gradient(part[self.element_nodes]) for part in values])
