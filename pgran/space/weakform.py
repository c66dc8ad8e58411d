"""Residual and Jacobian of the weak form over all elements of a rank at once.

For all test functions (w, h, q), with sigma = -P 1 + sigma'::

    phi rho_s (w, Dv/Dt) + (grad w, sigma) = <w, t> + (w, b)                 (2.2)
    tau (h, dg/dt) + A^2 d^2 (grad h, grad g) + (h, F) = 0                    (2.5), over xi^2
    -(q, div v) = 0                                                          (2.9)

Dv/Dt is dv/dt at nodes that move with the material, and dv/dt + (v.grad) v on a fixed mesh.
sigma', F, tau and A^2 d^2 come from the model (`pgran.material.models`), the tractions t and the
body force b from the case. The elements are worked on in batches that stay in the cache. Within
one, arrays are (Gauss points, n elements).
"""

import os
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from .. import cases
from ..material.elasticity import COMPONENTS, strain_fields
from ..material.models import WithDerivatives
from ..options import ParameterError
from . import element
from .chord import chord
from .element import DIM, NODES, POINTS
from .grid import Grid
from .matrix import Block, DofLayout, Field, InPlaceMatrix, ScatterAdd, fill

BATCH = 512
#: A nodal pressure below this share of the mean pressure of the elements around vanishes: what is
#: left of it is the error of the discretisation.
VANISHING = 1e-3
#: Bytes that an unknown takes at least: its rows of the matrix, and where they are.
LEAST_BYTES = 1000


def discretise(parameters, comm):
    """Return the `WeakForm` of resolved parameters on the ranks of ``comm``. Collective.

    Raises
    ------
    ParameterError
        If the parameters do not fit together.
    """
    model, law = parameters.part("model"), parameters.part("law")
    if not model.solved:
        raise ParameterError("model", parameters.model,
                             "only the linear theory knows this model; the solver does not")
    if model.needs_length and law.inverse_length_squared is None:
        raise ParameterError("model", parameters.model, f"@law {parameters.law} has no "
                             "cooperativity length; allowed is a local model such as li")
    case = cases.create(parameters)
    _check_size(parameters, case, comm)
    grid = Grid(comm, case.shape, case.periodic, fluidity=case.material.model.has_fluidity)
    return WeakForm(grid, case)


def _check_size(parameters, case, comm):
    """Refuse a grid that PETSc cannot number or this machine cannot hold."""
    (nx, ny), unknowns = case.shape, case.unknowns
    text = f"its {nx} x {ny} elements make {unknowns:.3g} unknowns"
    if unknowns > np.iinfo(PETSc.IntType).max:
        raise ParameterError("case", parameters.case, f"{text}, more than the indices of this "
                             "PETSc can count; larger elements, or a PETSc configured "
                             "--with-64-bit-indices")
    needed = LEAST_BYTES * unknowns / comm.size
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise ParameterError("case", parameters.case, f"{text}, which need at least "
                             f"{needed / 2**30:.3g} GB a rank, and this machine has "
                             f"{there / 2**30:.3g} GB; larger elements, or more machines")


def _batches(grid):
    """The elements of a rank, some whole rows at a time, or equal parts of a row, as slices."""
    n = grid.n_elements
    row = np.count_nonzero(grid.element_j == grid.element_j[0])
    if row <= BATCH:
        ends = np.arange(0, n, row * (BATCH // row))
    else:
        cuts = np.linspace(0, row, -(-row // BATCH), endpoint=False).astype(int)
        ends = (np.arange(0, n, row)[:, None] + cuts).ravel()
    return [slice(first, last) for first, last in zip(ends, [*ends[1:], n])]


@dataclass
class Increment:
    """What is fixed while Newton's method solves one time increment.

    Attributes
    ----------
    x : ndarray, (2, n_nodes)
        Coordinates of the mesh, d.
    stress : ndarray, (3, points, n)
        Old deviator S11, S22, S12, already turned with the material, stress.
    theta : float
        Compliance f/(G dt) of the elastic element; 0 for the rigid-viscous equations.
    prescribed, prescribed_rate : ndarray, (n_local,)
        Prescribed values, not numbers where an unknown is free, and their rates of change.
    geometry : pgran.space.element.Geometry
        The map of the elements.
    load : ndarray, (2, n_nodes)
        Nodal forces of the tractions, stress times d.
    decay : float
        eps in F + eps g, which limits the cooperativity length to A d/sqrt(eps); zero in the
        equations themselves.
    """

    x: np.ndarray
    stress: np.ndarray
    theta: float
    prescribed: np.ndarray
    prescribed_rate: np.ndarray
    geometry: object = field(repr=False)
    load: np.ndarray
    decay: float = 0.0


class WeakForm:
    """The discrete equations of a case on a grid.

    All arrays of unknowns are local ones, (grid.n_local,), as `Grid.to_local` gives them. Only
    making a form, and what creates or fills a matrix, is collective.

    Parameters
    ----------
    grid : pgran.space.grid.Grid
    case : pgran.cases.Case
    """

    def __init__(self, grid, case):
        self.grid, self.case, self.material = grid, case, case.material
        model = self.material.model
        density = self.material.bulk_density if case.parameters.inertia else 0.0
        self.storage = {"velocity": density, "fluidity": 0.0, **model.storage}
        self.convective = bool(density) and not case.moving
        self.batches = _batches(grid)
        self._yield_factor = case.yield_factor(grid.element_i, grid.element_j)
        self._weak = grid.comm.tompi4py().allreduce(
            bool((self._yield_factor != 1.0).any()), MPI.LOR)
        self.laws = [self._law_of(batch) for batch in self.batches]
        self._walls = [self._walls_of(batch) for batch in self.batches]
        self._surfaces = [self._surfaces_of(batch) for batch in self.batches]
        self.held = ~np.isnan(self.prescribed(0.0))
        self._lay_out_matrices()

    def _law_of(self, elements):
        """The law with the yield values of a slice of the local elements, or of their numbers."""
        law = self.material.law
        return law.weakened(self._yield_factor[elements]) if self._weak else law

    def _walls_of(self, batch):
        """The walls with g = g_loc in a batch: (side, places (m,) of elements, their law)."""
        if not self.grid.has_fluidity:
            return []
        walls = []
        for side in self.case.walls_of_local_fluidity:
            elements = self.grid.side_elements(side)
            here = elements[(batch.start <= elements) & (elements < batch.stop)] - batch.start
            if here.size:
                walls.append((side, here, self._law_of(batch.start + here)))
        return walls

    def _surfaces_of(self, batch):
        """The elements of a batch close to free surfaces: (rule, places (m,), their law).

        An element that is close to two of them has the rule of the closer one.
        """
        if not (self.grid.has_fluidity and self.case.free_surfaces):
            return []
        sides = self.case.free_surfaces
        layers = np.array([self.grid.layer(side)[batch] for side in sides])
        surfaces = []
        for number, side in enumerate(sides):
            mine = layers.argmin(axis=0) == number
            for layer, rule in enumerate(element.SURFACES[side]):
                here = np.flatnonzero(mine & (layers[number] == layer))
                if here.size:
                    surfaces.append((rule, here, self._law_of(batch.start + here)))
        return surfaces

    def _source_weight(self, weight, number):
        """The Gauss weights (points, n) of the fluidity source, zero where another rule holds."""
        if not self._surfaces[number]:
            return weight
        weight = weight.copy()
        for _, here, _ in self._surfaces[number]:
            weight[:, here] = 0.0
        return weight

    def increment(self, x, stress, theta, time, rate_from=None):
        """Return the `Increment` that ends at a time.

        ``x``, ``stress`` and ``theta`` are those of `Increment`; prescribed rates are differences
        from the time ``rate_from``, and zero without it.
        """
        values = self.prescribed(time)
        rates = np.zeros_like(values)
        if rate_from is not None and time > rate_from:
            rates = (values - self.prescribed(rate_from)) / (time - rate_from)
        load = np.zeros((DIM, self.grid.nodes.size))
        for side, traction in self.case.tractions(time).items():
            nodes = self.grid.side_nodes(side)
            force = element.side_force(x[:, nodes], traction)
            for i in range(DIM):
                load[i] += np.bincount(nodes.ravel(), force[i].ravel(),
                                       minlength=self.grid.nodes.size)
        return Increment(x, stress, theta, values, rates,
                         element.Geometry(x[:, self.grid.element_nodes]), load)

    def no_stress(self):
        """Return a deviator of zeros, (3, points, n)."""
        return np.zeros((COMPONENTS, POINTS, self.grid.n_elements))

    def prescribed(self, time):
        """Return the prescribed unknowns (n_local,) at a time, not a number where free."""
        nodes, corners, case = self.grid.nodes, self.grid.corners, self.case
        return self.grid.join(case.prescribed_velocity(time, nodes.i, nodes.j),
                              case.prescribed_fluidity(time, nodes.i, nodes.j),
                              case.prescribed_pressure(time, corners.i, corners.j))

    # Points

    def points(self, local, increment, number):
        """Return kinematics and response at the Gauss points of a batch, `BatchPoints`."""
        return BatchPoints(self, local, increment, number)

    def _collect(self, local, increment, quantity):
        """Return ``quantity(points)`` of all elements, (..., points, n)."""
        local = np.where(np.isnan(increment.prescribed), local, increment.prescribed)
        with np.errstate(invalid="ignore", divide="ignore"):
            parts = [quantity(self.points(local, increment, number))
                     for number in range(len(self.batches))]
        return np.concatenate(parts, axis=-1)

    def stress(self, local, increment):
        """Return the new stress deviator (3, points, n), stress."""
        return self._collect(local, increment, lambda p: p.deviator())

    def inertial_number(self, local, increment):
        """Return I of the plastic rate at the Gauss points, (points, n)."""
        return self._collect(local, increment, lambda p: p.response.inertial_number)

    def pressure(self, local, increment):
        """Return P at the Gauss points, (points, n), stress."""
        return self._collect(local, increment, lambda p: p.P)

    def stress_ratio(self, local, increment):
        """Return mu = tau/P at the Gauss points, (points, n)."""
        return self._collect(local, increment, lambda p: p.response.stress_ratio)

    def spurious_root(self, local, increment):
        """Return the largest mu_loc(I) - mu_s of elements at a spurious root of F. Collective.

        An element is at this root if all its Gauss points are, see `Model.spurious_root`. Without
        such elements the result is zero. With ``increment.decay`` equal to it the root is absent.
        """
        if not self.grid.has_fluidity:
            return 0.0
        excess = self._collect(local, increment, lambda p: p.spurious_root())
        worst = excess.min(axis=0)[self.grid.elements.owned]
        return self.grid.comm.tompi4py().allreduce(float(worst.max(initial=0.0)), MPI.MAX)

    def spin(self, velocity, x):
        """Return the spin (d v2/d x1 - d v1/d x2)/2, (points, n), of a nodal velocity (2, n_nodes).

        ``x`` (2, n_nodes) are the nodes, d.
        """
        (_, l12), (l21, _) = self.gradient(velocity, x)
        return (l21 - l12) / 2.0

    def gradient(self, values, x):
        """Return d values_i/d x_j, (2, 2, points, n), of nodal values (2, n_nodes) on nodes x."""
        nodes = self.grid.element_nodes
        geometry = element.Geometry(x[:, nodes])
        return np.array([geometry.gradient(part[nodes]) for part in values])

    def at_nodes(self, values):
        """Return nodal values (n_nodes,) of a field at the Gauss points, (points, n).

        The biquadratic through the points of each element, averaged over the
        elements of a node; complete at owned nodes.
        """
        total = self.grid.sum_at_nodes(element.GAUSS_TO_NODES @ values)
        return total / np.maximum(self.grid.sum_at_nodes(np.ones_like(values)), 1.0)

    def nodal_strains(self, velocity, x):
        """Return the `strain_fields` at the nodes, {name: ndarray}, from the Gauss points.

        ``strain_rate_tensor`` (3, n_nodes) and ``spin`` (n_nodes,), and where the mesh moves
        ``strain_tensor`` (3, n_nodes) and ``volume_change`` (n_nodes,) since the start, complete at
        owned nodes. ``velocity``, in d gdot0, and the nodes ``x``, in d, are (2, n_nodes).
        """
        start = None
        if self.case.moving:
            start = self.gradient(x, self.case.coordinates(self.grid.nodes.i, self.grid.nodes.j))
        found = strain_fields(self.gradient(velocity, x), start)
        return {name: self.at_nodes(values) if values.ndim == 2 else np.array(
            [self.at_nodes(part) for part in values]) for name, values in found.items()}

    def corner_field(self, corners):
        """Return nodal values (n_nodes,) of a Q1 field given at the corners, (n_corners,).

        Complete at owned nodes, 1 at ghosts that no local element has.
        """
        nodal = np.ones(self.grid.nodes.size)
        nodal[self.grid.element_nodes] = (
            element.CORNER_AT_NODES @ corners[self.grid.element_corners])
        return nodal

    def nodal_fields(self, local, increment):
        """Return ``fluidity``, ``pressure``, ``inertial_number`` and ``stress_ratio`` at the nodes.

        Arrays (n_nodes,), complete at owned nodes. mu comes from the Gauss points by `at_nodes`.
        For NGF g is nodal and I = g mu/s, but where the nodal pressure vanishes, and with it s, I
        comes from the Gauss points too. For LI both come from there.
        """
        _, fluidity, corners = self.grid.split(local)
        pressure = self.corner_field(corners)
        mu, I = (self.at_nodes(part) for part in (self.stress_ratio(local, increment),
                                                  self.inertial_number(local, increment)))
        if self.grid.has_fluidity:
            P = self._collect(local, increment, lambda p: p.P)
            around = self.at_nodes(np.broadcast_to(P.mean(axis=0), P.shape))
            borne = pressure > VANISHING * around
            I[borne] = (fluidity * mu)[borne] / self.material.inverse_time(pressure[borne])
        else:
            fluidity = self.at_nodes(
                self._collect(local, increment, lambda p: p.response.fluidity))
        return {"fluidity": fluidity, "pressure": pressure, "inertial_number": I,
                "stress_ratio": mu}

    # Energy

    def power(self, local, forces, increment):
        """Return the power that the material receives and the power that it dissipates. Collective.

        ::

            received   = sum over held nodes f.v + <t, v> + (b, v) + (sigma, L_0)
            dissipated = (sigma', D_p) = (g mu, mu P)

        ``forces`` (n_local,) are those of `forces`. For the solution, what is received is what is
        dissipated plus the rate of what is stored. Both in stress d^2 gdot0 (per unit depth).
        """
        grid, case = self.grid, self.case
        owned, base = grid.nodes.owned, case.base_gradient
        local = np.where(self.held, increment.prescribed, local)
        velocity, _, _ = grid.split(local)
        reaction, _, _ = grid.split(np.where(self.held, forces, 0.0))
        received = ((reaction + increment.load) * velocity)[:, owned].sum()

        def densities(p):
            answer = p.response
            dissipated = answer.fluidity * answer.stress_ratio**2 * p.P
            given = np.zeros_like(dissipated)
            if np.any(base):
                s11, s22, s12 = p.deviator()
                given += ((s11 - p.P) * base[0, 0] + (s22 - p.P) * base[1, 1]
                          + s12 * (base[0, 1] + base[1, 0]))
            if case.body_force is not None:
                given += (case.body_force(p.x) * p.velocity).sum(axis=0)
            return np.array([given, dissipated])

        weight = increment.geometry.weight
        inside, dissipated = self._over_elements(
            weight * self._collect(local, increment, densities))
        return grid.comm.tompi4py().allreduce(np.array([received + inside, dissipated]))

    def stored(self, local, stress, geometry):
        """Return the stored energy and the volume, stress d^2 and d^2 per unit depth. Collective.

        The energy is sigma':sigma'/(4 G) of the deviator ``stress`` (3, points, n), and with
        inertia also phi rho_s v^2/2.
        """
        s11, s22, s12 = stress
        energy = (s11**2 + s22**2 + 2.0 * s12**2) / (4.0 * self.material.G)
        if self.storage["velocity"]:
            velocity, _, _ = self.grid.split(local)
            nodal = velocity[:, self.grid.element_nodes]
            energy = energy + 0.5 * self.storage["velocity"] * sum(
                (element.SHAPE @ part)**2 for part in nodal)
        sums = self._over_elements(geometry.weight * np.array([energy, np.ones_like(energy)]))
        return self.grid.comm.tompi4py().allreduce(sums)

    def integrals(self, nodal, geometry):
        """Return the integrals of Q2 fields (k, n_nodes) and of one over the elements of this rank.

        (k + 1,), times d^2 per unit depth.
        """
        values = element.SHAPE @ np.array([*nodal, np.ones(nodal.shape[1])])[
            :, self.grid.element_nodes]
        return self._over_elements(geometry.weight * values)

    def side_integrals(self, nodal, x, side):
        """Return the integrals along a side of nodal fields (k, n_nodes) and of one, (k + 1,).

        They are over the elements that this rank owns, times d; ``x`` (2, n_nodes) are the nodes.
        """
        owned = np.isin(self.grid.side_elements(side), self.grid.elements.owned)
        nodes = self.grid.side_nodes(side)[:, owned]
        length = element.WEIGHTS_1D[:, None] * np.hypot(*(element.SIDE_SLOPE @ x[:, nodes]))
        values = element.SIDE_SHAPE @ np.array([*nodal, np.ones(nodal.shape[1])])[:, nodes]
        return (length * values).sum(axis=(1, 2))

    def _over_elements(self, values):
        """Sums (k,) of values (k, points, n) over the elements that this rank owns."""
        return values[..., self.grid.elements.owned].sum(axis=(1, 2))

    # Residual

    def residual(self, local, rate, increment):
        """Return the residual of the owned rows, (n_owned,).

        ``local`` are the unknowns and ``rate`` their time derivatives, (n_local,).
        Rows of prescribed unknowns hold value minus prescribed value.
        """
        total = self.forces(local, rate, increment)
        total[self.held] = (local - increment.prescribed)[self.held]
        return total[self.grid.owned]

    def reaction(self, forces, side):
        """Return the force (2,) of a side on the owned nodes of the material, stress times d.

        ``forces`` (n_local,) are those of `forces`.
        """
        nodes = np.intersect1d(self.grid.side_nodes(side), self.grid.nodes.owned)
        return self.grid.split(forces)[0][:, nodes].sum(axis=1)

    def forces(self, local, rate, increment):
        """Return the residual before the rows of prescribed unknowns are replaced, (n_local,).

        At held nodes the part of the velocity is the force on the material, stress times d.
        """
        grid = self.grid
        local = np.where(self.held, increment.prescribed, local)
        if any(self.storage.values()):
            rate = np.where(self.held, increment.prescribed_rate, rate)
        total = np.zeros(grid.n_local)
        with np.errstate(invalid="ignore", divide="ignore"):
            for number, (batch, sums) in enumerate(zip(self.batches, self._force_sums)):
                forces = np.empty((len(grid.element_unknowns), batch.stop - batch.start))
                self._element_forces(local, rate, increment, number, forces)
                for batch_sum in sums:
                    batch_sum.add(forces.ravel(), total)
        velocity, _, _ = grid.split(total)
        velocity -= increment.load
        return total

    def _element_forces(self, local, rate, increment, number, out):
        p, blocks = self.points(local, increment, number), self.grid.blocks
        unknowns = self.grid.element_unknowns[:, self.batches[number]]
        s11, s22, s12 = p.deviator()
        weight = p.geometry.weight
        slopes = element.SHAPE_SLOPE.reshape(DIM * POINTS, NODES).T
        case = self.case
        bodies = None if case.body_force is None else case.body_force(p.x) * weight

        def store(rows, coefficient):
            rates = element.SHAPE @ rate[unknowns[rows]]
            out[rows] += element.SHAPE.T @ (coefficient * weight * rates)

        for i, flux in enumerate(((s11 - p.P, s12), (s12, s22 - p.P))):
            rows = blocks[self.grid.velocities[i]]
            np.matmul(slopes, p.geometry.pull_back(flux).reshape(DIM * POINTS, -1), out=out[rows])
            if bodies is not None:
                out[rows] -= element.SHAPE.T @ bodies[i]
            if self.storage["velocity"]:
                store(rows, self.storage["velocity"])
            if self.convective:
                out[rows] += element.SHAPE.T @ (self.storage["velocity"] * weight * sum(
                    v * slope for v, slope in zip(p.total_velocity, p.gradients[i])))
        if self.grid.has_fluidity:
            flux = self.material.model.diffusion * p.geometry.gradient(p.nodal_g)
            source = self._source_weight(weight, number) * p.response.source.value
            if case.fluidity_source is not None:
                source -= weight * case.fluidity_source(p.x)
            out[blocks["g"]] = (slopes @ p.geometry.pull_back(flux).reshape(DIM * POINTS, -1)
                                + element.SHAPE.T @ source)
            for rule, here, law in self._surfaces[number]:
                surface = SurfacePoints(self, p, rule, here, law)
                out[blocks["g"]][:, here] += surface.tests.T @ (
                    surface.weight * surface.value.value)
            if self.storage["fluidity"]:
                store(blocks["g"], self.storage["fluidity"])
            for side, here, law in self._walls[number]:
                wall = WallPoints(self, p, side, here, law)
                out[(blocks["g"].start + wall.nodes)[:, None], here] = (
                    wall.tests.T @ (wall.weight * wall.value.value))
        out[blocks["P"]] = -element.CORNER_SHAPE.T @ (weight * p.divergence)

    # Jacobian

    def _lay_out_matrices(self):
        """Lay out the blocks of the element matrices in one array of entries, and the forces."""
        grid, count = self.grid, 0
        self._rows, self._matrices = {}, {}
        flow = [(row, column) for row in grid.fields for column in grid.fields]
        self._couplings = flow, [(row, "P") for row in grid.fields], [
            ("P", column) for column in grid.velocities]
        for row, column in sum(self._couplings, []):
            size = np.prod([len(grid.element_unknowns[grid.blocks[name]])
                            for name in (row, column)])
            self._rows[row, column] = slice(count, count + size)
            count += size
        self._force_sums, known = [], {}
        for batch in self.batches:
            rows, size = grid.element_unknowns[:, batch], batch.stop - batch.start
            flow = size * NODES * grid.dof
            parts = slice(0, flow), slice(flow, None)
            self._force_sums.append([ScatterAdd(part, rows.ravel()[part], grid.n_local, known)
                                     for part in parts])
        self._mass = None

    def _element_matrices(self, kind):
        """The element matrices of the Jacobian, [[...], ...]: one for all, or one for each block.

        Collective.
        """
        if kind not in self._matrices:
            self._matrices[kind] = self._whole() if kind == "aij" else self._blocks(
                kind == "blocked")
        return self._matrices[kind]

    def _field(self, name, pressure):
        """A `Field` by name; ``pressure`` numbers the part that has the corners."""
        if name == "P":
            return Field(pressure, 0, self.grid.element_corners)
        return Field(0, self.grid.fields.index(name), self.grid.element_nodes)

    def _whole(self):
        grid, (flow, right, below) = self.grid, self._couplings
        parts = [DofLayout(grid.nodes, grid.dof), DofLayout(grid.corners, 1)]
        groups = [[Block(*(self._field(name, 1) for name in pair)) for pair in pairs]
                  for pairs in (flow + right, below)]
        return [[InPlaceMatrix(
            grid, parts, parts, (grid.global_number, grid.global_number), (self.held, self.held),
            groups, self.batches)]]

    def _blocks(self, blocked):
        grid, (flow, right, below) = self.grid, self._couplings
        parts = [DofLayout(grid.nodes, grid.dof)], [DofLayout(grid.corners, 1)]
        numbers = [lattice.dm.getLGMap().indices for lattice in (grid.nodes, grid.corners)]
        held, first, found = np.split(self.held, [grid.n_flow]), 0, {}
        for row, column, pairs in (0, 0, flow), (0, 1, right), (1, 0, below), (1, 1, []):
            group = [Block(*(self._field(name, 0) for name in pair)) for pair in pairs]
            more = {"blocked": True} if blocked and row == column == 0 else {}
            found[row, column] = InPlaceMatrix(
                grid, parts[row], parts[column], (numbers[row], numbers[column]),
                (held[row], held[column]), [group] if group else [], self.batches, first, **more)
            first += found[row, column].entries
        return [[found[row, column] for column in range(2)] for row in range(2)]

    def create_matrix(self, kind="aij"):
        """Return an empty parallel matrix with the sparsity of the Jacobian. Collective.

        ``kind`` is aij for one matrix. With nest it has blocks, for the unknowns at nodes and for
        the pressures, and PCFIELDSPLIT takes the blocks as they are. With blocked the first of them
        is BAIJ, which multiplies twice as fast, but has no products with other matrices.
        """
        matrices = [[part.create() for part in row] for row in self._element_matrices(kind)]
        if kind == "aij":
            return matrices[0][0]
        sets = self.grid.part_sets()
        nest = PETSc.Mat().createNest(matrices, sets, sets, comm=self.grid.comm)
        nest.assemble()
        return nest

    def create_pressure_mass(self):
        """Return an empty matrix for `pressure_mass`. Collective."""
        grid = self.grid
        if self._mass is None:
            corners, pressure = [DofLayout(grid.corners, 1)], Field(0, 0, grid.element_corners)
            held, numbers = self.held[grid.n_flow:], grid.corners.dm.getLGMap().indices
            self._mass = InPlaceMatrix(
                grid, corners, corners, (numbers, numbers), (held, held),
                [[Block(pressure, pressure)]], self.batches)
        return self._mass.create()

    def fluidity_defect(self, rows, increment):
        """Return the residual of the fluidity equation at the nodes, (n_nodes,), gdot0. Collective.

        The ``rows`` (n_owned,) are those of `residual`; each is divided by the integral of its test
        function. Ghosts have the values of their owners.
        """
        grid, local = self.grid, np.zeros(self.grid.n_local)
        local[grid.owned] = rows
        local[self.held] = 0.0
        mass = grid.sum_at_nodes(element.SHAPE.T @ increment.geometry.weight)
        defect, owned = np.zeros((1, grid.nodes.size)), grid.nodes.owned
        defect[0, owned] = grid.split(local)[1][owned] / mass[owned]
        return grid.with_ghosts(defect)[0]

    def jacobian(self, local, shift, increment, matrix, defect=None, more=()):
        """Fill ``matrix`` with d(residual)/d(unknowns) + shift d(residual)/d(rates). Collective.

        Rows and columns of prescribed unknowns are those of the identity. With a ``defect``
        (n_nodes,) as `fluidity_defect` gives it, dF/dmu is that of the `chord` over which F falls
        by the defect. ``more`` are further parts and matrices for `pgran.space.matrix.fill`.
        """
        local = np.where(self.held, increment.prescribed, local)
        kind = "aij" if matrix.getType() != PETSc.Mat.Type.NEST else "blocked" if (
            matrix.getNestSubMatrix(0, 0).getType().endswith("baij")) else "nest"
        parts = [(part, matrix if kind == "aij" else matrix.getNestSubMatrix(row, column))
                 for row, parts in enumerate(self._element_matrices(kind))
                 for column, part in enumerate(parts)]
        with np.errstate(invalid="ignore", divide="ignore"):
            fill([*parts, *more], self.batches, lambda number, out: self._element_tangents(
                local, shift, increment, number, out, defect))
        matrix.assemble()

    def _element_tangents(self, local, shift, increment, number, out, defect=None):
        """The element matrices of a batch, block by block, (entries, n).

        With n = 2 D~/gdot~ and c = d(viscosity)/d(gdot~) gdot~, the stress changes by
        2 viscosity dD + c n (n:dD) + gdot~ n (viscosity_P dP + viscosity_g dg).
        """
        p, rows = self.points(local, increment, number), self._rows
        viscosity, source, geometry = p.response.viscosity, p.response.source, p.geometry
        surfaces = [SurfacePoints(self, p, *surface, defect) for surface in self._surfaces[number]]
        if defect is not None:
            source = p.chord_source(element.SHAPE @ defect[p.nodes])
        weight, inverse, n = geometry.weight, geometry.inverse, p.elements
        source_weight = self._source_weight(weight, number)

        def put(row, column, table, factors):
            np.matmul(table, factors.reshape(table.shape[1], n), out=out[rows[row, column]])

        def mass(field):
            """The mass matrix of a field that stores, or None."""
            coefficient = self.storage[field]
            return element.VALUE_VALUE @ (coefficient * shift * weight) if coefficient else None

        turned = p.direction_pulled_back()                     # n_ik d xi_r/d x_k
        viscous = weight * viscosity.value
        metric = np.einsum("krqe,ksqe->rsqe", inverse, inverse)
        tangent = weight * viscosity.rate * p.gdot if np.ndim(viscosity.rate) else None
        inertia = mass("velocity")
        if self.convective:  # (w, (v.grad) dv)
            carrying = np.einsum("kqe,ksqe->sqe", p.total_velocity, inverse) * weight
            carrying = element.VALUE_SLOPE @ (self.storage["velocity"] * carrying).reshape(-1, n)
            inertia = carrying if inertia is None else inertia + carrying
        for i, row in enumerate(self.grid.velocities):
            for j, column in enumerate(self.grid.velocities):
                factors = viscous * (inverse[j][:, None] * inverse[i][None, :])
                if i == j:
                    factors += viscous * metric
                if tangent is not None:
                    factors += tangent * (turned[i][:, None] * turned[j][None, :])
                put(row, column, element.SLOPE_SLOPE, factors)
                if i == j and inertia is not None:
                    out[rows[row, column]] += inertia
                if self.convective:  # (w, (dv.grad) v)
                    out[rows[row, column]] += element.VALUE_VALUE @ (
                        self.storage["velocity"] * weight * p.gradients[i][j])
            along = weight * p.gdot * turned[i]
            put(row, "P", element.SLOPE_CORNER, viscosity.pressure * along - weight * inverse[i])
            put("P", row, element.CORNER_SLOPE, -weight * inverse[i])
            if self.grid.has_fluidity:
                put(row, "g", element.SLOPE_VALUE, viscosity.fluidity * along)
                put("g", row, element.VALUE_SLOPE, source_weight * source.rate * turned[i])
        if self.grid.has_fluidity:
            put("g", "g", element.SLOPE_SLOPE, self.material.model.diffusion * weight * metric)
            out[rows["g", "g"]] += element.VALUE_VALUE @ (source_weight * source.fluidity)
            if self.storage["fluidity"]:
                out[rows["g", "g"]] += mass("fluidity")
            put("g", "P", element.VALUE_CORNER, source_weight * source.pressure)
            for surface in surfaces:
                for place, values in self._rule_tangents(p, surface):
                    out[place, surface.here] += values
            for side, here, law in self._walls[number]:
                # The rows of the fluidity of wall nodes are those of g = g_loc.
                for place, values in self._rule_tangents(
                        p, WallPoints(self, p, side, here, law)):
                    out[place, here] = values

    def _rule_tangents(self, p, found):
        """Yield where the derivatives of the rows of `RulePoints` belong, and these.

        Entries (nodes, columns, 1) of the element matrices, and values (nodes, columns, m).
        """
        rule, here, value = found.rule, found.here, found.value
        weight, mu = found.weight, p.stress_ratio_slopes()
        turned = p.direction_pulled_back()[..., here]

        def at(values):
            return np.broadcast_to(values, p.gdot.shape)[:, here]

        # mu = viscosity gdot/P at the Gauss points; what changes it there changes it at the rule's.
        by_mu = np.einsum("qa,qe,qp->ape", found.tests, weight * value.rate, rule.from_gauss)
        changes, rate = {"P": at(mu.pressure), "g": at(mu.fluidity)}, at(mu.rate)
        factors = {}
        for name, volume, shape, change in (
                ("P", element.CORNER_SHAPE, rule.corner_shape, value.pressure),
                ("g", element.SHAPE, rule.shape, value.fluidity)):
            factors[name] = (
                np.einsum("ape,pe,pb->abe", by_mu, changes[name], volume)
                + np.einsum("qa,qb,qe->abe", found.tests, shape, weight * change))
        for i, column in enumerate(self.grid.velocities):
            factors[column] = np.einsum("ape,rpb,rpe->abe", by_mu, element.SHAPE_SLOPE,
                                        rate * turned[i])
        for column, values in factors.items():
            first, columns = self._rows["g", column].start, values.shape[1]
            place = first + found.nodes[:, None] * columns + np.arange(columns)
            yield place[:, :, None], values

    def pressure_mass(self, local, increment, matrix):
        """Fill ``matrix`` with -(q, P/viscosity), close to the pressure Schur complement.

        Collective. Rows of prescribed pressures are those of the identity, as in the Jacobian.
        """
        local = np.where(self.held, increment.prescribed, local)

        def masses(number, out):
            p = self.points(local, increment, number)
            np.matmul(element.CORNER_CORNER,
                      -p.geometry.weight / p.response.viscosity.value, out=out)

        with np.errstate(invalid="ignore", divide="ignore"):
            fill([(self._mass, matrix)], self.batches, masses)

    def lumped_storage(self, shift, increment):
        """Return shift phi rho_s times the lumped mass of the owned velocities, (2 n_owned,).

        Node by node, in stress d^2/(d gdot0); None without inertia. ``shift`` in gdot0.
        """
        density = self.storage["velocity"]
        if not density:
            return None
        mass = self.grid.sum_at_nodes(element.SHAPE.T @ increment.geometry.weight)
        return density * shift * np.repeat(mass[self.grid.nodes.owned], DIM)


class BatchPoints:
    """Kinematics and response at the Gauss points of a batch of elements.

    Attributes
    ----------
    geometry : pgran.space.element.Geometry
    response : pgran.material.models.Response
    gradients : list
        gradients[i][j] = d v_i/d x_j, (points, n), base flow included.
    nodal : ndarray, (rows, n)
        Unknowns of the elements, block by block.
    d11, d22, d12, gdot, P, divergence : ndarray, (points, n)
        Effective strain rate D + theta S/2 and its size, pressure, and div v.
    nodal_g : ndarray, (nodes, n), or None
        Nodal fluidity.
    """

    def __init__(self, form, local, increment, number):
        grid, batch = form.grid, form.batches[number]
        self.nodal = nodal = local[grid.element_unknowns[:, batch]]
        self.elements = nodal.shape[1]
        self.geometry = increment.geometry[batch]
        self._base, theta = form.case.base_gradient, increment.theta
        self._nodal_velocity = [nodal[grid.blocks[name]] for name in grid.velocities]
        self.gradients = [self.geometry.gradient(part) + np.reshape(row, (DIM, 1, 1))
                          for part, row in zip(self._nodal_velocity, self._base)]
        (l11, l12), (l21, l22) = self.gradients
        s11, s22, s12 = increment.stress[:, :, batch] * (theta / 2.0)
        self.divergence = l11 + l22
        self.d11, self.d22, self.d12 = l11 + s11, l22 + s22, (l12 + l21) / 2.0 + s12
        self.gdot = np.sqrt(2.0 * (self.d11**2 + self.d22**2) + 4.0 * self.d12**2)
        self.P = element.CORNER_SHAPE @ nodal[grid.blocks["P"]]
        self.nodes, self._x = grid.element_nodes[:, batch], increment.x
        self.nodal_g = nodal[grid.blocks["g"]] if grid.has_fluidity else None
        fluidity = None if self.nodal_g is None else element.SHAPE @ self.nodal_g
        self._material, self._law = form.material, form.laws[number]
        self.response = form.material.model.response(
            self._law, form.material.inverse_time(self.P), self.gdot, self.P, fluidity, theta)
        self.decay = increment.decay
        if self.decay and fluidity is not None:
            _add_decay(self.response.source, self.decay, fluidity)

    @property
    def nodal_x(self):
        """Coordinates of the nodes, (2, nodes, n)."""
        return self._x[:, self.nodes]

    @property
    def x(self):
        """Coordinates of the points, (2, points, n)."""
        return element.SHAPE @ self.nodal_x

    @property
    def velocity(self):
        """Velocity at the points, base flow left out, (2, points, n)."""
        return np.array([element.SHAPE @ part for part in self._nodal_velocity])

    @property
    def total_velocity(self):
        """Velocity at the points with the base flow, (2, points, n), d gdot0."""
        return self.velocity + np.tensordot(self._base, self.x, 1)

    def deviator(self):
        """Return sigma' = 2 viscosity D~, (3, points, n): 11, 22, 12."""
        return 2.0 * self.response.viscosity.value * np.array([self.d11, self.d22, self.d12])

    def spurious_root(self):
        """Return `Model.spurious_root` at the points, (points, n)."""
        return self._material.model.spurious_root(
            self._law, self.response.stress_ratio, self.response.inertial_number)

    def stress_ratio_slopes(self):
        """Return mu = viscosity gdot~/P and its derivatives, a `WithDerivatives` of arrays (points, n)."""
        viscosity, mu = self.response.viscosity, self.response.stress_ratio
        return WithDerivatives(mu, rate=(viscosity.value + viscosity.rate * self.gdot) / self.P,
                        pressure=(viscosity.pressure * self.gdot - mu) / self.P,
                        fluidity=viscosity.fluidity * self.gdot / self.P)

    def chord_source(self, defect):
        """Return F with the slope in mu of the `chord` over which F falls by the ``defect``.

        A `WithDerivatives` in gdot0, as `Response` has it; the ``defect`` (points, n) in gdot0.
        """
        source, mu = self.response.source, self.stress_ratio_slopes()
        slope = source.rate / mu.rate
        curvature = self._material.model.curvature(
            self._law, self._material.inverse_time(self.P), mu.value, self.P,
            self.response.fluidity)
        change = chord(slope, curvature, -defect) - slope
        return WithDerivatives(source.value, *(
            getattr(source, name) + change * getattr(mu, name)
            for name in ("rate", "pressure", "fluidity")))

    def direction_pulled_back(self):
        """Return sum_k n_ik d xi_r/d x_k with n = 2 D~/gdot~ (0 at rest), (2, 2, points, n)."""
        scale = 2.0 / np.where(self.gdot > 0.0, self.gdot, np.inf)
        n11, n22, n12 = scale * self.d11, scale * self.d22, scale * self.d12
        inverse = self.geometry.inverse
        return np.array([n11 * inverse[0] + n12 * inverse[1],
                         n12 * inverse[0] + n22 * inverse[1]])


class RulePoints:
    """Points of another rule in some elements of a batch.

    mu comes from the Gauss points of the volume, where equilibrium holds it, by the biquadratic
    through them: the strain rate elsewhere would be divided by a fluidity or a pressure that may
    vanish there.

    Attributes
    ----------
    rule : pgran.space.element.Rule
    here : ndarray, (m,)
        Places of the elements in the batch.
    nodes : ndarray, (k,)
        The nodes of an element whose rows have this value.
    tests : ndarray, (rule points, k)
        Their shape functions.
    weight : ndarray, (rule points, m)
        Positive weights.
    arguments : tuple
        The law, s, mu, P and g at the points, as a model takes them.
    value : pgran.material.models.WithDerivatives
        What is integrated, (rule points, m), with its derivatives with respect to mu, P and g.
    """

    def __init__(self, form, p, rule, here, law, nodes):
        self.rule, self.here, self.nodes, blocks = rule, here, np.array(nodes), form.grid.blocks
        self.tests = rule.shape[:, self.nodes]
        self.weight = element.Geometry(p.nodal_x[..., here], rule).weight
        P = rule.corner_shape @ p.nodal[blocks["P"]][:, here]
        self.arguments = (law, form.material.inverse_time(P),
                          rule.from_gauss @ p.response.stress_ratio[:, here], P,
                          rule.shape @ p.nodal_g[:, here])


class WallPoints(RulePoints):
    """The condition g = g_loc at the Gauss points of the sides of elements on a wall.

    ``value`` is g - g_loc.
    """

    def __init__(self, form, p, side, here, law):
        super().__init__(form, p, element.SIDES[side], here, law, element.SIDE_NODES[side])
        self.value = form.material.model.fluidity_excess(*self.arguments)


def _add_decay(source, decay, g):
    """Add ``decay`` times the fluidity ``g`` to a source F, a `WithDerivatives`; see `Increment`."""
    source.value = source.value + decay * g
    source.fluidity = source.fluidity + decay


class SurfacePoints(RulePoints):
    """The source F of the fluidity equation close to a free surface.

    F is singular there if it contains g^2/s, since s goes to zero like the root of the depth. With
    a ``defect`` (n_nodes,) the slope in mu is that of the `chord`, as in `WeakForm.jacobian`.
    """

    def __init__(self, form, p, rule, here, law, defect=None):
        super().__init__(form, p, rule, here, law, range(NODES))
        model = form.material.model
        self.value = model.source(*self.arguments)
        if p.decay:
            _add_decay(self.value, p.decay, self.arguments[-1])
        if defect is not None:
            self.value.rate = chord(self.value.rate, model.curvature(*self.arguments),
                                    -(rule.shape @ defect[p.nodes[:, here]]))
