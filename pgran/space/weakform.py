"""Residual and Jacobian of the weak form over all elements of a rank at once.

For all test functions (w, h, q), with sigma = -P 1 + sigma'::

    phi rho_s (w, Dv/Dt) + (grad w, sigma) = <w, t> + (w, b)                 (2.2)
    tau (h, dg/dt) + A^2 d^2 (grad h, grad g) + (h, F) = 0                    (2.5), over xi^2
    -(q, div v) = 0                                                          (2.9)

Dv/Dt is dv/dt at nodes that move with the material, and dv/dt + (v.grad) v on a fixed mesh. grad w
is the strain operator of the kinematics (`pgran.kinematics`). sigma', F, tau and A^2 d^2 come from
the model (`pgran.material.models`), the tractions t and the body force b from the case. The
elements are evaluated in batches that fit into the cache. Arrays of a batch are (Gauss points, n
elements).
"""

import os
from dataclasses import dataclass
from itertools import product

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from .. import cases
from ..options import ParameterError
from .element import Geometry, sum_arrays, table
from .grid import Grid
from .matrix import Field, InPlaceMatrix, ScatterAdd, Unknowns, fill
from .points import BatchPoints, SurfacePoints, WallPoints, contracted

#: Elements of a batch, by dimensions.
BATCH = {2: 512, 3: 24}
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
    grid = Grid(comm, case.shape, case.periodic, case.material.model.has_fluidity,
                case.kinematics)
    return WeakForm(grid, case)


def _check_size(parameters, case, comm):
    """Refuse a grid that PETSc cannot number or this machine cannot hold."""
    unknowns, problem = case.unknowns, ""
    needed = LEAST_BYTES * unknowns / comm.size
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if unknowns > np.iinfo(PETSc.IntType).max:
        problem = ("more than the indices of this PETSc can count; larger elements, or a PETSc "
                   "configured --with-64-bit-indices")
    elif needed > memory:
        problem = (f"which need at least {needed / 2**30:.3g} GB per rank, and this machine has "
                   f"{memory / 2**30:.3g} GB; larger elements, or more machines")
    if problem:
        raise ParameterError("case", parameters.case, f"its {' x '.join(map(str, case.shape))} "
                             f"elements make {unknowns:.3g} unknowns, {problem}")


def _batches(grid):
    """The elements of a rank in slices of several complete rows, or of equal parts of a row."""
    n, size = grid.n_elements, BATCH[grid.dim]
    row = np.count_nonzero((grid.elements.index[1:] == grid.elements.index[1:, :1]).all(axis=0))
    if row <= size:
        ends = np.arange(0, n, row * (size // row))
    else:
        cuts = np.linspace(0, row, -(-row // size), endpoint=False).astype(int)
        ends = (np.arange(0, n, row)[:, None] + cuts).ravel()
    return [slice(first, last) for first, last in zip(ends, [*ends[1:], n])]


@dataclass
class Increment:
    """What is fixed while Newton's method solves one time step."""

    x: np.ndarray  #: Coordinates of the mesh, (dim, n_nodes), d.
    #: Old deviator S, already rotated with the material, (m, points, n), stress.
    stress: np.ndarray
    theta: float  #: Compliance f/(G dt) of the elastic element; 0 if rigid-viscous.
    prescribed: np.ndarray  #: Prescribed values, NaN where an unknown is free, (n_local,).
    prescribed_rate: np.ndarray  #: Their rates of change, (n_local,).
    geometry: Geometry
    load: np.ndarray  #: Nodal forces of the tractions, (c, n_nodes), stress times d.
    #: eps in F + eps g, which limits the cooperativity length to A d/sqrt(eps).
    decay: float = 0.0


class WeakForm:
    """The discrete equations of a case on a grid. Its creation is collective.

    All arrays of unknowns are local, (grid.n_local,), as `Grid.to_local` returns them.
    """

    def __init__(self, grid, case):
        self.grid, self.case, self.material = grid, case, case.material
        self.element, self.kinematics = grid.element, grid.kinematics
        density = self.material.bulk_density if case.parameters.inertia else 0.0
        self.storage = {"velocity": density, "fluidity": 0.0, **self.material.model.storage}
        self.convective = bool(density) and not case.moving
        self.batches = _batches(grid)
        self._yield_factor = case.yield_factor(*grid.elements.index)
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
            for layer, rule in enumerate(self.element.surface_rules[side])])

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
        return Increment(x, stress, theta, values, rates, self.grid.geometry(x),
                         self._loads(x, time))

    def _loads(self, x, time):
        """The nodal forces (c, n_nodes) of the tractions at a time, stress times d."""
        grid, load = self.grid, np.zeros((self.kinematics.velocities, self.grid.nodes.size))
        for side, traction in self.case.tractions(time).items():
            elements, rule = grid.side_elements(side), self.element.side_rules[side]
            points = rule.shape @ x[:, grid.element_nodes[:, elements]]
            force = traction(points, grid.geometry(x, elements, rule).area(side))
            nodes, tests = grid.side_nodes(side), rule.shape[:, self.element.side_nodes[side]]
            for loads, part in zip(load, force):
                loads += np.bincount(nodes.ravel(), (tests.T @ part).ravel(),
                                     minlength=grid.nodes.size)
        return load

    def no_stress(self):
        """Return a deviator of zeros, (m, points, n)."""
        return np.zeros((len(self.kinematics), self.element.points, self.grid.n_elements))

    def prescribed(self, time):
        """Return the prescribed unknowns (n_local,) at a time, NaN where free."""
        nodes, corners, case = self.grid.nodes, self.grid.corners, self.case
        return self.grid.join(case.prescribed_velocity(time, *nodes.index),
                              case.prescribed_fluidity(time, *nodes.index),
                              case.prescribed_pressure(time, *corners.index))

    # Values at the Gauss points

    def collect(self, local, increment, quantity):
        """Return ``quantity(points)`` of the `BatchPoints` of all elements, (..., points, n)."""
        local = np.where(np.isnan(increment.prescribed), local, increment.prescribed)
        with np.errstate(invalid="ignore", divide="ignore"):
            parts = [quantity(BatchPoints(self, local, increment, number))
                     for number in range(len(self.batches))]
        return np.concatenate(parts, axis=-1)

    def stress(self, local, increment):
        """Return the new stress deviator (m, points, n), stress."""
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
        p, blocks, e = BatchPoints(self, local, increment, number), self.grid.blocks, self.element
        unknowns, weight = self.grid.element_unknowns[:, self.batches[number]], p.geometry.weight
        stress, case, density = p.stress(), self.case, self.storage["velocity"]
        bodies = case.body_force(p.x) * weight if case.body_force else None
        if self.convective:
            inertia = density * weight * self._convection(p)

        def store(rows, coefficient):
            rates = e.shape @ rate[unknowns[rows]]
            out[rows] += e.shape.T @ (coefficient * weight * rates)

        for c, flux in enumerate(contracted(p.operators(), weight * stress)):
            rows = blocks[self.grid.velocities[c]]
            np.matmul(self._slots.T, flux.reshape(self._slots.shape[0], -1), out=out[rows])
            if bodies is not None:
                out[rows] -= e.shape.T @ bodies[c]
            if density:
                store(rows, density)
            if self.convective:
                out[rows] += e.shape.T @ inertia[c]
        if self.grid.has_fluidity:
            flux = self.material.model.diffusion * p.geometry.gradient(p.nodal_g)
            source = self._source_weight(weight, number) * p.response.source.value
            if case.fluidity_source is not None:
                source -= weight * case.fluidity_source(p.x)
            slopes = e.slope.reshape(-1, e.nodes).T
            out[blocks["g"]] = (slopes @ p.geometry.pull_back(flux).reshape(slopes.shape[1], -1)
                                + e.shape.T @ source)
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
        out[blocks["P"]] = -e.corner_shape.T @ (weight * p.divergence)

    def _convection(self, p):
        """The acceleration (v.grad) v, (c, points, n), of the `BatchPoints`."""
        v = p.total_velocity
        found = np.array([sum(a * b for a, b in zip(v, slopes)) for slopes in p.gradients])
        for c, a, b, sign in self.kinematics.turning:
            found[c] += sign * v[a] * v[b] * p.geometry.over_r
        return found

    # Jacobian

    def _lay_out_entries(self):
        """Number the entries of the element matrices, block by block, and find the force sums."""
        grid, count, e = self.grid, 0, self.element
        self._rows, self._matrices = {}, {}
        #: The functions of the strain operator at the Gauss points, (slots times points, nodes).
        self._slots = np.concatenate([*e.slope, e.shape])[:self.kinematics.slots * e.points]
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
                batch.stop - batch.start) * e.nodes * grid.dof
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
        mass = grid.sum_at_nodes(self.element.shape.T @ increment.geometry.weight)
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
        p, rows, e = BatchPoints(self, local, increment, number), self._rows, self.element
        viscosity, source = p.response.viscosity, p.response.source
        surfaces = [SurfacePoints(self, p, *surface, defect) for surface in self._surfaces[number]]
        if defect is not None:
            source = p.secant_source(e.shape @ defect[p.nodes])
        weight, n, velocities = p.geometry.weight, p.elements, self.grid.velocities
        source_weight = self._source_weight(weight, number)
        slot = "slot" if self.kinematics.axisymmetric else "slope"

        def put(row, column, left, right, factors):
            products = table(e.dim, left, right)
            np.matmul(products, factors.reshape(products.shape[1], n), out=out[rows[row, column]])

        S, diagonal = p.operators(), self.kinematics.normal
        t = contracted(S, p.direction())
        viscous = 2.0 * weight * viscosity.value
        tangent = weight * viscosity.rate * p.gdot if np.ndim(viscosity.rate) else None
        for a, row in enumerate(velocities):
            for b, column in list(enumerate(velocities))[a:]:
                terms = [(S[a][m][0] * S[b][m][0] * viscous * S[a][m][1])[:, None] * S[b][m][1]
                         for m in S[a].keys() & S[b].keys()]
                if tangent is not None:
                    terms.append((tangent * t[a])[:, None] * t[b])
                put(row, column, slot, slot, sum_arrays(terms) if terms else np.zeros(
                    (self.kinematics.slots**2 * e.points, n)))
                if b > a:  # the transposed block
                    block, other = (out[rows[names]].reshape(e.nodes, e.nodes, n)
                                    for names in ((row, column), (column, row)))
                    other[:] = block.swapaxes(0, 1)
            along = weight * p.gdot * t[a]
            divergence = weight * sum(
                (part * factor for m, (factor, part) in S[a].items() if m in diagonal),
                np.zeros_like(t[a]))
            put(row, "P", slot, "corner", viscosity.pressure * along - divergence)
            put("P", row, "corner", slot, -divergence)
            if self.grid.has_fluidity:
                put(row, "g", slot, "value", viscosity.fluidity * along)
                put("g", row, "value", slot, source_weight * source.rate * t[a])
        if self.storage["velocity"]:
            mass = table(e.dim, "value", "value") @ (self.storage["velocity"] * shift * weight)
            for row in velocities:
                out[rows[row, row]] += mass
        if self.convective:
            for (row, column), kind, factors in self._convection_tangents(p):
                products = table(e.dim, "value", kind)
                out[rows[row, column]] += products @ factors.reshape(products.shape[1], n)
        if self.grid.has_fluidity:
            metric = np.einsum("krqe,ksqe->rsqe", *[p.geometry.inverse] * 2)
            put("g", "g", "slope", "slope", self.material.model.diffusion * weight * metric)
            out[rows["g", "g"]] += table(e.dim, "value", "value") @ (
                source_weight * source.fluidity + self.storage["fluidity"] * shift * weight)
            put("g", "P", "value", "corner", source_weight * source.pressure)
            for surface in surfaces:
                for entries, values in self._rule_tangents(p, surface, t):
                    out[entries, surface.chosen] += values
            for side, chosen, law in self._walls[number]:
                # g = g_loc replaces the fluidity equation at wall nodes.
                wall = WallPoints(self, p, side, chosen, law)
                for entries, values in self._rule_tangents(p, wall, t):
                    out[entries, chosen] = values

    def _convection_tangents(self, p):
        """Yield the block, the kind of function and the factors of the tangent of convection."""
        velocities, density = self.grid.velocities, self.storage["velocity"] * p.geometry.weight
        v, over_r = p.total_velocity, p.geometry.over_r
        along = density * sum(part[None] * inverse for part, inverse in zip(v, p.geometry.inverse))
        for c, row in enumerate(velocities):
            yield (row, row), "slope", along
            for k, slope in enumerate(p.gradients[c]):
                yield (row, velocities[k]), "value", density * slope
        for c, a, b, sign in self.kinematics.turning:
            for changed, other in (a, b), (b, a):
                yield ((velocities[c], velocities[changed]), "value",
                       sign * density * v[other] * over_r)

    def _rule_tangents(self, p, found, directions):
        """Yield entries (nodes, columns, 1) for `RulePoints`, and their values."""
        rule, chosen, value = found.rule, found.chosen, found.value
        weight, mu = found.weight, p.stress_ratio_slopes()

        def at(values):
            return np.broadcast_to(values, p.gdot.shape)[:, chosen]

        # mu at the points of the rule is interpolated from the Gauss points.
        by_mu = np.einsum("qa,qe,qp->ape", found.tests, weight * value.rate, rule.from_gauss)
        changes, rate = {"P": at(mu.pressure), "g": at(mu.fluidity)}, at(mu.rate)
        factors = {}
        for name, volume, shape, change in (
                ("P", self.element.corner_shape, rule.corner_shape, value.pressure),
                ("g", self.element.shape, rule.shape, value.fluidity)):
            factors[name] = (
                np.einsum("ape,pe,pb->abe", by_mu, changes[name], volume)
                + np.einsum("qa,qb,qe->abe", found.tests, shape, weight * change))
        slots = self._slots.reshape(self.kinematics.slots, self.element.points, -1)
        for column, direction in zip(self.grid.velocities, directions):
            factors[column] = np.einsum("ape,rpb,rpe->abe", by_mu, slots,
                                        rate * direction[..., chosen])
        for column, values in factors.items():
            first, columns = self._rows["g", column].start, values.shape[1]
            entries = first + found.nodes[:, None] * columns + np.arange(columns)
            yield entries[:, :, None], values

    def pressure_mass(self, local, increment, matrix):
        """Fill ``matrix`` with -(q, P/viscosity), and the identity where P is held. Collective."""
        local = np.where(self.held, increment.prescribed, local)

        def masses(number, out):
            p = BatchPoints(self, local, increment, number)
            np.matmul(table(self.grid.dim, "corner", "corner"),
                      -p.geometry.weight / p.response.viscosity.value, out=out)

        with np.errstate(invalid="ignore", divide="ignore"):
            fill([(self._mass, matrix)], self.batches, masses)

    def lumped_storage(self, shift, increment):
        """Return shift phi rho_s times the lumped mass of owned unknowns at nodes, (n,).

        It is in stress d^2/(d gdot0), node by node; ``shift`` in gdot0.
        """
        mass = self.grid.sum_at_nodes(self.element.shape.T @ increment.geometry.weight)
        return self.storage["velocity"] * shift * np.repeat(
            mass[self.grid.nodes.owned], self.grid.dof)
