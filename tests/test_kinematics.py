"""Every kinematics: derivatives, plain loops, manufactured solutions, rotation and known flows.

The references use full tensors of three directions instead of Mandel components.
"""

import numpy as np
import plain
import pytest
from conftest import at_rest, discretised, newton, parameters
from petsc4py import PETSc

from pgran import cases
from pgran.cases import _fixed
from pgran.kinematics import AXISYMMETRIC, OUT_OF_PLANE, PLANE, SOLID, SWIRL
from pgran.solve.state import State, TimeStep
from pgran.space.grid import Grid
from pgran.space.weakform import WeakForm

KINDS = {kind.name: kind for kind in (PLANE, OUT_OF_PLANE, AXISYMMETRIC, SWIRL, SOLID)}
#: A law that bears any stress ratio of random fields.
STRONG = {"law": "jop", "mu_2": 60, "inertial_number": 0.3}


class Block(cases.Case):
    """A block of distorted elements from x1 = 1 on a fixed mesh."""

    moving, kinematics, elements = False, PLANE, None

    @property
    def base_gradient(self):
        return np.diag([0.1, -0.2, 0.0])[:self.kinematics.velocities, :self.kinematics.dim]

    @property
    def shape(self):
        return self.elements or (3, 2, 2)[:self.kinematics.dim]

    def coordinates(self, *index):
        x = np.array([part / (2.0 * n) for part, n in zip(index, self.shape)])
        bump = 0.06 * np.prod(np.sin(np.pi * x), axis=0)
        x = x + bump * np.array([np.cos(2.0 * x[1]), np.sin(3.0 * x[0]), np.cos(x[0])][:len(x)])
        return x + np.eye(len(x))[0][:, None]

    def edge(self, index, axes=(0, 1, 2)):
        return np.any([(part == 0) | (part == 2 * self.shape[axis])
                       for axis, part in zip(axes, index)], axis=0)

    def prescribed_velocity(self, time, *index):
        values = super().prescribed_velocity(time, *index)
        values[:, index[1] == 0] = 0.3
        return values

    def tractions(self, time):
        return {"top": cases.pressure(1.0)}


def block(kind, case=Block, elements=None, fields=None, **given):
    """The `WeakForm` of a block, and its nodes."""
    part = case(parameters(**given))
    part.kinematics, part.elements, part.fields = KINDS[kind], elements, fields
    grid = Grid(PETSc.COMM_WORLD, part.shape, None, part.material.model.has_fluidity,
                part.kinematics)
    return WeakForm(grid, part), part.coordinates(*grid.nodes.index)


def random(grid, seed):
    return np.random.default_rng(seed).standard_normal(grid.n_local)


@pytest.mark.parametrize("model", ["ngf", "ngf_primitive", "li"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_jacobian_is_the_derivative_of_the_residual(kind, model):
    """With elasticity, inertia, convection and a load."""
    form, x = block(kind, model=model, inertia="true", **STRONG)
    grid, shift, change = form.grid, 7.0, random(form.grid, 3)
    local, rate = 1.0 + 0.1 * random(grid, 1), random(grid, 2)
    increment = form.increment(x, form.no_stress() + 0.02, 0.1, 0.0)
    matrix, vector, product = form.create_matrix(), grid.create_vector(), grid.create_vector()
    form.jacobian(local, shift, increment, matrix)
    grid.from_local(change, vector)
    matrix.mult(vector, product)
    ends = [form.residual(local + h * change, rate + h * shift * change, increment)
            for h in (1e-6, -1e-6)]
    difference = (ends[0] - ends[1]) / 2e-6
    for part in (slice(None), slice(-grid.corners.owned.size, None)):
        scale = np.abs(difference[part]).max()
        assert np.abs(product.array[part] - difference[part]).max() < 1e-8 * scale


@pytest.mark.skipif(PETSc.COMM_WORLD.size > 1, reason="the loops are serial")
@pytest.mark.parametrize("model", ["ngf", "li"])
@pytest.mark.parametrize("kind", KINDS)
def test_vectorised_kernels_equal_plain_loops(kind, model):
    form, x = block(kind, model=model, elements=(2, 1, 1)[:KINDS[kind].dim], **STRONG)
    grid = form.grid
    local = 1.0 + 0.1 * random(grid, 1)
    increment = form.increment(x, form.no_stress() + 0.02, 0.1, 0.0)
    matrix = form.create_matrix()
    form.jacobian(local, 0.0, increment, matrix)
    forces, tangent = plain.assembled(form, local, increment)
    order = grid.owned[np.argsort(grid.global_number[grid.owned])]
    dense = matrix.convert("dense").getDenseArray()
    found = form.residual(local, np.zeros(grid.n_local), increment)
    np.testing.assert_allclose(found, forces[grid.owned], atol=1e-12 * np.abs(forces).max())
    np.testing.assert_allclose(dense, tangent[np.ix_(order, order)],
                               atol=1e-12 * np.abs(tangent).max())


class Still(Block):
    """A block without base flow."""

    @property
    def base_gradient(self):
        return np.zeros((self.kinematics.velocities, self.kinematics.dim))


class Manufactured(Still):
    """Smooth v, P and g: prescribed v and g on the sides, but the traction on the top."""

    def value(self, names, x):
        return np.array([self.fields[name](*x) + 0.0 * x[0] for name in names])

    def velocity(self, x, first="v"):
        return self.value([f"{first}{c}" for c in range(self.kinematics.velocities)], x)

    def prescribed_velocity(self, time, *index):
        top = (index[1] == 2 * self.shape[1]) & ~self.edge((index[0], *index[2:]), (0, 2))
        return np.where(self.edge(index) & ~top, self.velocity(self.coordinates(*index)), np.nan)

    def prescribed_fluidity(self, time, *index):
        return np.where(self.edge(index), self.value("g", self.coordinates(*index))[0], np.nan)

    def tractions(self, time):
        dim, rows = range(self.kinematics.dim), range(self.kinematics.velocities)
        return {"top": lambda x, area: np.array([sum(
            self.value([f"s{c}{k}"], x)[0] * area[k] for k in dim) for c in rows])}

    def body_force(self, x):
        return self.velocity(x, "b")

    def fluidity_source(self, x):
        return self.value("f", x)[0]


def manufactured_fields(kind, material, theta, density):
    """Fields, and the forces that balance them by the strong form of (2.2) and (2.5)."""
    import sympy as sp

    x, y, z = symbols = sp.symbols("x y z")
    variables = symbols[:kind.dim]
    if kind.axisymmetric:  # x is the radius
        stream = x**2 * y / 2 + x**2 * sp.sin(y) * sp.cos(x) / 10
        v = [-sp.diff(stream, y) / x, sp.diff(stream, x) / x, x * (1 + x * y / 3 + sp.sin(y) / 5)]
    elif kind.dim == 3:
        v = [x + sp.sin(y) * sp.cos(x) / 5 + sp.sin(z) / 5,
             -y / 2 + (2 - sp.cos(y)) * sp.sin(x) / 5, -z / 2 + sp.sin(x + y) / 5]
    else:
        v = [x + sp.sin(y) * sp.cos(x) / 5, -y + (2 - sp.cos(y)) * sp.sin(x) / 5,
             x * y / 2 + sp.sin(x) / 5]
    v = v[:kind.velocities]
    L, acceleration = sp.zeros(3, 3), []
    for c, part in enumerate(v):
        for k, variable in enumerate(variables):
            L[c, k] = sp.diff(part, variable)
        acceleration.append(sum(L[c, k] * v[k] for k in range(kind.dim)))
    if kind.axisymmetric:
        L[2, 2] = v[0] / x
        if kind.velocities == 3:
            L[0, 2] = -v[2] / x
            acceleration[0] -= v[2]**2 / x
            acceleration[2] += v[0] * v[2] / x
    assert sp.simplify(L.trace()) == 0
    P, g = 2 + sp.sin(x + y) / 4, 3 + sp.cos(x - y) / 4
    D = (L + L.T) / 2
    rate = sp.sqrt(2 * sum(part**2 for part in D))
    S = 2 * P / (g + theta * P) * D - P * sp.eye(3)
    mu, s = rate / (g + theta * P), sp.sqrt(P) / material.inertial_time
    mu_s, b, A = material.law.mu_s, material.law.b, material.model.A
    source = (mu - mu_s) * (g - s * (mu - mu_s) / (b * mu))
    laplacian = sum(sp.diff(g, variable, 2) for variable in variables)
    b_force = [density * acceleration[c] - sum(sp.diff(S[c, k], variables[k])
                                               for k in range(kind.dim))
               for c in range(kind.velocities)]
    if kind.axisymmetric:
        laplacian += sp.diff(g, x) / x
        b_force[0] -= (S[0, 0] - S[2, 2]) / x
        b_force[1] -= S[0, 1] / x
        if kind.velocities == 3:
            b_force[2] -= 2 * S[0, 2] / x
    fields = {**{f"v{c}": part for c, part in enumerate(v)},
              **{f"b{c}": part for c, part in enumerate(b_force)},
              **{f"s{c}{k}": S[c, k] for c in range(3) for k in range(3)},
              "P": P, "g": g, "f": source - A**2 * laplacian, "mu": mu}
    return {name: sp.lambdify(variables, part, "numpy") for name, part in fields.items()}


@pytest.mark.parametrize("inertia", ["false", "true"])
@pytest.mark.parametrize("kind", KINDS)
def test_manufactured_solutions_have_the_orders_of_the_elements(kind, inertia):
    theta, found = 0.2, []
    sizes = (2, 4) if KINDS[kind].dim == 3 else (4, 8, 16)
    given = {"mu_s": 0.3, "inertial_number": 0.3, "inertia": inertia}
    material = Block(parameters(**given)).material
    fields = manufactured_fields(KINDS[kind], material, theta,
                                 material.bulk_density if inertia == "true" else 0.0)
    for n in sizes:
        form, x = block(kind, Manufactured, (n,) * KINDS[kind].dim, fields, **given)
        case, grid = form.case, form.grid
        assert (case.value(["mu"], x) > case.law.mu_s).all()  # F has a kink at the yield value
        exact = grid.join(case.velocity(x), case.value("g", x)[0],
                          case.value("P", x[:, grid.corner_nodes()])[0])
        step = at_rest(form, x, theta)
        local = newton(form, step, exact, 1e-10)

        def squares(p):
            return np.array([((p.velocity - case.velocity(p.x))**2).sum(axis=0),
                             (p.element.shape @ p.nodal_g - case.value("g", p.x)[0])**2,
                             (p.P - case.value("P", p.x)[0])**2])

        values = (step.geometry.weight * form.collect(local, step, squares))
        found.append(np.sqrt(grid.comm.tompi4py().allreduce(
            values[..., grid.elements.owned].sum(axis=(1, 2)))))
    orders = np.log2(np.array(found[-2]) / np.array(found[-1]))
    assert (orders > ([2.6, 2.6, 1.7] if len(sizes) == 2 else [2.8, 2.8, 1.8])).all(), orders


def test_material_that_turns_as_a_block_keeps_its_stress():
    """In the basis e_r, e_z, e_t, which turns with it."""
    form, x = block("swirl", Still, model="li")
    grid = form.grid
    local = grid.join([0.0 * x[0], 0.0 * x[0], 2.0 * x[0]], None, 1.0)
    stress = form.no_stress() + np.arange(1.0, 7.0).reshape(-1, 1, 1)
    state = State(0.0, x, local, stress)
    found = TimeStep(form, state, 0.1).transport(state)[0]
    np.testing.assert_allclose(found, stress, atol=1e-12)


class ChuteOutOfPlane(_fixed.Falling):
    """The vertical chute with the flow along x3 instead of -x2."""

    kinematics, periodic, span, symbol = OUT_OF_PLANE, (False, True), "width", "W"

    @property
    def weight(self):
        return 0.0, 0.0, self.parameters.gravity

    def prescribed_velocity(self, time, *index):
        values = super().prescribed_velocity(time, *index)
        values[:, self.on("left", *index)] = 0.0
        values[1:, self.on("right", *index)] = 0.0
        return values


@pytest.mark.parametrize("model", ["ngf", "li"])
def test_gravity_along_the_third_direction_gives_the_profile_of_the_chute(model):
    plane = discretised(case="vertical_chute", model=model, width=8, height=1, gravity=0.15,
                        element_size=0.5)
    case, profile = ChuteOutOfPlane(plane.case.parameters), plane.case.profile()
    grid = Grid(PETSc.COMM_WORLD, case.shape, case.periodic, plane.grid.has_fluidity, OUT_OF_PLANE)
    fields = []
    for form, c, sign in ((plane, 1, -1.0), (WeakForm(grid, case), 2, 1.0)):
        grid, x = form.grid, form.case.coordinates(*form.grid.nodes.index)
        velocity = np.zeros((form.kinematics.velocities, x.shape[1]))
        velocity[c] = sign * profile.velocity(x[0])
        start = grid.join(velocity, profile.fluidity(x[0]), 1.0)
        local = newton(form, at_rest(form, x, 1e-6), start, 1e-9)
        fields.append(sign * grid.split(local)[0][c])
    np.testing.assert_allclose(*fields, atol=1e-9 * np.abs(fields[0]).max())


def test_a_cell_without_weight_has_the_profile_of_the_ring():
    """`annular_shear` in the plane, whose profile is one-dimensional, and `annular_cell`."""
    given = {"inner_radius": 6, "outer_radius": 10, "inertial_number": 0.01}
    profile = cases.create(parameters(case="annular_shear", **given)).profile()
    form = discretised(case="annular_cell", height=1, top_pressure=1, element_size=0.25, **given)
    type(form.case).weight, weight = (0.0, 0.0), type(form.case).weight
    try:
        grid, x = form.grid, form.case.coordinates(*form.grid.nodes.index)
        start = grid.join([0.0 * x[0], 0.0 * x[0], profile.velocity(x[0])],
                          profile.fluidity(x[0]), 1.0)
        local = newton(form, at_rest(form, x, 0.0), start, 1e-8)
    finally:
        type(form.case).weight = weight
    velocity, fluidity, pressure = grid.split(local)
    np.testing.assert_allclose(velocity[2], profile.velocity(x[0]), atol=2e-4 * 6.0)
    np.testing.assert_allclose(pressure, 1.0, atol=1e-8)
    assert np.abs(velocity[:2]).max() < 1e-8
