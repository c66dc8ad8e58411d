"""Residual and Jacobian of the weak form over all elements of a rank at once.

For all test functions (w, h, q), with sigma = -P 1 + sigma':

    phi rho_s (w, dv/dt) + (grad w, sigma) = <w, sigma_n n> + (w, b)       (2.2)
    A^2 d^2 (grad h, grad g) + (h, F) = 0                                   (2.5), over xi^2
    -(q, div v) = 0                                                         (2.9)

sigma' and F come from `rheology`. The elements are worked on in batches that
stay in the cache; within one, arrays are (9 Gauss points, n elements).
"""

import numpy as np

from . import cases, element, rheology
from .grid import Grid
from .matrix import BatchSum, ElementMatrix
from .options import OptionError

BATCH = 512


def discretise(settings, comm):
    """Return the `WeakForm` of resolved options on the ranks of ``comm``. Collective.

    Raises `OptionError` where the options do not fit together.
    """
    if settings.model == "ig":
        raise OptionError("-pgran_model ig: known to the linear theory alone; allowed here is "
                          "ngf | li")
    material = rheology.material_of(settings)
    case = cases.create(settings, material)
    grid = Grid(comm, case.shape, case.periodic, fluidity=settings.model == "ngf")
    return WeakForm(grid, material, case, settings.inertia)


class Step:
    """The setting of one evaluation: what is fixed while Newton's method runs.

    ``x`` (2, n_nodes): mesh coordinates, d. ``stress`` (3, 9, n): old deviator
    S11, S22, S12, already turned with the material, |sigma_1|. ``theta``:
    1/(G dt), 0 for the rigid-viscous equations. ``prescribed`` (n_local,): the
    prescribed values, not a number where an unknown is free, and
    ``prescribed_rate`` their rates of change.
    """

    def __init__(self, form, x, stress, theta, prescribed, prescribed_rate):
        grid = form.grid
        self.x, self.stress, self.theta = x, stress, theta
        self.prescribed, self.prescribed_rate = prescribed, prescribed_rate
        self.geometry = element.Geometry(x[:, grid.element_nodes])
        self.load = np.zeros((2, grid.nodes.size))
        for side, normal_stress in form.case.side_stresses.items():
            nodes = grid.side_nodes(side)
            force = element.side_force(x[:, nodes], normal_stress)
            for i in range(2):
                self.load[i] += np.bincount(nodes.ravel(), force[i].ravel(),
                                            minlength=grid.nodes.size)


class WeakForm:
    """The discrete equations of a case on a grid.

    Parameters: ``grid`` `Grid`; ``material`` `rheology.Material`; ``case`` with
    ``base_gradient`` (2, 2), ``side_stresses``, ``yield_factor(i, j)``,
    ``body_force(x)`` and ``fluidity_source(x)``; ``inertia``: whether velocity
    carries mass.

    All arrays of unknowns are local ones, (grid.n_local,), as `Grid.to_local`
    gives them. Nothing here communicates.
    """

    def __init__(self, grid, material, case, inertia):
        self.grid, self.material, self.case = grid, material, case
        self.density = material.bulk_density if inertia else 0.0
        self.nonlocal_ = material.model == "ngf"
        factor = case.yield_factor(grid.element_i, grid.element_j)
        self._yield = material.law.mu_s * factor
        n = grid.n_elements
        self.batches = [slice(k, min(k + BATCH, n)) for k in range(0, n, BATCH)]
        self.held = ~np.isnan(self.prescribed(0.0))
        self._lay_out_matrices()

    def prescribed(self, time):
        """Return the prescribed unknowns (n_local,) at a time, not a number where free."""
        nodes, corners, case = self.grid.nodes, self.grid.corners, self.case
        return self.grid.join(case.prescribed(time, nodes.i, nodes.j),
                              case.prescribed_fluidity(time, nodes.i, nodes.j),
                              case.prescribed_pressure(time, corners.i, corners.j))

    # Points

    def _law(self, batch):
        """The law with the yield value of each element."""
        law = self.material.law
        return type(law)(**{**vars(law), "mu_s": self._yield[batch]})

    def points(self, local, step, batch):
        """Return kinematics and response at the Gauss points of a batch, a `_Points`."""
        nodal = local[self.grid.element_unknowns[:, batch]]
        return _Points(self, nodal, step, batch)

    def _collect(self, local, step, quantity):
        """Return ``quantity(points)`` of all elements, (..., 9, n)."""
        local = np.where(np.isnan(step.prescribed), local, step.prescribed)
        with np.errstate(invalid="ignore", divide="ignore"):
            parts = [quantity(self.points(local, step, batch)) for batch in self.batches]
        return np.concatenate(parts, axis=-1)

    def stress(self, local, step):
        """Return the new stress deviator (3, 9, n), |sigma_1|."""
        return self._collect(local, step, lambda p: p.deviator())

    def inertial_number(self, local, step):
        """Return I of the plastic rate at the Gauss points, (9, n)."""
        return self._collect(local, step, lambda p: p.response.inertial_number)

    def stress_ratio(self, local, step):
        """Return mu = tau/P at the Gauss points, (9, n)."""
        return self._collect(local, step, lambda p: p.response.stress_ratio)

    def spin(self, velocity, x):
        """Return (d v2/d x1 - d v1/d x2)/2 at the Gauss points, (9, n), of a nodal velocity."""
        nodes = self.grid.element_nodes
        geometry = element.Geometry(x[:, nodes])
        return (geometry.gradient(velocity[1][nodes])[0]
                - geometry.gradient(velocity[0][nodes])[1]) / 2.0

    def at_nodes(self, values):
        """Return nodal values (n_nodes,) of a field at the Gauss points, (9, n).

        The biquadratic through the points of each element, averaged over the
        elements of a node; complete at owned nodes.
        """
        total = self.grid.sum_at_nodes(element.GAUSS_TO_NODES @ values)
        return total / np.maximum(self.grid.sum_at_nodes(np.ones_like(values)), 1.0)

    def corner_field(self, corners):
        """Return nodal values (n_nodes,) of a Q1 field given at the corners, (n_corners,).

        Complete at owned nodes, 1 at ghosts that no local element has.
        """
        nodal = np.ones(self.grid.nodes.size)
        nodal[self.grid.element_nodes] = (
            element.CORNER_AT_NODES @ corners[self.grid.element_corners])
        return nodal

    def nodal_fields(self, local, step):
        """Return ``fluidity``, ``pressure``, ``inertial_number`` and ``stress_ratio`` at the nodes.

        Arrays (n_nodes,), complete at owned nodes. mu comes from the Gauss points by
        `at_nodes`; for NGF g is nodal and I = g mu/s, for LI both come from the points too.
        """
        _, fluidity, corners = self.grid.split(local)
        pressure = self.corner_field(corners)
        mu = self.at_nodes(self.stress_ratio(local, step))
        if self.nonlocal_:
            I = fluidity * mu / self.material.inverse_time(pressure)
        else:
            fluidity, I = (self.at_nodes(self._collect(local, step, quantity)) for quantity in (
                lambda p: p.response.fluidity, lambda p: p.response.inertial_number))
        return {"fluidity": fluidity, "pressure": pressure, "inertial_number": I,
                "stress_ratio": mu}

    # Residual

    def residual(self, local, rate, step):
        """Return the residual of the owned rows, (n_owned,).

        ``local`` are the unknowns and ``rate`` their time derivatives, (n_local,).
        Rows of prescribed unknowns hold value minus prescribed value.
        """
        grid = self.grid
        total = self._forces(local, rate, step)
        total[self.held] = (local - step.prescribed)[self.held]
        return total[grid.owned]

    def reaction(self, local, rate, step, side):
        """Return the force (2,) of a side on the owned nodes of the material, |sigma_1| d."""
        grid = self.grid
        nodes = np.intersect1d(grid.side_nodes(side), grid.nodes.owned)
        velocity, _, _ = grid.split(self._forces(local, rate, step))
        return velocity[:, nodes].sum(axis=1)

    def _forces(self, local, rate, step):
        """The residual before the rows of prescribed unknowns are replaced, (n_local,)."""
        grid = self.grid
        local = np.where(self.held, step.prescribed, local)
        if self.density:
            rate = np.where(self.held, step.prescribed_rate, rate)
        total = np.zeros(grid.n_local)
        with np.errstate(invalid="ignore", divide="ignore"):
            for batch, sums in zip(self.batches, self._force_sums):
                forces = np.empty((len(grid.element_unknowns), batch.stop - batch.start))
                self._element_forces(local, rate, step, batch, forces)
                for batch_sum in sums:
                    batch_sum.add(forces.ravel(), total)
        velocity, _, _ = grid.split(total)
        velocity -= step.load
        return total

    def _element_forces(self, local, rate, step, batch, out):
        p = self.points(local, step, batch)
        s11, s22, s12 = p.deviator()
        weight = p.geometry.weight
        slopes = element.SHAPE_SLOPE.reshape(18, 9).T
        case = self.case
        bodies = None if case.body_force is None else case.body_force(p.x) * weight
        for i, flux in enumerate(((s11 - p.P, s12), (s12, s22 - p.P))):
            rows = slice(9 * i, 9 * i + 9)
            np.matmul(slopes, p.geometry.pull_back(flux).reshape(18, -1), out=out[rows])
            if bodies is not None:
                out[rows] -= element.SHAPE.T @ bodies[i]
            if self.density:
                inertia = element.SHAPE @ rate[self.grid.element_unknowns[rows, batch]]
                out[rows] += element.SHAPE.T @ (self.density * weight * inertia)
        if self.nonlocal_:
            flux = self.material.A**2 * p.geometry.gradient(p.nodal_g)
            source = p.response.source
            if case.fluidity_source is not None:
                source = source - case.fluidity_source(p.x)
            out[18:27] = (slopes @ p.geometry.pull_back(flux).reshape(18, -1)
                          + element.SHAPE.T @ (weight * source))
        out[-4:] = -element.CORNER_SHAPE.T @ (weight * p.divergence)

    # Jacobian

    def _lay_out_matrices(self):
        """Lay out the blocks of the element matrices in one array of entries, and the matrices."""
        grid = self.grid
        nodes, corners = grid.element_nodes, grid.element_corners
        flow, pressure = (grid.nodes, grid.dof), (grid.corners, 1)
        self._rows, groups, count = {}, ([], []), 0

        def add(key, group, *entries):
            nonlocal count
            rows = len(entries[2]) * len(entries[5])
            self._rows[key] = slice(count, count + rows)
            count += rows
            groups[group].append(entries)

        for a, row in enumerate(grid.fields):
            for b, column in enumerate(grid.fields):
                add((row, column), 0, 0, a, nodes, 0, b, nodes)
            add((row, "P"), 0, 0, a, nodes, 1, 0, corners)
        for b, column in enumerate(grid.fields[:2]):
            add(("P", column), 1, 1, 0, corners, 0, b, nodes)
        self._force_sums = []
        for batch in self.batches:
            rows, size = grid.element_unknowns[:, batch], batch.stop - batch.start
            parts = slice(0, size * 9 * grid.dof), slice(size * 9 * grid.dof, None)
            self._force_sums.append([BatchSum(part, rows.ravel()[part], grid.n_local)
                                     for part in parts])
        self._jacobian = ElementMatrix(grid, [flow, pressure], grid.global_number, groups,
                                       self.batches, self.held)
        self._mass = ElementMatrix(grid, [pressure], grid.corners.dm.getLGMap().indices,
                                   [[(0, 0, corners, 0, 0, corners)]], self.batches,
                                   self.held[grid.n_flow:])

    def create_matrix(self):
        """Return an empty parallel matrix (AIJ) with the places of the Jacobian. Collective."""
        return self._jacobian.create()

    def create_pressure_mass(self):
        """Return an empty matrix for `pressure_mass`. Collective."""
        return self._mass.create()

    def jacobian(self, local, shift, step, matrix):
        """Fill ``matrix`` with d(residual)/d(unknowns) + shift d(residual)/d(rates). Collective.

        Rows and columns of prescribed unknowns are those of the identity.
        """
        local = np.where(self.held, step.prescribed, local)
        with np.errstate(invalid="ignore", divide="ignore"):
            self._jacobian.fill(matrix, lambda batch, out: self._element_tangents(
                local, shift, step, batch, out))

    def _element_tangents(self, local, shift, step, batch, out):
        """The element matrices of a batch, block by block, (rows of `_number_entries`, n).

        With n = 2 D~/gdot~ and c = d(viscosity)/d(gdot~) gdot~, the stress changes by
        2 viscosity dD + c n (n:dD) + gdot~ n (viscosity_P dP + viscosity_g dg).
        """
        p = self.points(local, step, batch)
        response, geometry, rows = p.response, p.geometry, self._rows
        weight, inverse = geometry.weight, geometry.inverse
        n = p.elements

        def put(key, table, factors):
            np.matmul(table, factors.reshape(table.shape[1], n), out=out[rows[key]])

        turned = p.direction_pulled_back()                     # n_ik d xi_r/d x_k
        viscous = weight * response.viscosity
        metric = np.einsum("krqe,ksqe->rsqe", inverse, inverse)
        tangent = weight * response.viscosity_rate * p.gdot if np.ndim(
            response.viscosity_rate) else None
        mass = element.VALUE_VALUE @ (self.density * shift * weight) if self.density else None
        for i in range(2):
            for j in range(2):
                factors = viscous * (inverse[j][:, None] * inverse[i][None, :])
                if i == j:
                    factors += viscous * metric
                if tangent is not None:
                    factors += tangent * (turned[i][:, None] * turned[j][None, :])
                key = f"v{i + 1}", f"v{j + 1}"
                put(key, element.SLOPE_SLOPE, factors)
                if i == j and mass is not None:
                    out[rows[key]] += mass
            along = weight * p.gdot * turned[i]
            key = f"v{i + 1}"
            put((key, "P"), element.SLOPE_CORNER,
                response.viscosity_pressure * along - weight * inverse[i])
            put(("P", key), element.CORNER_SLOPE, -weight * inverse[i])
            if self.nonlocal_:
                put((key, "g"), element.SLOPE_VALUE, response.viscosity_fluidity * along)
                put(("g", key), element.VALUE_SLOPE, weight * response.source_rate * turned[i])
        if self.nonlocal_:
            put(("g", "g"), element.SLOPE_SLOPE, self.material.A**2 * weight * metric)
            out[rows["g", "g"]] += element.VALUE_VALUE @ (weight * response.source_fluidity)
            put(("g", "P"), element.VALUE_CORNER, weight * response.source_pressure)

    def pressure_mass(self, local, step, matrix):
        """Fill ``matrix`` with -(q, P/viscosity), close to the pressure Schur complement.

        Collective. Rows of prescribed pressures are those of the identity, as in the Jacobian.
        """
        local = np.where(self.held, step.prescribed, local)

        def masses(batch, out):
            p = self.points(local, step, batch)
            np.matmul(element.CORNER_CORNER, -p.geometry.weight / p.response.viscosity, out=out)

        with np.errstate(invalid="ignore", divide="ignore"):
            self._mass.fill(matrix, masses)


class _Points:
    """Kinematics and response at the Gauss points of a batch of elements."""

    def __init__(self, form, nodal, step, batch):
        self.elements = nodal.shape[1]
        self.geometry = step.geometry[batch]
        base, theta = form.case.base_gradient, step.theta
        gradients = [self.geometry.gradient(nodal[9 * i:9 * i + 9]) for i in range(2)]
        l11, l12 = gradients[0] + np.reshape(base[0], (2, 1, 1))
        l21, l22 = gradients[1] + np.reshape(base[1], (2, 1, 1))
        s11, s22, s12 = step.stress[:, :, batch] * (theta / 2.0)
        self.divergence = l11 + l22
        self.d11, self.d22, self.d12 = l11 + s11, l22 + s22, (l12 + l21) / 2.0 + s12
        self.gdot = np.sqrt(2.0 * (self.d11**2 + self.d22**2) + 4.0 * self.d12**2)
        self.P = element.CORNER_SHAPE @ nodal[-4:]
        self._nodes, self._x = form.grid.element_nodes[:, batch], step.x
        law, s = form._law(batch), form.material.inverse_time(self.P)
        if form.nonlocal_:
            self.nodal_g = nodal[18:27]
            self.response = rheology.ngf(law, s, self.gdot, self.P,
                                         element.SHAPE @ self.nodal_g, theta)
        else:
            self.response = rheology.li(law, s, self.gdot, self.P, theta)

    @property
    def x(self):
        """Coordinates of the Gauss points, (2, 9, n)."""
        return element.SHAPE @ self._x[:, self._nodes]

    def deviator(self):
        """Return sigma' = 2 viscosity D~, (3, 9, n): 11, 22, 12."""
        return 2.0 * self.response.viscosity * np.array([self.d11, self.d22, self.d12])

    def direction_pulled_back(self):
        """Return sum_k n_ik d xi_r/d x_k with n = 2 D~/gdot~ (0 at rest), (2, 2, 9, n)."""
        scale = 2.0 / np.where(self.gdot > 0.0, self.gdot, np.inf)
        n11, n22, n12 = scale * self.d11, scale * self.d22, scale * self.d12
        inverse = self.geometry.inverse
        return np.array([n11 * inverse[0] + n12 * inverse[1],
                         n12 * inverse[0] + n22 * inverse[1]])
