"""Residual and Jacobian of the weak form over all elements of a rank at once.

For all test functions (w, h, q), with sigma = -P 1 + sigma'::

    phi rho_s (w, Dv/Dt) + (grad w, sigma) = <w, t> + (w, b)                 (2.2)
    tau (h, dg/dt) + A^2 d^2 (grad h, grad g) + (h, F) = 0                    (2.5), over xi^2
    -(q, div v) = 0                                                          (2.9)

Dv/Dt is dv/dt at nodes that move with the material, and dv/dt + (v.grad) v on a fixed mesh.
sigma', F, tau and A^2 d^2 come from the model (`pgran.material.models`), the tractions t and the
body force b from the case. The elements are evaluated in batches that fit into the cache. Arrays of
a batch are (Gauss points, n elements).
"""

import os
from dataclasses import dataclass
from itertools import product

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from .. import cases
from ..material.elasticity import COMPONENTS
from ..options import ParameterError
from . import element
from .element import DIM, NODES, POINTS
from .grid import Grid
from .matrix import Field, InPlaceMatrix, ScatterAdd, Unknowns, fill
from .points import BatchPoints, SurfacePoints, WallPoints

BATCH = 512
#: Minimum memory of an unknown, for its rows of the matrix and their positions, bytes.
LEAST_BYTES = 1000


def discretise(parameters, comm):
    """Return the `WeakForm` of resolved parameters on the ranks of ``comm``. Collective.

    Raises `ParameterError` if the parameters are inconsistent.
    """
    model, law = parameters.part("model"), parameters.part("law")
    if not model.solved:
        raise ParameterError("model", parameters.model,
                             "only the linear theory knows this model; the solver does not")
    if model.needs_length and not law.inverse_length_squared:
        raise ParameterError("model", parameters.model, f"@law {parameters.law} has no "
                             "cooperativity length; use a local model such as li")
    case = cases.create(parameters)
    _check_size(parameters, case, comm)
    grid = Grid(comm, case.shape, case.periodic, fluidity=case.material.model.has_fluidity)
    return WeakForm(grid, case)


def _check_size(parameters, case, comm):
    """Refuse a grid that PETSc cannot number or this machine cannot hold."""
    (nx, ny), unknowns, problem = case.shape, case.unknowns, ""
    needed = LEAST_BYTES * unknowns / comm.size
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if unknowns > np.iinfo(PETSc.IntType).max:
        problem = ("more than the indices of this PETSc can count; larger elements, or a PETSc "
                   "configured --with-64-bit-indices")
    elif needed > memory:
        problem = (f"which need at least {needed / 2**30:.3g} GB per rank, and this machine has "
                   f"{memory / 2**30:.3g} GB; larger elements, or more machines")
    if problem:
        raise ParameterError("case", parameters.case, f"its {nx} x {ny} elements make "
                             f"{unknowns:.3g} unknowns, {problem}")


def _batches(grid):
    """The elements of a rank in slices of several complete rows, or of equal parts of a row."""
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
    """What is fixed while Newton's method solves one time step."""

    x: np.ndarray  #: Coordinates of the mesh, (2, n_nodes), d.
    #: Old deviator S11, S22, S12, already rotated with the material, (3, points, n), stress.
    stress: np.ndarray
    theta: float  #: Compliance f/(G dt) of the elastic element; 0 if rigid-viscous.
    prescribed: np.ndarray  #: Prescribed values, NaN where an unknown is free, (n_local,).
    prescribed_rate: np.ndarray  #: Their rates of change, (n_local,).
    geometry: element.Geometry
    load: np.ndarray  #: Nodal forces of the tractions, (2, n_nodes), stress times d.
    #: eps in F + eps g, which limits the cooperativity length to A d/sqrt(eps).
    decay: float = 0.0


class WeakForm:
    """The discrete equations of a case on a grid. Its creation is collective.

    All arrays of unknowns are local, (grid.n_local,), as `Grid.to_local` returns them.
    """

    def __init__(self, grid, case):
        self.grid, self.case, self.material = grid, case, case.material
        density = self.material.bulk_density if case.parameters.inertia else 0.0
        self.storage = {"velocity": density, "fluidity": 0.0, **self.material.model.storage}
        self.convective = bool(density) and not case.moving
        self.batches = _batches(grid)
        self._yield_factor = case.yield_factor(grid.element_i, grid.element_j)
        self.laws = [self._law_of(batch) for batch in self.batches]
        self._walls = [self._walls_of(batch) for batch in self.batches]
        self._surfaces = [self._surfaces_of(batch) for batch in self.batches]
        self.held = ~np.isnan(self.prescribed(0.0))
        self._lay_out_entries()

    def _law_of(self, elements):
        """The law with the yield values of a slice or of the numbers of local elements."""
        law, factor = self.material.law, self._yield_factor[elements]
        return law.weakened(factor) if (factor != 1.0).any() else law

    def _with_laws(self, batch, found):
        """(rule, positions (m,), law) for each (rule, bool array of a batch's elements)."""
        found = [(rule, np.flatnonzero(chosen)) for rule, chosen in found if chosen.any()]
        return [(rule, chosen, self._law_of(batch.start + chosen)) for rule, chosen in found]

    def _walls_of(self, batch):
        """The elements of a batch at walls with g = g_loc: (side, positions (m,), law)."""
        sides = self.case.walls_of_local_fluidity if self.grid.has_fluidity else ()
        return self._with_laws(batch, [(side, self.grid.layer(side)[batch] == 0)
                                       for side in sides])

    def _surfaces_of(self, batch):
        """The elements of a batch at free surfaces: (closest rule, positions (m,), law)."""
        sides = self.case.free_surfaces if self.grid.has_fluidity else ()
        layers = np.array([self.grid.layer(side)[batch] for side in sides])
        return self._with_laws(batch, [
            (rule, (layers.argmin(axis=0) == number) & (layers[number] == layer))
            for number, side in enumerate(sides)
            for layer, rule in enumerate(element.SURFACES[side])])

    def _source_weight(self, weight, number):
        """The Gauss weights (points, n) of the fluidity source, zero where another rule applies."""
        weight = weight.copy()
        for _, chosen, _ in self._surfaces[number]:
            weight[:, chosen] = 0.0
        return weight

    def increment(self, x, stress, theta, time, rate_from=None):
        """Return the `Increment` to a time, with prescribed rates since the time ``rate_from``."""
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
        """Return the prescribed unknowns (n_local,) at a time, NaN where free."""
        nodes, corners, case = self.grid.nodes, self.grid.corners, self.case
        return self.grid.join(case.prescribed_velocity(time, nodes.i, nodes.j),
                              case.prescribed_fluidity(time, nodes.i, nodes.j),
                              case.prescribed_pressure(time, corners.i, corners.j))

    # Values at the Gauss points

    def collect(self, local, increment, quantity):
        """Return ``quantity(points)`` of the `BatchPoints` of all elements, (..., points, n)."""
        local = np.where(np.isnan(increment.prescribed), local, increment.prescribed)
        with np.errstate(invalid="ignore", divide="ignore"):
            parts = [quantity(BatchPoints(self, local, increment, number))
                     for number in range(len(self.batches))]
        return np.concatenate(parts, axis=-1)

    def stress(self, local, increment):
        """Return the new stress deviator (3, points, n), stress."""
        return self.collect(local, increment, lambda p: p.deviator())

    def inertial_number(self, local, increment):
        """Return I of the plastic rate at the Gauss points, (points, n)."""
        return self.collect(local, increment, lambda p: p.response.inertial_number)

    def spurious_root(self, local, increment):
        """Return the largest `Model.spurious_root` over elements, or 0. Collective.

        The value of an element is the minimum over its Gauss points. With the result as
        ``increment.decay`` the root is absent.
        """
        if not self.grid.has_fluidity:
            return 0.0
        excess = self.collect(local, increment, lambda p: p.spurious_root())
        worst = excess.min(axis=0)[self.grid.elements.owned]
        return self.grid.comm.tompi4py().allreduce(float(worst.max(initial=0.0)), MPI.MAX)

    # Residual

    def residual(self, local, rate, increment):
        """Return the residual (n_owned,); prescribed unknowns have value minus prescribed value."""
        total = self.forces(local, rate, increment)
        total[self.held] = (local - increment.prescribed)[self.held]
        return total[self.grid.owned]

    def forces(self, local, rate, increment):
        """Return the residual (n_local,) with the forces on held nodes, stress times d."""
        grid = self.grid
        local = np.where(self.held, increment.prescribed, local)
        if any(self.storage.values()):
            rate = np.where(self.held, increment.prescribed_rate, rate)
        total = np.zeros(grid.n_local)
        with np.errstate(invalid="ignore", divide="ignore"):
            for number, (batch, sums) in enumerate(zip(self.batches, self._force_sums)):
                forces = np.empty((len(grid.element_unknowns), batch.stop - batch.start))
                self._element_forces(local, rate, increment, number, forces)
                for scatter in sums:
                    scatter.add(forces.ravel(), total)
        grid.split(total)[0][:] -= increment.load
        return total

    def _element_forces(self, local, rate, increment, number, out):
        """Put the forces of a batch into ``out``, (rows, n)."""
        p, blocks = BatchPoints(self, local, increment, number), self.grid.blocks
        unknowns = self.grid.element_unknowns[:, self.batches[number]]
        s11, s22, s12 = p.deviator()
        weight = p.geometry.weight
        slopes = element.SHAPE_SLOPE.reshape(DIM * POINTS, NODES).T
        case, density = self.case, self.storage["velocity"]
        bodies = case.body_force(p.x) * weight if case.body_force else None

        def store(rows, coefficient):
            rates = element.SHAPE @ rate[unknowns[rows]]
            out[rows] += element.SHAPE.T @ (coefficient * weight * rates)

        for i, flux in enumerate(((s11 - p.P, s12), (s12, s22 - p.P))):
            rows = blocks[self.grid.velocities[i]]
            np.matmul(slopes, p.geometry.pull_back(flux).reshape(DIM * POINTS, -1), out=out[rows])
            if bodies is not None:
                out[rows] -= element.SHAPE.T @ bodies[i]
            if density:
                store(rows, density)
            if self.convective:
                out[rows] += element.SHAPE.T @ (density * weight * sum(
                    v * slope for v, slope in zip(p.total_velocity, p.gradients[i])))
        if self.grid.has_fluidity:
            flux = self.material.model.diffusion * p.geometry.gradient(p.nodal_g)
            source = self._source_weight(weight, number) * p.response.source.value
            if case.fluidity_source is not None:
                source -= weight * case.fluidity_source(p.x)
            out[blocks["g"]] = (slopes @ p.geometry.pull_back(flux).reshape(DIM * POINTS, -1)
                                + element.SHAPE.T @ source)
            for rule, chosen, law in self._surfaces[number]:
                surface = SurfacePoints(self, p, rule, chosen, law)
                out[blocks["g"]][:, chosen] += surface.tests.T @ (
                    surface.weight * surface.value.value)
            if self.storage["fluidity"]:
                store(blocks["g"], self.storage["fluidity"])
            for side, chosen, law in self._walls[number]:
                wall = WallPoints(self, p, side, chosen, law)
                out[(blocks["g"].start + wall.nodes)[:, None], chosen] = (
                    wall.tests.T @ (wall.weight * wall.value.value))
        out[blocks["P"]] = -element.CORNER_SHAPE.T @ (weight * p.divergence)

    # Jacobian

    def _lay_out_entries(self):
        """Number the entries of the element matrices, block by block, and find the force sums."""
        grid, count = self.grid, 0
        self._rows, self._matrices = {}, {}
        fields = {name: Field(grid.nodes, number, grid.element_nodes)
                  for number, name in enumerate(grid.fields)}
        fields["P"] = Field(grid.corners, 0, grid.element_corners)
        self._couplings = []
        for names in (product(grid.fields, grid.fields), product(grid.fields, "P"),
                      product("P", grid.velocities)):
            self._couplings.append([])
            for row, column in names:
                size = len(fields[row].points) * len(fields[column].points)
                self._rows[row, column] = slice(count, count + size)
                self._couplings[-1].append((fields[row], fields[column]))
                count += size
        self._pressures = fields["P"]
        self._force_sums, known = [], {}
        for batch in self.batches:
            rows, flow = grid.element_unknowns[:, batch], (
                batch.stop - batch.start) * NODES * grid.dof
            self._force_sums.append([ScatterAdd(part, rows.ravel()[part], grid.n_local, known)
                                     for part in (slice(0, flow), slice(flow, None))])

    def _unknowns(self):
        """The `Unknowns` at the nodes and at the corners."""
        held = np.split(self.held, [self.grid.n_flow])
        return [Unknowns([lattice], lattice.dm.getLGMap().indices, part)
                for lattice, part in zip((self.grid.nodes, self.grid.corners), held)]

    def _element_matrices(self, kind):
        """The `InPlaceMatrix` of each block of a Jacobian, [[...], ...]. Collective."""
        if kind not in self._matrices:
            grid, (flow, right, below), first = self.grid, self._couplings, 0
            parts, groups = self._unknowns(), [[[flow], [right]], [[below], []]]
            if kind == "aij":
                parts = [Unknowns([grid.nodes, grid.corners], grid.global_number, self.held)]
                groups = [[[flow + right, below]]]
            self._matrices[kind] = [[] for _ in parts]
            for (a, row), (b, column) in product(enumerate(parts), repeat=2):
                self._matrices[kind][a].append(InPlaceMatrix(
                    grid, row, column, groups[a][b], self.batches, first,
                    kind == "blocked" and a == b == 0))
                first += self._matrices[kind][a][-1].entries
        return self._matrices[kind]

    def create_matrix(self, kind="aij"):
        """Return an empty parallel matrix with the sparsity of the Jacobian. Collective.

        ``kind`` is aij for a single matrix, or nest for blocks of the nodes and the pressures,
        which PCFIELDSPLIT uses directly. With blocked the first block is BAIJ, which multiplies
        twice as fast, but has no products with other matrices.
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
        corners = self._unknowns()[1]
        self._mass = InPlaceMatrix(
            self.grid, corners, corners, [[(self._pressures, self._pressures)]], self.batches)
        return self._mass.create()

    def fluidity_defect(self, rows, increment):
        """Return the fluidity ``rows`` of a `residual` over the lumped mass, (n_nodes,), gdot0.

        Collective. Prescribed unknowns have 0.
        """
        grid, local, vector = self.grid, np.zeros(self.grid.n_local), self.grid.create_vector()
        local[grid.owned] = rows
        local[self.held] = 0.0
        mass = grid.sum_at_nodes(element.SHAPE.T @ increment.geometry.weight)
        grid.split(local)[1][grid.nodes.owned] /= mass[grid.nodes.owned]
        grid.from_local(local, vector)
        return grid.split(grid.to_local(vector))[1]

    def jacobian(self, local, shift, increment, matrix, defect=None, more=()):
        """Fill ``matrix`` with d(residual)/d(unknowns) + shift d(residual)/d(rates). Collective.

        Prescribed unknowns have rows and columns of the identity. With a ``defect`` (n_nodes,) from
        `fluidity_defect`, dF/dmu is the slope of the `secant`. ``more`` are further pairs for
        `fill`.
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

    def _element_tangents(self, local, shift, increment, number, out, defect):
        """Put the element matrices of a batch into ``out``, (entries, n).

        With n = 2 D~/gdot~ and c = d(viscosity)/d(gdot~) gdot~, the stress changes by
        2 viscosity dD + c n (n:dD) + gdot~ n (viscosity_P dP + viscosity_g dg).
        """
        p, rows = BatchPoints(self, local, increment, number), self._rows
        viscosity, source, geometry = p.response.viscosity, p.response.source, p.geometry
        surfaces = [SurfacePoints(self, p, *surface, defect) for surface in self._surfaces[number]]
        if defect is not None:
            source = p.secant_source(element.SHAPE @ defect[p.nodes])
        weight, inverse, n = geometry.weight, geometry.inverse, p.elements
        source_weight = self._source_weight(weight, number)

        def put(row, column, table, factors):
            np.matmul(table, factors.reshape(table.shape[1], n), out=out[rows[row, column]])

        def mass(field):
            return element.VALUE_VALUE @ (self.storage[field] * shift * weight)

        direction = p.direction_pulled_back()                     # n_ik d xi_r/d x_k
        viscous = weight * viscosity.value
        metric = np.einsum("krqe,ksqe->rsqe", inverse, inverse)
        tangent = weight * viscosity.rate * p.gdot if np.ndim(viscosity.rate) else None
        inertia = mass("velocity") if self.storage["velocity"] else None
        if self.convective:  # (w, (v.grad) dv)
            convection = np.einsum("kqe,ksqe->sqe", p.total_velocity, inverse) * weight
            inertia += element.VALUE_SLOPE @ (
                self.storage["velocity"] * convection).reshape(-1, n)
        for i, row in enumerate(self.grid.velocities):
            for j, column in enumerate(self.grid.velocities):
                factors = viscous * (inverse[j][:, None] * inverse[i][None, :])
                if i == j:
                    factors += viscous * metric
                if tangent is not None:
                    factors += tangent * (direction[i][:, None] * direction[j][None, :])
                put(row, column, element.SLOPE_SLOPE, factors)
                if i == j and inertia is not None:
                    out[rows[row, column]] += inertia
                if self.convective:  # (w, (dv.grad) v)
                    out[rows[row, column]] += element.VALUE_VALUE @ (
                        self.storage["velocity"] * weight * p.gradients[i][j])
            along = weight * p.gdot * direction[i]
            put(row, "P", element.SLOPE_CORNER, viscosity.pressure * along - weight * inverse[i])
            put("P", row, element.CORNER_SLOPE, -weight * inverse[i])
            if self.grid.has_fluidity:
                put(row, "g", element.SLOPE_VALUE, viscosity.fluidity * along)
                put("g", row, element.VALUE_SLOPE, source_weight * source.rate * direction[i])
        if self.grid.has_fluidity:
            put("g", "g", element.SLOPE_SLOPE, self.material.model.diffusion * weight * metric)
            out[rows["g", "g"]] += element.VALUE_VALUE @ (source_weight * source.fluidity)
            if self.storage["fluidity"]:
                out[rows["g", "g"]] += mass("fluidity")
            put("g", "P", element.VALUE_CORNER, source_weight * source.pressure)
            for surface in surfaces:
                for entries, values in self._rule_tangents(p, surface):
                    out[entries, surface.chosen] += values
            for side, chosen, law in self._walls[number]:
                # g = g_loc replaces the fluidity equation at wall nodes.
                wall = WallPoints(self, p, side, chosen, law)
                for entries, values in self._rule_tangents(p, wall):
                    out[entries, chosen] = values

    def _rule_tangents(self, p, found):
        """Yield entries (nodes, columns, 1) for `RulePoints`, and their values."""
        rule, chosen, value = found.rule, found.chosen, found.value
        weight, mu = found.weight, p.stress_ratio_slopes()
        direction = p.direction_pulled_back()[..., chosen]

        def at(values):
            return np.broadcast_to(values, p.gdot.shape)[:, chosen]

        # mu at the points of the rule is interpolated from the Gauss points.
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
                                        rate * direction[i])
        for column, values in factors.items():
            first, columns = self._rows["g", column].start, values.shape[1]
            entries = first + found.nodes[:, None] * columns + np.arange(columns)
            yield entries[:, :, None], values

    def pressure_mass(self, local, increment, matrix):
        """Fill ``matrix`` with -(q, P/viscosity), and the identity where P is held. Collective."""
        local = np.where(self.held, increment.prescribed, local)

        def masses(number, out):
            p = BatchPoints(self, local, increment, number)
            np.matmul(element.CORNER_CORNER,
                      -p.geometry.weight / p.response.viscosity.value, out=out)

        with np.errstate(invalid="ignore", divide="ignore"):
            fill([(self._mass, matrix)], self.batches, masses)

    def lumped_storage(self, shift, increment):
        """Return shift phi rho_s times the lumped mass of owned unknowns at nodes, (n,).

        It is in stress d^2/(d gdot0), node by node; ``shift`` in gdot0.
        """
        mass = self.grid.sum_at_nodes(element.SHAPE.T @ increment.geometry.weight)
        return self.storage["velocity"] * shift * np.repeat(
            mass[self.grid.nodes.owned], self.grid.dof)
