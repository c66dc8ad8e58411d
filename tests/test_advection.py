"""Advection of stress through a fixed mesh: stability, order and independence of the ranks.

All tests without runs pass on any number of ranks.
"""

from functools import partial

import h5py
import numpy as np
import pytest
from conftest import discretised, pgran
from mpi4py import MPI
from petsc4py import PETSc

from pgran.kinematics import PLANE
from pgran.solve.state import State, TimeStep
from pgran.space.advection import Advection
from pgran.space.element import Geometry, element
from pgran.space.grid import Grid

COMM = MPI.COMM_WORLD


def nodes_of(grid):
    """Global indices of the nodes in elements, (2, n_nodes)."""
    return grid.nodes.index / 2.0


def at_points(grid, x):
    """Coordinates of the Gauss points of the local elements, (2, points, n)."""
    return np.array([element(2).shape @ part[grid.element_nodes] for part in x])


def owned(grid, values):
    return values[..., grid.elements.owned]


# Flows: the grid, its nodes and the velocity

def uniform(comm, slope, shape=(6, 4), periodic=(True, False)):
    """Uniform flow through squares, by default along a periodic layer or through its walls."""
    grid = Grid(comm, shape, periodic)
    x = nodes_of(grid)
    return grid, x, np.array([np.ones_like(x[0]), np.full_like(x[0], slope)])


def distorted(comm, n=6):
    """Oblique uniform flow through a periodic cell of curved elements."""
    grid = Grid(comm, (n, n), (True, True))
    x = nodes_of(grid) * 6.0 / n
    a, b = 2.0 * np.pi * x / 6.0
    x = x + 0.12 * np.array([np.sin(a) * np.cos(b), np.sin(2.0 * a + b)])
    return grid, x, np.array([np.ones_like(a), np.full_like(a, 0.7)])


def ring(comm):
    """A sheared ring that turns counterclockwise; i counts clockwise."""
    grid = Grid(comm, (8, 4), (True, False))
    r, angle = 2.0 + nodes_of(grid)[1] / 4.0, -2.0 * np.pi * (grid.nodes.index[0] % 16) / 16
    x = r * np.array([np.cos(angle), np.sin(angle)])
    return grid, x, np.array([-x[1], x[0]]) * (3.0 - r)


def vortex(comm):
    """A flow without divergence that circulates within walls."""
    grid = Grid(comm, (6, 4))
    x = nodes_of(grid)
    (a, b), (c, d) = x, (6.0 - x[0], 4.0 - x[1])
    return grid, x, 0.1 * np.array([a * c * (d - b), -b * d * (c - a)])


#: Inflow and outflow on all sides.
channel = partial(uniform, slope=-0.7, shape=(5, 4), periodic=(False, False))
FLOWS = {"straight": partial(uniform, slope=0.0), "oblique": partial(uniform, slope=0.7),
         "channel": channel, "distorted": distorted, "ring": ring, "vortex": vortex}


@pytest.mark.parametrize("courant", [0.01, 0.2, 1.0, 2.5])
@pytest.mark.parametrize("flow", FLOWS)
def test_no_disturbance_grows_at_any_courant_number(flow, courant):
    grid, x, velocity = FLOWS[flow](PETSc.COMM_SELF)
    scheme = Advection(grid, velocity, x)
    size = element(2).points * grid.elements.owned.size
    fields = grid.with_ghost_elements(np.eye(size).reshape(size, element(2).points, -1))
    step = owned(grid, scheme.advect(fields, courant / scheme.rate)).reshape(size, size).T
    # Multiple eigenvalues 1 of fields that the flow does not change are computed to 1e-8 only.
    assert np.abs(np.linalg.eigvals(step)).max() < 1.0 + 1e-7
    many = np.linalg.matrix_power(step, 1000)
    assert np.abs(many).sum(axis=1).max() < 4.0  # algebraic growth is excluded too


@pytest.mark.parametrize("courant", [0.3, 1.2])
def test_a_smooth_field_is_transported_with_third_order(courant):
    def exact(x, t):
        a, b = 2.0 * np.pi / 6.0 * (x - t * np.array([1.0, 0.7]).reshape(2, 1, 1))
        return np.sin(a) + np.cos(a + b)

    errors = []
    for n in (16, 32):
        grid, x, velocity = distorted(PETSc.COMM_WORLD, n)
        scheme = Advection(grid, velocity, x)
        steps, points = round(scheme.rate / courant), at_points(grid, x)
        fields = exact(points, 0.0)[None]
        for _ in range(steps):
            fields = scheme.advect(fields, 1.0 / steps)
        error = owned(grid, fields[0] - exact(points, 1.0))
        errors.append(COMM.allreduce(np.abs(error).max(initial=0.0), MPI.MAX))
    assert errors[1] < 2e-3
    assert np.log2(errors[0] / errors[1]) > 2.7


def test_entering_material_has_the_mean_of_the_element_that_it_enters():
    grid, x, velocity = channel(PETSc.COMM_WORLD)
    scheme, points = Advection(grid, velocity, x), at_points(grid, x)
    fields = (points[0] + 0.5 * np.cos(3.0 * points[1]))[None]
    for _ in range(60):
        fields = scheme.advect(fields, 1.0)
    inside = owned(grid, fields)
    low, high = (COMM.allreduce(part, how) for part, how in (
        (inside.min(initial=np.inf), MPI.MIN), (inside.max(initial=-np.inf), MPI.MAX)))
    # By now the value of the element at the corner of inflow, (0, 4), fills the domain.
    assert high - low < 1e-10 and -0.5 < low < 1.5


@pytest.mark.parametrize("flow", FLOWS)
def test_integrals_and_uniform_fields_are_conserved_on_any_number_of_ranks(flow):
    found = []
    for comm in PETSc.COMM_SELF, PETSc.COMM_WORLD:
        grid, x, velocity = FLOWS[flow](comm)
        x1, x2 = at_points(grid, x)
        start = np.array([3.0 + np.sin(x1) * x2, x2**2, np.full_like(x1, -2.0)])
        scheme = Advection(grid, velocity, x)
        end = scheme.advect(start, 0.7)
        found.append((grid, scheme.rate, end))
    np.testing.assert_allclose(end[2], -2.0, rtol=1e-13)
    if flow in ("straight", "distorted", "vortex"):  # closed or periodic
        weight = owned(grid, Geometry(x[:, grid.element_nodes]).weight)
        totals = [COMM.allreduce((weight * owned(grid, fields[0])).sum())
                  for fields in (start, end)]
        assert COMM.allreduce(np.abs(owned(grid, end - start)).max(initial=0.0), MPI.MAX) > 0.1
        assert totals[1] == pytest.approx(totals[0], rel=1e-12)
    (serial, rate, complete), (grid, parallel_rate, part) = found
    assert parallel_rate == pytest.approx(rate, rel=1e-14)
    nx, ny = grid.shape
    table = np.empty((3, element(2).points, ny, nx))
    table[..., serial.elements.index[1] % ny, serial.elements.index[0] % nx] = complete
    i, j = grid.elements.index
    np.testing.assert_allclose(part, table[..., j % ny, i % nx], atol=1e-13)


def test_transport_and_rotation_of_stress_have_second_order_in_time():
    form = discretised(case="planar_shear", width=4, height=4, element_size=0.5)
    grid = form.grid
    x = form.case.coordinates(*grid.nodes.index)
    phase, across = np.pi * x[0] / 2.0, x[1] * (4.0 - x[1]) / 4.0
    velocity = np.array([1.0 + np.sin(phase) * (4.0 - 2.0 * x[1]) / 4.0,
                         -np.pi / 2.0 * np.cos(phase) * across])
    local = grid.join(velocity, 1.0, 1.0)
    found = []
    for steps in (8, 16, 32):
        stress = form.no_stress() + np.array([1.0, -1.0, 0.5]).reshape(-1, 1, 1)
        for _ in range(steps):
            step = TimeStep(form, State(0.0, x, local, stress), 1.0 / steps)
            stress = step.transport(State(0.0, x, local, stress))[0]
        found.append(owned(grid, stress))
    coarse, fine = (COMM.allreduce(np.abs(b - a).max(initial=0.0), MPI.MAX)
                    for a, b in zip(found, found[1:]))
    assert fine < 0.02
    assert np.log2(coarse / fine) > 1.7


def test_both_stresses_of_a_state_are_transported_and_rotated():
    form = discretised(case="annular_shear", inner_radius=3, outer_radius=6, element_size=1)
    grid = form.grid
    x = form.case.coordinates(*grid.nodes.index)
    local, dt = grid.join([-x[1], x[0]], 1.0, 1.0), 0.1
    x1, x2 = at_points(grid, x)

    def turned(t):
        """A tensor S(r, angle) = R(angle/2) S(r) of a ring after the ring has turned by t."""
        radius, angle = np.hypot(x1, x2) / 6.0, np.arctan2(x2, x1)
        return PLANE.rotate(np.array([radius, -radius, 0.3 + 0.0 * radius]),
                            np.array([t + (angle - t) / 2.0]))

    state = State(0.0, x, local, turned(0.0), dt, 2.0 * turned(0.0), np.zeros_like(local))
    step = TimeStep(form, state, dt)
    latest, earlier = step.transport(state)
    np.testing.assert_allclose(latest, turned(dt), atol=2e-3)
    # A step that only advects or only rotates is off by 0.1/2 of the tensor.
    assert np.abs(turned(dt) - turned(0.0)).max() > 0.05
    np.testing.assert_allclose(earlier, 2.0 * latest, atol=1e-12)
    assert step.end(local, latest).previous_stress == pytest.approx(latest)
    assert step.courant_number == pytest.approx(
        dt * grid.shape[0] / (2.0 * np.pi), rel=0.02)  # rigid: the angle per element


def test_a_chute_stays_uniform_along_its_flow(tmp_path):
    path, end, dt = tmp_path / "chute.h5", 60.0, 0.5
    pgran(0, "vertical_chute.opts", path, "-ts_type", "beuler", "-pgran_model", "li",
          "-pgran_gravity", 0.06, "-pgran_width", 20, "-pgran_height", 2, "-pgran_element_size", 1,
          "-pgran_step_max", dt, "-pgran_end_time", end, "-pgran_snapshots", end)
    with h5py.File(path) as file:
        shear = file["snapshots/0000/stress_tensor"][..., 2]
        speed = np.abs(file["snapshots/0000/velocity"][...]).max()
        courant, step = (file["history"][name][...] for name in ("courant_number", "step_size"))
    assert np.ptp(shear, axis=0).max() < 1e-10
    assert np.abs(shear).max() == pytest.approx(0.6, rel=0.05)
    assert len(step) < 1.5 * end / dt
    assert courant[-1] == pytest.approx(speed * step[-1], rel=1e-3)  # elements of 1 d
