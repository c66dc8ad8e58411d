"""Residual, Jacobian, exactness for homogeneous flow, and order of convergence.

All tests run on any number of ranks.
"""

import numpy as np
import plain
import pytest
from conftest import at_rest, discretised, newton, noise, parameters
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_array

from pgran.cases import Case, PureShear, pressure, traction
from pgran.space.element import element
from pgran.space.grid import Grid
from pgran.space.points import secant
from pgran.space.weakform import WeakForm

COMM = MPI.COMM_WORLD
#: Scale of the flow and of the fluidity: regimes of the stress ratio around mu_s.
REGIMES = {"flowing": (1.0, 1.0), "frozen": (0.2, 1.0), "loading": (0.1, 0.0)}


def distorted(form, amount=0.1):
    """Coordinates of a non-periodic case with all nodes moved smoothly."""
    x = form.case.coordinates(*form.grid.nodes.index)
    return x + amount * np.array([np.sin(x[0] + 2.0 * x[1]), np.cos(2.0 * x[0] - x[1])])


def state(form, regime):
    """Coordinates and unknowns of perturbed homogeneous flow."""
    grid, case = form.grid, form.case
    x = case.coordinates(*grid.nodes.index) if case.periodic[0] else distorted(form)
    rate, fluidity = REGIMES[regime]
    mean = grid.join(rate * case.reference(x)[0], fluidity * case.fluidity, case.pressure)
    return x, mean + grid.join(0.01, 0.1 * fluidity * case.fluidity, 0.1) * noise(grid, 1)


SHAPES = {"biaxial": {"width": 4, "height": 6, "element_size": 1},
          "periodic": {"width": 4, "height": 6, "cell_elements": 4}}
LAWS = {"bingham": {}, "jop": {"mu_2": 6.0}, "barker_gray": {"b": 2.0}}
MODELS = [("ngf", "bingham"), ("ngf", "jop"), ("ngf_primitive", "bingham"),
          ("ngf_primitive", "jop"), ("li", "bingham"), ("li", "jop"), ("li", "barker_gray")]
#: (case, model, law, regime, theta, inertia): the rheology of each model and law in each regime,
#: the rigid-viscous limit of each model, inertia, and the base flow of a cell.
STATES = [("biaxial", model, law, regime, 0.2, False)
          for model, law in MODELS for regime in REGIMES]
STATES += [(case, model, law, regime, theta, law == "bingham")
           for model in ("ngf", "ngf_primitive", "li")
           for case, law, regime, theta in (
               ("biaxial", "jop", "flowing", 0.0), ("biaxial", "jop", "frozen", 0.0),
               ("biaxial", "bingham", "flowing", 0.2), ("periodic", "bingham", "flowing", 0.0))]


def product(form, matrix, local):
    """The owned rows of a matrix times local unknowns."""
    vector, result = form.grid.create_vector(), form.grid.create_vector()
    form.grid.from_local(local, vector)
    matrix.mult(vector, result)
    return result.array.copy()


def assert_jacobian_is_derivative(form, local, step, rate=0.0, shift=7.0, size=1e-6):
    change, matrix = noise(form.grid, 11), form.create_matrix()
    form.jacobian(local, shift, step, matrix)
    ends = [form.residual(local + h * change, rate + h * shift * change, step)
            for h in (size, -size)]
    difference = (ends[0] - ends[1]) / (2.0 * size)
    error, norm = (np.sqrt(COMM.allreduce(d @ d)) for d in
                   (difference - product(form, matrix, change), difference))
    assert error < 1e-6 * norm


@pytest.mark.parametrize("case, model, law, regime, theta, inertia", STATES)
def test_jacobian_is_the_derivative_of_the_residual(case, model, law, regime, theta, inertia):
    form = discretised(case=case, model=model, law=law, inertia=inertia, inertial_number=0.1,
                       body_force="0.2,-0.1", **SHAPES[case], **LAWS[law])
    x, local = state(form, regime)
    if model == "ngf_primitive" and regime == "loading":  # its F has a kink at g = 0
        local = local + form.grid.join(0.0, 0.01, 0.0)
    step = at_rest(form, x, theta, 0.1, form.no_stress() + 0.02)
    step.prescribed = REGIMES[regime][0] * step.prescribed
    step.prescribed_rate = np.where(np.isnan(step.prescribed), np.nan, 0.3)
    ratio = form.collect(local, step, lambda p: p.response.stress_ratio)
    below = COMM.allreduce(ratio.min(), MPI.MIN) < form.material.law.yield_ratio
    above = COMM.allreduce(ratio.max(), MPI.MAX) > form.material.law.yield_ratio
    # The base flow of the cell always flows, LI cannot rest without elasticity, and the law of
    # Barker and Gray has no yield value.
    if case == "biaxial" and (model != "li" or theta) and law != "barker_gray":
        assert above if regime == "flowing" else below
    assert_jacobian_is_derivative(form, local, step)


def test_the_storage_term_is_the_integral_of_the_rate_times_the_relaxation_time():
    form = discretised(model="ngf_primitive", relaxation_time=3, inertial_number=0.1,
                       **SHAPES["biaxial"])
    grid = form.grid
    x, local = state(form, "flowing")
    step, rate = at_rest(form, x, 0.2), grid.join(0.0, 1.0 + x[0], 0.0)
    stored, without = (form.residual(local, factor * rate, step) for factor in (1.0, 0.0))
    integral = (step.geometry.weight * (1.0 + element(2).shape @ x[0][grid.element_nodes]))[
        :, grid.elements.owned].sum()
    assert COMM.allreduce((stored - without).sum()) == pytest.approx(
        3.0 * COMM.allreduce(integral), rel=1e-12)


@pytest.mark.parametrize("kind", ["nest", "blocked"])
@pytest.mark.parametrize("case, more", [
    *((case, {}) for case in SHAPES), ("periodic", {"cell_elements": 2 * max(1, COMM.size - 1)})],
    ids=[*SHAPES, "two elements around"])
def test_all_kinds_of_matrices_are_equal_and_can_be_created_and_filled_again(case, more, kind):
    form = discretised(case=case, **{**SHAPES[case], **more})
    x, local = state(form, "flowing")
    products = []
    for name in "aij", kind, kind:
        matrix = form.create_matrix(name)
        for _ in range(2):
            form.jacobian(local, 3.0, at_rest(form, x, 0.2, 0.1), matrix)
        products.append(product(form, matrix, noise(form.grid, 5)))
        matrix.destroy()
    assert products[1] == pytest.approx(products[0], rel=1e-12, abs=1e-11)
    assert products[2] == pytest.approx(products[1], rel=1e-14, abs=1e-14)


def test_a_secant_reaches_the_root_of_a_parabola_and_tends_to_the_tangent():
    x = np.array([5.0, -3.0])
    value, slope, curvature = (x - 1) * (x - 2), 2 * x - 3, np.full(2, 2.0)
    assert secant(slope, curvature, -value) == pytest.approx(value / (x - [2.0, 1.0]))
    assert secant(slope, curvature, np.full(2, -1e-9)) == pytest.approx(slope, rel=1e-9)
    assert secant(np.array(-0.2), np.array(2.0), np.array(-1.0)) == pytest.approx(-0.1)
    assert secant(slope, curvature, value) == pytest.approx(slope)  # no steeper than the tangent


class Submerged(Case):
    """Material at rest under the same pressure on all deformed sides."""

    shape = 3, 2

    def tractions(self, time):
        return {side: pressure(2.0) for side in ("left", "right", "bottom", "top")}

    def coordinates(self, i, j):
        return np.array([i * 0.5, j * 0.5])


class Pulled(Submerged):
    """The same material with a traction of fixed direction on its top, 3 d long."""

    def tractions(self, time):
        return {"top": traction((0.2, -0.1))}


@pytest.mark.parametrize("options, case, area", [
    ({"body_force": "0.2,-0.1"}, None, 6.0), ({}, Pulled, 3.0)])
def test_loads_have_their_sign_and_size(options, case, area):
    form = discretised(width=3, height=2, element_size=1, **options)
    if case:
        form = WeakForm(form.grid, case(form.case.parameters))
    grid = form.grid
    x = form.case.coordinates(*grid.nodes.index)
    local = grid.join(0.0, 1.0, 0.0)
    # Sums over all nodes; the pressures on the faces of the specimen cancel each other.
    rows = form.forces(local, np.zeros(grid.n_local), at_rest(form, x, 0.0))
    total = [COMM.allreduce(part.sum()) for part in grid.split(rows)[0][:, grid.nodes.owned]]
    np.testing.assert_allclose(total, [-0.2 * area, 0.1 * area], rtol=1e-12)


@pytest.mark.parametrize("case, model, law", [
    *(("biaxial", model, law) for model, law in MODELS),
    *(("periodic", model, "jop") for model in ("ngf", "ngf_primitive", "li"))])
def test_vectorised_residuals_and_jacobians_agree_with_loops(monkeypatch, case, model, law):
    monkeypatch.setattr("pgran.space.weakform.BATCH", {2: 5})  # several batches, the last one short
    form = discretised(case=case, model=model, law=law, inertial_number=0.1, **SHAPES[case],
                       **LAWS[law])
    x, local = state(form, "flowing")
    step = at_rest(form, x, 0.2, 0.1, form.no_stress() + 0.02)
    grid, (forces, tangent) = form.grid, plain.assembled(form, local, step)
    np.testing.assert_allclose(form.residual(local, 0.0 * local, step), forces[grid.owned],
                               rtol=1e-12, atol=1e-12 * np.abs(forces).max())
    matrix = form.create_matrix()
    for _ in range(2):  # a matrix that is filled again keeps no old values
        form.jacobian(local, 0.0, step, matrix)
    starts, columns, values = matrix.getValuesCSR()
    found = csr_array((values, columns, starts), (grid.n_owned, matrix.getSize()[1])).toarray()
    expected = np.zeros_like(found)
    # In a small cell two local columns may be the same.
    np.add.at(expected.T, grid.global_number, tangent[grid.owned].T)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("model, law", MODELS)
def test_homogeneous_flow_is_exact_on_a_distorted_mesh(model, law):
    form = discretised(model=model, law=law, imperfection=1.0, width=4, height=6, element_size=1)
    grid = form.grid
    x = form.case.coordinates(*grid.nodes.index)
    bump = np.sin(np.pi * x[0] / 4.0) * np.sin(np.pi * x[1] / 6.0)
    x = x + 0.2 * bump * np.array([np.cos(3.0 * x[1]), np.sin(2.0 * x[0])])
    exact = grid.join(np.array([x[0], -x[1]]) / 2.0, form.case.fluidity, form.case.pressure)
    step = at_rest(form, x, 0.0)
    found = newton(form, step, exact * (1.0 + 0.001 * noise(grid, 5)))
    assert np.abs(found - exact)[grid.owned].max() < 1e-10 * np.abs(exact).max()
    I0 = form.case.parameters.inertial_number
    assert np.abs(form.inertial_number(found, step) / I0 - 1.0).max() < 1e-10


def test_pressure_follows_the_deformed_normal():
    base = discretised(model="ngf", width=3, height=2, element_size=1)
    form = WeakForm(base.grid, Submerged(base.case.parameters))
    grid = form.grid
    x = distorted(form, 0.15)
    local = grid.join(0.0, 1.0, 2.0)
    forces = form.residual(local, np.zeros(grid.n_local), at_rest(form, x, 0.0))
    nodes = forces[:grid.nodes.owned.size * grid.dof].reshape(-1, grid.dof)[:, :2]
    assert np.abs(nodes).max() < 1e-13


class Manufactured(PureShear):
    """Smooth v, P and g on a square with distorted elements, all boundary values prescribed."""

    shape, fields = (1, 1), None

    def coordinates(self, i, j):
        x, y = i / self.shape[0], j / self.shape[1]
        bump = 0.08 * np.sin(np.pi * x / 2.0) * np.sin(np.pi * y / 2.0)
        return np.array([x + bump * np.cos(2.0 * y), y + bump * np.sin(3.0 * x)])

    def _edge(self, i, j):
        n = 2 * self.shape[0]
        return (i == 0) | (j == 0) | (i == n) | (j == n)

    def prescribed_velocity(self, time, i, j):
        x = self.coordinates(i, j)
        return np.where(self._edge(i, j), [self.fields["v1"](*x), self.fields["v2"](*x)], np.nan)

    def prescribed_fluidity(self, time, i, j):
        return np.where(self._edge(i, j), self.fields["g"](*self.coordinates(i, j)), np.nan)

    def prescribed_pressure(self, time, i, j):
        x = self.coordinates(2 * i, 2 * j)
        return np.where((i == 0) & (j == 0), self.fields["P"](*x), np.nan)

    def body_force(self, x):
        return np.array([self.fields["b1"](*x), self.fields["b2"](*x)])

    def fluidity_source(self, x):
        return self.fields["f"](*x)


def manufactured_fields(material, model, law, theta):
    """The fields, and the forces that balance them by (2.2) and (2.5), from their strong form."""
    import sympy as sp

    x, y = sp.symbols("x y")
    v1, v2 = x + sp.sin(y) * sp.cos(x) / 5, -y + (2 - sp.cos(y)) * sp.sin(x) / 5
    assert sp.simplify(sp.diff(v1, x) + sp.diff(v2, y)) == 0
    P, g = 2 + sp.sin(x + y) / 4, 3 + sp.cos(x - y) / 4
    D11, D22 = sp.diff(v1, x), sp.diff(v2, y)
    D12 = (sp.diff(v1, y) + sp.diff(v2, x)) / 2
    eta = P / (g + theta * P)
    s11, s22, s12 = 2 * eta * D11 - P, 2 * eta * D22 - P, 2 * eta * D12
    mu = sp.sqrt(2 * (D11**2 + D22**2) + 4 * D12**2) / (g + theta * P)
    s, A = sp.sqrt(P) / material.inertial_time, material.model.A
    mu_s, b = material.law.mu_s, material.law.b
    if law == "bingham":
        I_loc, xi = (mu - mu_s) / b, A / sp.sqrt(mu - mu_s)
    else:
        mu_2 = material.law.mu_2
        I_loc = (mu_2 - mu_s) / b * (mu - mu_s) / (mu_2 - mu)
        xi = A * sp.sqrt((mu_2 - mu) / ((mu_2 - mu_s) * (mu - mu_s)))
    source = (A**2 / xi**2 * (g - s * I_loc / mu) if model == "ngf"
              else -A**2 / xi**2 * g + b * mu * g**2 / s)
    laplacian = sp.diff(g, x, 2) + sp.diff(g, y, 2)
    fields = {"v1": v1, "v2": v2, "P": P, "g": g,
              "b1": -sp.diff(s11, x) - sp.diff(s12, y), "b2": -sp.diff(s12, x) - sp.diff(s22, y),
              "f": source - A**2 * laplacian, "mu": mu}
    return {name: sp.lambdify((x, y), expression, "numpy") for name, expression in fields.items()}


def errors(form, local, step, fields):
    """L2 errors of v1, v2, g and P."""
    def squares(p):
        found = {"v1": p.velocity[0], "v2": p.velocity[1], "g": p.element.shape @ p.nodal_g,
                 "P": p.P}
        return np.array([(values - fields[name](*p.x))**2 for name, values in found.items()])

    values = step.geometry.weight * form.collect(local, step, squares)
    return np.sqrt(COMM.allreduce(values[..., form.grid.elements.owned].sum(axis=(1, 2))))


@pytest.mark.parametrize("model", ["ngf", "ngf_primitive"])
@pytest.mark.parametrize("law, theta", [("bingham", 0.3), ("jop", 0.0)])
def test_the_order_of_convergence_is_3_in_v_and_g_and_2_in_p(law, theta, model):
    found = []
    case = Manufactured(parameters(model=model, law=law, mu_s=0.3, inertial_number=0.3,
                                   **({"mu_2": 2.5} if law == "jop" else {})))
    case.fields = fields = manufactured_fields(case.material, model, law, theta)
    for elements in (4, 8, 16):
        case.shape = elements, elements
        grid = Grid(PETSc.COMM_WORLD, case.shape)
        form = WeakForm(grid, case)
        x = case.coordinates(*grid.nodes.index)
        corners = case.coordinates(*(2 * grid.corners.index))
        exact = grid.join([fields["v1"](*x), fields["v2"](*x)], fields["g"](*x),
                          fields["P"](*corners))
        step = at_rest(form, x, theta)
        # Below yield F has a kink, and at mu = 1 the equations lose their type (3.19).
        assert (fields["mu"](*x) > case.law.mu_s).all() and (fields["mu"](*x) < 1.0).all()
        found.append(errors(form, newton(form, step, exact, 1e-10), step, fields))
    orders = np.log2(np.array(found[:-1]) / np.array(found[1:]))
    assert (orders[-1] > [2.8, 2.8, 2.8, 1.8]).all(), orders
    assert (orders[-1] < [3.5, 3.5, 3.5, 2.9]).all(), orders
