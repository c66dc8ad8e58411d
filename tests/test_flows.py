"""Flows on fixed meshes: equations, steady profiles, transient runs and spectra.

Tests that start no run also work on several ranks.
"""

import json

import h5py
import mpmath
import numpy as np
import pytest
from conftest import discretised, newton, noise, parameters, pgran, run_ranks
from mpi4py import MPI
from petsc4py import PETSc
from test_runs import differences
from test_weakform import assert_jacobian_is_derivative

from pgran import cases
from pgran.options import ParameterError
from pgran.output.reader import stored_parameters
from pgran.output.writer import write_once
from pgran.solve.driver import AcceptedStep
from pgran.space.diagnostics import nodal_fields
from pgran.space.element import element
from pgran.space.grid import Grid
from pgran.space.weakform import WeakForm
from pgran.theory import profiles

COMM = MPI.COMM_WORLD
#: A coarse mesh of each flow.
COARSE = {
    "planar_shear": {"height": 8, "gravity": 0.05, "element_size": 1, "grading": 1.5},
    "vertical_chute": {"width": 8, "gravity": 0.15, "element_size": 1},
    "annular_shear": {"inner_radius": 3, "outer_radius": 6, "element_size": 1},
    "inclined_plane": {"height": 8, "slope": 24, "element_size": 1, "grading": 2}}


def options(**given):
    """Options of a run as on the command line."""
    return [text for name, value in given.items() for text in (f"-pgran_{name}", value)]


def created(**given):
    return cases.create(parameters(**given))


def disturbed(form, size=0.02, pressure=0.5):
    """Unknowns near the reference flow with more pressure, and the increment of an elastic step."""
    grid, case = form.grid, form.case
    x = case.coordinates(*grid.nodes.index)
    corners = x[:, grid.corner_nodes()]
    velocity, fluidity, _ = case.reference(x)
    local = grid.join(velocity, fluidity, case.reference(corners)[2] + pressure)
    increment = form.increment(x, form.no_stress() + 0.02, 0.1, 0.0)
    return local * (1.0 + size * noise(grid, 3)), increment


@pytest.mark.parametrize("case, wall, model", [
    ("planar_shear", "natural", "ngf"), ("vertical_chute", "zero", "ngf"),
    ("annular_shear", "local", "ngf"), ("inclined_plane", "zero", "ngf_primitive")])
def test_jacobian_with_walls_and_convection_is_the_derivative_of_the_residual(
        monkeypatch, case, wall, model):
    monkeypatch.setattr("pgran.space.weakform.BATCH", {2: 10})  # several batches
    form = discretised(case=case, model=model, wall_fluidity=wall, inertia=True, law="jop", mu_2=6,
                       **COARSE[case])
    local, increment = disturbed(form)
    assert_jacobian_is_derivative(form, local, increment)


class Streaming(cases.Case):
    """A piece of a fixed mesh in a base flow."""

    moving, shape, base_gradient = False, (3, 2), np.array([[0.3, 0.2], [0.1, -0.3]])

    def coordinates(self, i, j):
        return np.array([0.5 * i + 0.02 * j, 0.4 * j + 0.03 * i])


def test_convection_and_mean_velocity_include_the_base_flow():
    given = parameters(inertia=True, inertial_number=0.3, width=3, height=2, element_size=1)
    grid = Grid(PETSc.COMM_WORLD, Streaming.shape)
    streaming, plain = (WeakForm(grid, Streaming(given)) for _ in range(2))
    plain.case.base_gradient = np.zeros((2, 2))
    x = streaming.case.coordinates(*grid.nodes.index)
    local = 1.0 + 0.1 * noise(grid, 2)
    total = local.copy()
    nodal = grid.split(total)[0]
    nodal += Streaming.base_gradient @ x
    rate, found = noise(grid, 4), []
    for form, unknowns in ((streaming, local), (plain, total)):
        increment = form.increment(x, form.no_stress() + 0.02, 0.1, 0.0)
        found.append(form.residual(unknowns, rate, increment))
        assert_jacobian_is_derivative(form, unknowns, increment, rate)
    np.testing.assert_allclose(*found, atol=1e-12 * np.abs(found[1]).max())
    flow = AcceptedStep(streaming, 0.0, np.zeros(grid.n_local), None, x)
    corners = streaming.case.coordinates(*np.array([[0, 6, 0, 6], [0, 0, 4, 4]]))
    for side, points in (((), corners), (("top",), corners[:, 2:])):
        np.testing.assert_allclose(flow.mean_velocity(*side),
                                   Streaming.base_gradient @ points.mean(axis=1), rtol=1e-12)


def test_the_inertial_number_has_a_value_where_the_pressure_vanishes():
    form = discretised(case="inclined_plane", law="jop", mu_2=6, **COARSE["inclined_plane"])
    local, increment = disturbed(form, 0.0, pressure=-1e-9)  # by rounding at the free surface
    fields = nodal_fields(form, local, increment)
    I, P, g, mu = (fields[name][form.grid.nodes.owned] for name in (
        "inertial_number", "pressure", "fluidity", "stress_ratio"))
    assert COMM.allreduce(P.min(initial=1.0), MPI.MIN) < 0.0
    assert np.isfinite(I).all()
    inside = P > 0.1
    expected = (g * mu)[inside] / form.material.inverse_time(P[inside])
    np.testing.assert_allclose(I[inside], expected)


def test_a_nan_in_a_field_is_written_and_reported_with_its_position(tmp_path, capsys):
    form = discretised(element_size=20)
    nodes = form.grid.nodes
    field = np.where((nodes.index == [[2], [1]]).all(axis=0), np.nan, 1.0)
    fields = {"coordinates": form.case.coordinates(*nodes.index), "speed": field}
    write_once(COMM.bcast(tmp_path) / "mode.h5", form, fields)
    error_text = COMM.bcast(capsys.readouterr().err)
    assert "snapshot 0000: speed is" in error_text and "x = (20, 10) d" in error_text


def test_li_on_a_slope_has_the_profile_of_bagnold():
    case = created(case="inclined_plane", model="li", law="jop", slope=24, height=12)
    I = case.law.inertial_number(np.tan(np.radians(24.0)))[0]
    y = np.linspace(0.0, 12.0, 50)
    v = 2.0 / 3.0 * I * np.sqrt(np.cos(np.radians(24.0))) * (12.0**1.5 - (12.0 - y)**1.5)
    np.testing.assert_allclose(case.profile().velocity(y), v, atol=1e-12 * v.max())


def test_li_in_a_ring_flows_within_its_yield_radius():
    """Bingham: r (v/r)' = -(mu - mu_s)/(b I0), mu = mu_i (R_i/r)^2."""
    case = created(case="annular_shear", model="li", inner_radius=4, outer_radius=9)
    profile, law, p = case.profile(), case.law, case.parameters
    b, mu_i = law.stress_ratio(np.array(0.0))[1], profile.constant
    r = np.linspace(4.0, 9.0, 60)
    end = min(9.0, 4.0 * np.sqrt(mu_i / law.yield_ratio))
    s = np.minimum(r, end)
    angular = (0.5 * mu_i * 16.0 * (s**-2 - end**-2) - law.yield_ratio * np.log(end / s)) / (
        b * p.inertial_number)
    np.testing.assert_allclose(profile.velocity(r), r * angular, atol=1e-11)
    assert profile.velocity(4.0) == pytest.approx(4.0, rel=1e-12)


def test_core_of_a_chute_is_an_airy_function():
    """A^2 g'' = (mu_s - gravity z) g, with g' = 0 in the middle."""
    case = created(case="vertical_chute", width=14, gravity=0.08)

    def argument(z):
        return (case.law.yield_ratio - 0.08 * z) / (case.parameters.A * 0.08)**(2.0 / 3.0)

    ends = [mpmath.airyai(argument(0.0), derivative=1), mpmath.airybi(argument(0.0), derivative=1)]
    z = np.linspace(0.0, case.law.yield_ratio / 0.08, 12)
    core = np.array([float(ends[1] * mpmath.airyai(argument(part))
                           - ends[0] * mpmath.airybi(argument(part))) for part in z])
    found = case.profile().fluidity(7.0 + z)
    np.testing.assert_allclose(found / found[0], core / core[0], rtol=1e-9)


@pytest.mark.parametrize("law, length", [("bingham", 0.777), ("jop", 1.218)])
def test_deep_bed_creeps_with_its_decay_length(law, length):
    case = created(case="planar_shear", law=law, height=12, gravity=5, inertial_number=1e-3)
    low, high = case.profile().fluidity(np.array([3.0, 5.0]))  # mu is 0.01 there
    assert 2.0 / np.log(high / low) == pytest.approx(length, rel=0.03)


@pytest.mark.parametrize("slope, height", [(22, 4.850), (23, 3.344), (24, 2.608), (25, 2.136),
                                           (26, 1.788), (28, 1.273), (30, 0.858)])
def test_stopping_heights_are_known(slope, height):
    law = created(case="inclined_plane", law="jop", slope=slope).law
    assert profiles.stopping_height(law, 0.48, slope) == pytest.approx(height, abs=6e-4)


@pytest.mark.parametrize("given, message", [
    ({"case": "inclined_plane", "slope": 15}, "the slope of 15 degrees has mu = 0.2679"),
    ({"case": "vertical_chute", "gravity": 0.03}, "gravity W/2, has mu = 0.3"),
    ({"case": "inclined_plane", "law": "jop", "slope": 25, "height": 2, "element_size": 0.25,
      "model": "ngf_primitive"}, "does not exceed H_stop = (pi/2) xi = 2.136 d")])
def test_a_case_says_why_nothing_flows(given, message):
    assert message in created(**given).why_at_rest
    flowing = {"inclined_plane": {"slope": 26, "height": 3}, "vertical_chute": {"gravity": 0.05}}
    assert created(**{**given, **flowing[given["case"]]}).why_at_rest is None


@pytest.mark.parametrize("given, message", [
    ({"case": "inclined_plane", "law": "jop", "slope": 40}, "must be less than 32.76"),
    ({"case": "vertical_chute", "law": "jop", "gravity": 0.07}, "must be less than 0.06435"),
    ({"case": "annular_shear", "outer_radius": 10}, "must exceed inner_radius 10"),
    ({"case": "planar_shear", "inertial_number": 0}, "inertial_number 0: ")])
def test_a_load_without_steady_flow_is_an_error(given, message):
    with pytest.raises(ParameterError) as error:
        created(**given)
    assert message in str(error.value)


def solved(**given):
    """The form, exact fields, and solved fields of steady flow: velocity, g, P at own nodes."""
    form = discretised(**given)
    case, grid = form.case, form.grid
    profile = case.profile()
    x = case.coordinates(*grid.nodes.index)
    *exact, _ = case.steady(profile, x)
    corners = x[:, grid.corner_nodes()]
    points = np.array([element(2).shape @ part[grid.element_nodes] for part in x])
    stress = form.kinematics.mandel(case.steady(profile, points)[3])
    increment = form.increment(x, stress, 1e-9, 0.0)
    local = newton(form, increment, grid.join(*exact[:2], case.steady(profile, corners)[2]), 1e-9)
    velocity, _, pressure = grid.split(local)
    found = (velocity, nodal_fields(form, local, increment)["fluidity"],
             grid.corner_field(pressure))
    return form, *([field[..., grid.nodes.owned] for field in fields] for fields in (exact, found))


NARROW = {"planar_shear": "width", "inclined_plane": "width", "vertical_chute": "height"}
LAYER, SLOPE = {"height": 10, "gravity": 0.05}, {"height": 10, "slope": 24}


@pytest.mark.parametrize("case, law, model, given, sizes, orders, reached", [
    # F has a kink where mu = mu_s. Inside an element the kink causes an error of second order.
    ("planar_shear", "jop", "ngf", {**LAYER, "grading": 2},
     (0.5, 0.25, 0.125, 0.0625), (2.5, 2.5), (1e-6, 1e-6)),
    ("planar_shear", "bingham", "ngf_primitive", {**LAYER, "grading": 1.5},
     (0.5, 0.25, 0.125), (3.9, 3.9), (1e-6, 1e-6)),
    # On the boundary of elements the kink causes no error.
    ("vertical_chute", "jop", "ngf", {"width": 10, "gravity": 0.3819 / 4},
     (0.25, 0.125, 0.0625, 0.03125), (3.7, 3.7), (1e-6, 1e-6)),
    ("inclined_plane", "bingham", "ngf", {**SLOPE, "grading": 2},
     (0.5, 0.25, 0.125, 0.0625), (3.5, 3.5), (1e-6, 1e-6)),
    # The source of dynamic NGF is singular at the surface.
    ("inclined_plane", "jop", "ngf_primitive", {"height": 4, "slope": 23, "grading": 2},
     (1, 0.5, 0.25, 0.125), (3.7, 3.7), (5e-5, 5e-5)),
    # In LI g is a strain rate, of second order, and a root of the depth at the surface.
    ("inclined_plane", "jop", "li", {**SLOPE, "grading": 3},
     (0.125, 0.0625, 0.03125), (3.0, 1.4), (1e-6, 1e-4)),
    ("annular_shear", "bingham", "ngf", {"inner_radius": 2, "outer_radius": 4, "grading": 1.5},
     (0.5, 0.25, 0.125), (2.0, 2.0), (1e-4, 1e-4)),
])
def test_finite_elements_converge_to_the_profile(case, law, model, given, sizes, orders, reached):
    narrow, errors = NARROW.get(case), []
    for size in sizes:
        _, exact, found = solved(case=case, law=law, model=model, element_size=size, **given,
                                 **({narrow: 2 * size} if narrow else {}))
        errors.append([COMM.allreduce(np.abs(a - b).max(), MPI.MAX)
                       / COMM.allreduce(np.abs(a).max(), MPI.MAX)
                       for a, b in zip(exact[:2], found)])  # velocity and fluidity
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert (slopes > orders).all() and (np.array(errors[-1]) < reached).all()


def test_ring_with_inertia_has_the_centrifugal_pressure():
    given = {"case": "annular_shear", "inner_radius": 2, "outer_radius": 4, "inertial_number": 0.3,
             "element_size": 0.125}
    form, (_, _, exact), (_, _, found) = solved(**given, inertia=True)
    level = 1.0 - exact.min()
    assert level > 0.02
    np.testing.assert_allclose(found, exact, atol=0.01 * level)
    radii = np.linspace(2.0, 4.0, 400)
    speed = form.case.profile().velocity(radii)
    total = (0.6 * 0.09 * speed**2 / radii).sum() * (radii[1] - radii[0])
    assert level == pytest.approx(total, rel=0.02)


#: A mesh for runs, and how far velocity and fluidity may be from the profile on it.
RUNS = {"planar_shear": ({"width": 1}, 1e-4),
        "vertical_chute": ({"height": 1}, 2e-3),
        "annular_shear": ({"inner_radius": 5, "outer_radius": 10, "element_size": 0.5}, 1e-2),
        "inclined_plane": ({"width": 1}, 1e-3)}


@pytest.mark.parametrize("case", RUNS)
def test_options_file_finds_the_steady_flow(case, tmp_path):
    given, limit = RUNS[case]
    pgran(0, f"{case}.opts", tmp_path / "flow.h5", *options(**given))
    with h5py.File(tmp_path / "flow.h5") as file:
        assert file.attrs["steady_residual"] < 1e-7
        snapshot = {name: data[...].T for name, data in file["snapshots/0000"].items()}
        own = cases.create(stored_parameters(file))
    assert np.isfinite(snapshot["inertial_number"]).all()
    exact = own.steady(own.profile(), snapshot["coordinates"])
    for name, values in zip(("velocity", "fluidity"), exact):
        assert np.abs(snapshot[name] - values).max() < limit * np.abs(values).max()


def test_a_ring_in_xdmf_is_closed(tmp_path):
    import pyvista

    form = discretised(case="annular_shear", **RUNS["annular_shear"][0])
    nodes, path = form.grid.nodes, COMM.bcast(tmp_path) / "ring.h5"
    write_once(path, form, {"coordinates": form.case.coordinates(*nodes.index)})
    grid = pyvista.get_reader(str(path.with_suffix(".xdmf"))).read()
    while isinstance(grid, pyvista.MultiBlock):
        grid = grid[0]
    assert grid.area == pytest.approx(np.pi * (10.0**2 - 5.0**2), rel=2e-3)


@pytest.mark.parametrize("case, kind, given", [
    ("annular_shear", "pseudo", RUNS["annular_shear"][0]),
    ("inclined_plane", "beuler", {"model": "ngf_primitive", "height": 6, "width": 3, "slope": 26,
                                  "element_size": 1, "end_time": 10})])
def test_a_flow_does_not_depend_on_the_ranks(tmp_path, case, kind, given):
    paths = {ranks: tmp_path / f"{ranks}.h5" for ranks in (1, 3)}
    for ranks, path in paths.items():
        pgran(ranks, f"{case}.opts", path, "-ts_type", kind, *options(**given),
              *(("-ts_max_steps", 15) if kind == "beuler" else ()))
    found = differences(*paths.values())
    assert all(found[name] < 1e-8 for name in ("velocity", "fluidity", "deviator")), found


def test_flow_stops_within_the_time_limits_of_the_momentum_balance(tmp_path):
    path, slow = tmp_path / "stop.h5", 1e-3
    given = {"model": "li", "inertia": "true", "height": 4, "slope": 15, "width": 0.5,
             "element_size": 0.25, "shear_modulus": 1e5, "start": "flow"}
    done = pgran(0, "inclined_plane.opts", path, "-ts_type", "beuler", "-ts_max_steps", 10000,
                 *options(end_time=20, step_max=0.02, rest_speed=slow, **given))
    case = created(case="inclined_plane", law="jop", **given)
    assert "the material is static" in done.stdout and "at rest at time" in done.stdout
    with h5py.File(path) as file:
        time = file["history/time"][-1]
        assert file.attrs["complete"]
    # The base decelerates the layer by P mu with mu_s < mu < mu_2.
    y, angle, law = np.linspace(0.0, 4.0, 1001), np.radians(15.0), case.law
    mean_speed = case.reference(np.array([0.0 * y, y]))[0][0].mean()
    quick, late = (case.parameters.phi * mean_speed / (mu * np.cos(angle) - np.sin(angle))
                   for mu in (law.mu_2, law.mu_s))
    assert quick < time < late


def eigen(ranks, *arguments):
    return run_ranks(ranks, "-m", "pgran.eigen", *arguments)


def test_a_disturbance_decays_at_the_eigenvalue_of_its_mode(tmp_path):
    result, mode, path = (tmp_path / f"{name}.h5" for name in ("flow", "mode", "run"))
    pgran(0, "planar_shear.opts", result, *options(height=6, width=1, gravity=0.1))
    found = json.loads(eigen(2, "-pgran_restart", result, "-json").stdout)
    eigen(2, "-pgran_restart", result, "-pgran_output", mode)
    rate = found[0]["computed"]
    assert rate < 0.0 and found[0]["residual"] < 1e-6
    dt = -0.02 / rate
    pgran(0, "planar_shear.opts", path, "-ts_type", "beuler", *options(
        height=6, width=1, gravity=0.1, inertia="true", shear_modulus=1e7, mode_file=mode,
        mode_amplitude=1e-3, step_first=dt, step_max=dt, step_error=1e3, end_time=50 * dt,
        snapshots=f"{10 * dt},{50 * dt}"))
    with h5py.File(mode) as file, h5py.File(path) as run:
        assert file.attrs["growth_rate"] == pytest.approx(rate, rel=1e-6)
        shape, base = (file[f"snapshots/0000/{name}"][...] for name in (
            "velocity", "base_velocity"))
        left = [((snapshot["velocity"][...] - base) * shape).sum()
                for snapshot in run["snapshots"].values()]
    as_stepped = -np.log(1.0 - rate * dt) / dt
    assert np.log(left[1] / left[0]) / (40 * dt) == pytest.approx(as_stepped, rel=0.01)


@pytest.mark.parametrize("side", [0.97, 1.03])
def test_layer_at_rest_becomes_unstable_at_its_stopping_height(side, tmp_path):
    """The rate of g = 0 is ((A d/xi)^2 - (pi A d/(2 H))^2)/t0, of both signs about H_stop."""
    t0, slope, path = 0.5, 25.0, tmp_path / "rest.h5"
    law = created(case="inclined_plane", law="jop").law
    height = side * profiles.stopping_height(law, 0.48, slope)
    pgran(0, "inclined_plane.opts", path, "-ts_type", "beuler", *options(
        model="ngf_primitive", relaxation_time=t0, start_fluidity=0, slope=slope,
        shear_modulus=1e5, height=height, element_size=height / 16, width=height / 8, end_time=1))
    with h5py.File(path) as file:
        assert np.abs(file["snapshots/0000/fluidity"][...]).max() == 0.0
    found = json.loads(eigen(0, "-pgran_restart", path, "-json",
                             "-pgran_steady_time", 0.01).stdout)
    stiffness = law.inverse_length_squared(np.array(np.tan(np.radians(slope))))[0]
    expected = (stiffness - (np.pi * 0.48 / (2.0 * height))**2) / t0
    assert found[0]["computed"] == pytest.approx(expected, abs=1e-4 * stiffness / t0)
    assert np.sign(found[0]["computed"]) == np.sign(side - 1.0)
