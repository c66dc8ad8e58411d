"""The structured grid on DMDA: numbering, fields, this rank's elements, ghost exchange.

Two DMDAs in a DMComposite hold the unknowns: the first has velocity and fluidity at the Q2 nodes,
and the second has the pressure at the corners.

A rank owns elements, and the nodes on their lower sides along each axis. It also evaluates the
layer of its neighbours' elements on these sides, so that every row that it owns is complete:
residual and Jacobian need one ghost exchange of the unknowns and no other communication.
"""

from types import SimpleNamespace

import numpy as np
from petsc4py import PETSc

from ..kinematics import PLANE, SOLID
from ..options import ParameterError
from .element import SIDES, Geometry, element


def _strides(sizes):
    """Distances in memory of neighbours along each axis, x1 fastest, (dim,)."""
    return np.concatenate([[1], np.cumprod(sizes[:-1])])


def _shaped(values, sizes):
    """Values (..., n) as (..., n_3, n_2, n_1) for the sizes of the axes."""
    return values.reshape(*values.shape[:-1], *sizes[::-1])


def indices(ranges):
    """Return the indices (dim, n) in ranges (start, stop) of each axis, x1 fastest."""
    found = np.meshgrid(*(np.arange(*span) for span in ranges[::-1]), indexing="ij")
    return np.array([part.ravel() for part in found[::-1]])


class Lattice:
    """The points of one DMDA on this rank: Q2 nodes or corners, x1 fastest, ghosts included.

    ``index`` (dim, n) are global indices, below zero or beyond the end if periodic, ``ranges`` the
    (start, stop) of the owned ones along each axis, and ``owned`` (n_owned,) the local positions of
    the owned points in global order.
    """

    def __init__(self, comm, shape, periodic, parts, per_element, dof):
        kind, split = PETSc.DM.BoundaryType, []
        for part, wrap in zip(parts, periodic):
            split.append(per_element * np.asarray(part, dtype=PETSc.IntType))
            split[-1][-1] += not wrap
        self.per_element, self.dof = per_element, dof
        self.shape = tuple(per_element * n + (not wrap) for n, wrap in zip(shape, periodic))
        self.dm = PETSc.DMDA().create(
            dim=len(shape), dof=dof, sizes=self.shape, proc_sizes=[len(part) for part in parts],
            boundary_type=tuple(kind.PERIODIC if wrap else kind.NONE for wrap in periodic),
            stencil_type=PETSc.DMDA.StencilType.BOX, stencil_width=per_element,
            ownership_ranges=split, comm=comm)
        ghosts, self.ranges = self.dm.getGhostRanges(), self.dm.getRanges()
        self.index = indices(ghosts)
        self._start = [start for start, _ in ghosts]
        self._strides = _strides([stop - start for start, stop in ghosts])
        self.owned = self.position(*indices(self.ranges))
        self.owned_unknowns = (self.owned[:, None] * dof + np.arange(dof)).ravel()
        self.size = self.index.shape[1]

    def position(self, *index):
        """Return the local positions of global indices along each axis."""
        return sum((part - start) * stride
                   for part, start, stride in zip(index, self._start, self._strides))

    def owns(self, index):
        """Return whether this rank owns the point of an ``index`` (dim,)."""
        return all(start <= part < stop for part, (start, stop) in zip(index, self.ranges))


class Grid:
    """A structured grid of Q2-Q1 elements over ranks.

    The local unknowns of a rank are one array: node by node v1, v2, ... (and g), then the pressures
    of the corners, ghosts included. Raises `ParameterError` if there are too many ranks.

    Attributes
    ----------
    shape : tuple of int
        Elements along each axis.
    element_nodes, element_corners, element_unknowns : ndarray, (..., n)
        Local nodes, corners and unknowns of each element, the last block by block.
    blocks : dict
        The rows of ``element_unknowns`` of v1, v2, ..., g and P, {name: slice}.
    elements : SimpleNamespace
        The local elements, with attributes of a `Lattice`: shape, index, ranges and owned.
    """

    def __init__(self, comm, shape, periodic=None, fluidity=True, kinematics=None):
        self.comm, self.shape, self.dim = comm, tuple(shape), len(shape)
        self.kinematics = kinematics or (SOLID if self.dim == 3 else PLANE)
        self.periodic = tuple(periodic or (False,) * self.dim)
        self.element = e = element(self.dim)
        self.velocities = tuple(f"v{c + 1}" for c in range(self.kinematics.velocities))
        self.fields = self.velocities + (("g",) if fluidity else ())
        self.dof, self.has_fluidity = len(self.fields), fluidity
        self.blocks, rows = {}, 0
        for name, size in [*((field, e.nodes) for field in self.fields), ("P", e.corners)]:
            self.blocks[name] = slice(rows, rows + size)
            rows += size
        self._parts, self._cells = self._partition(), {}
        self.nodes = Lattice(comm, shape, self.periodic, self._parts, 2, self.dof)
        self.corners = Lattice(comm, shape, self.periodic, self._parts, 1, 1)
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
        """The numbers of elements of the ranks along each axis, which a DMDA chooses."""
        try:
            cells = PETSc.DMDA().create(dim=self.dim, dof=1, sizes=self.shape, stencil_width=0,
                                        comm=self.comm)
        except PETSc.Error:
            raise ParameterError(
                "n", self.comm.size, f"{self.comm.size} ranks are too many for "
                f"{' x '.join(map(str, self.shape))} elements, or do not divide them",
                prefix="") from None
        return [np.array(part) for part in cells.getOwnershipRanges()]

    def _number_elements(self):
        """Number the elements of this rank, and their nodes and unknowns."""
        ranges = [(start, min(stop, n))
                  for (start, stop), n in zip(self.corners.ranges, self.shape)]
        index = indices([(start - (wrap or start > 0), stop)
                         for (start, stop), wrap in zip(ranges, self.periodic)])
        self.n_elements = index.shape[1]
        owned = np.all([part >= start for part, (start, _) in zip(index, ranges)], axis=0)
        self.elements = SimpleNamespace(shape=self.shape, index=index, ranges=ranges,
                                        owned=np.flatnonzero(owned))
        e = self.element
        self.element_nodes = self.nodes.position(*(2 * index[:, None] + e.offsets[:, :, None]))
        self.element_corners = self.corners.position(*(
            index[:, None] + e.corner_offsets[:, :, None]))
        self.element_unknowns = np.concatenate(
            [self.element_nodes * self.dof + field for field in range(self.dof)]
            + [self.n_flow + self.element_corners])

    def layer(self, side):
        """Return how many elements lie between the local elements and a side, (n_elements,) int."""
        axis, end = SIDES[side]
        index = self.elements.index[axis]
        return index if end < 0 else self.shape[axis] - 1 - index

    def side_elements(self, side):
        """Return the local elements, owned or not, that lie on a side of the domain."""
        return np.flatnonzero(self.layer(side) == 0)

    def side_nodes(self, side):
        """Return the local nodes (k, n) of `side_elements`."""
        return self.element_nodes[self.element.side_nodes[side]][:, self.side_elements(side)]

    def geometry(self, x, elements=slice(None), rule=None):
        """Return the `Geometry` of local elements with the nodes ``x`` (dim, n_nodes), d."""
        return Geometry(x[:, self.element_nodes[:, elements]], rule, self.kinematics.axisymmetric)

    def corner_nodes(self):
        """Return the local nodes (n_corners,) of the corners."""
        return self.nodes.position(*(2 * self.corners.index))

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
        """Return views of the local unknowns: velocity (c, n), fluidity (n,) or None, pressure."""
        flow, c = local[:self.n_flow].reshape(-1, self.dof), len(self.velocities)
        return flow[:, :c].T, flow[:, c] if self.has_fluidity else None, local[self.n_flow:]

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
        flow, c = flow.reshape(-1, self.dof), len(self.velocities)
        sets = {"velocity": flow[:, :c].ravel(), "fluidity": flow[:, c:], "pressure": pressure}
        return {name: PETSc.IS().createGeneral(numbers.ravel(), comm=self.comm)
                for name, numbers in sets.items() if name != "fluidity" or self.has_fluidity}

    def part_sets(self):
        """Return the index sets of all unknowns at nodes and of the pressures. Collective."""
        return self.dm.getGlobalISs()

    def largest(self, values):
        """Return the entry of largest size among the ``values`` (n,) of all ranks. Collective."""
        return max(self.comm.tompi4py().allgather(values[np.argmax(np.abs(values))]), key=abs)

    def element_ring(self, values):
        """Return values (..., m) of owned elements with a ring of neighbours. Collective.

        The result (..., n_2 + 2, n_1 + 2) is zero outside the domain; in three dimensions it is
        (..., n_3 + 2, n_2 + 2, n_1 + 2).
        """
        before = values.shape[:-1]
        dof = int(np.prod(before))
        if dof not in self._cells:
            kind = PETSc.DM.BoundaryType
            dm = PETSc.DMDA().create(
                dim=self.dim, dof=dof, sizes=self.shape,
                proc_sizes=[len(part) for part in self._parts],
                boundary_type=tuple(kind.PERIODIC if wrap else kind.GHOSTED
                                    for wrap in self.periodic),
                stencil_type=PETSc.DMDA.StencilType.BOX, stencil_width=1,
                ownership_ranges=[part.astype(PETSc.IntType) for part in self._parts],
                comm=self.comm)
            self._cells[dof] = dm, dm.createGlobalVec(), dm.createLocalVec()
        dm, owned, ring = self._cells[dof]
        owned.setArray(values.reshape(dof, -1).T.ravel())  # element by element
        dm.globalToLocal(owned, ring)
        return _shaped(ring.array_r.reshape(-1, dof).T.reshape(*before, -1), [
            stop - start + 2 for start, stop in self.elements.ranges]).copy()

    def with_ghost_elements(self, values):
        """Return values (..., n) of all local elements from the owned ones (..., m). Collective."""
        place = tuple(part - start + 1 for part, (start, _) in zip(
            self.elements.index, self.elements.ranges))
        return self.element_ring(values)[(..., *place[::-1])]

    def period(self, values):
        """Return the change (dim, k) of nodal values (k, n_nodes) across a period. Collective.

        It is zero along an axis that is not periodic.
        """
        nodes, found = self.nodes, np.zeros((self.dim, len(values)))
        origin = np.zeros(self.dim, dtype=int)
        for axis in np.flatnonzero(self.periodic):
            last, end = origin.copy(), origin.copy()
            last[axis], end[axis] = nodes.shape[axis] - 1, nodes.shape[axis]
            if nodes.owns(last):
                found[axis] += values[:, nodes.position(*end)]
            if nodes.owns(origin):
                found[axis] -= values[:, nodes.position(*origin)]
        return self.comm.tompi4py().allreduce(found)

    def sum_at_nodes(self, values):
        """Return sums (n_nodes,) of ``values`` (nodes, n) of elements, complete at owned nodes."""
        return np.bincount(self.element_nodes.ravel(), values.ravel(), minlength=self.nodes.size)

    def at_nodes(self, values):
        """Return nodal values (..., n_nodes) of fields at the Gauss points, (..., points, n).

        The polynomials of the elements are averaged at each node; complete at owned nodes.
        """
        if values.ndim > 2:
            return np.array([self.at_nodes(part) for part in values])
        total = self.sum_at_nodes(self.element.gauss_to_nodes @ values)
        return total / np.maximum(self.sum_at_nodes(np.ones_like(values)), 1.0)

    def corner_field(self, corners):
        """Return nodal values (n_nodes,) of corner values (n_corners,); 1 at unused ghosts."""
        nodal = np.ones(self.nodes.size)
        nodal[self.element_nodes] = self.element.corner_at_nodes @ corners[self.element_corners]
        return nodal

    def gradient(self, values, x):
        """Return d values_c/d x_k and values_c/r at the Gauss points of a mesh with nodes ``x``.

        Their shapes are (c, dim, points, n) and (c, points, n) for nodal ``values`` (c, n_nodes).
        The latter is None without rotational symmetry.
        """
        geometry, over_r = self.geometry(x), None
        nodal = values[:, self.element_nodes]
        if self.kinematics.axisymmetric:
            over_r = (self.element.shape @ nodal) * geometry.over_r
        return np.array([geometry.gradient(part) for part in nodal]), over_r
