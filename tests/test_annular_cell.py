"""The annular cell with gravity, compared with finite volumes and published inputs."""

import numpy as np
import pytest
from conftest import ROOT, pgran, refused, run_ranks
from finite_volumes import Cell

import pgran as package

#: v_t over V at these distances (d) from the inner wall, with dynamic NGF in the slow limit.
DISTANCES = np.array([0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 10.0])
SLOW = [0.8683, 0.7422, 0.5199, 0.3456, 0.1338, 0.02438, 0.00671]


def on_top(result):
    """Radii (n,) and v_t (n,) of the nodes on the top."""
    snapshot = result.snapshots[-1]
    return snapshot.x[-1, :, 0], snapshot["velocity_3"][-1]


@pytest.mark.parametrize("model, size", [("ngf", 0.5), ("ngf_primitive", 1)])
def test_cell_with_gravity_agrees_with_finite_volumes(tmp_path, model, size):
    path = tmp_path / "cell.h5"
    pgran(0, "annular_cell.opts", path, "-pgran_model", model, "-pgran_element_size", size)
    result = package.open(path)
    assert result.history["newton_iterations"].sum() <= 40
    r, v = on_top(result)
    radii = 60.0 + DISTANCES
    coarse, fine = (Cell(result.parameters, n, 15).on_top(radii) for n in (160, 320))
    found = np.interp(radii, r, v) / 60.0
    np.testing.assert_allclose(found, (fine + (fine - coarse) / 3.0) / 60.0, atol=1e-3)
    if model == "ngf_primitive":
        np.testing.assert_allclose(found, SLOW, atol=1e-3)
    snapshot = result.snapshots[-1]
    np.testing.assert_allclose(snapshot["angular_velocity"], snapshot["velocity_3"]
                               / snapshot.x[..., 0])
    np.testing.assert_allclose(snapshot["pressure"], 15.1 - snapshot.x[..., 1], atol=2e-2)


def test_inertia_gives_the_centrifugal_pressure_below_a_held_top(tmp_path):
    """dP/dr = phi I0^2 w^2 r at mid-height."""
    path = tmp_path / "cell.h5"
    pgran(0, "annular_cell.opts", path, inertia="true", inertial_number=0.3, inner_radius=2,
          outer_radius=4, height=1, top_pressure=5, element_size=0.125, law="jop", mu_2=2)
    snapshot, options = package.open(path).snapshots[-1], package.open(path).options
    row = snapshot.x.shape[0] // 2
    r, w, P = (field[row] for field in (snapshot.x[..., 0], snapshot["angular_velocity"],
                                        snapshot["pressure"]))
    slope = options["phi"] * 0.09 * w**2 * r
    rise = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(r))])
    np.testing.assert_allclose((P - P[0])[::2], rise[::2], atol=0.02 * rise[-1])
    assert np.abs(snapshot["velocity_2"][-1]).max() == 0.0


def test_the_cell_does_not_depend_on_the_ranks(tmp_path):
    one, *others = (tmp_path / f"{ranks}.h5" for ranks in (0, 2, 3))
    for path in (one, *others):
        pgran(int(path.stem), "annular_cell.opts", path, model="ngf_primitive", element_size=1,
              height=5)
    first = package.open(one).snapshots[-1]
    for path in others:
        snapshot = package.open(path).snapshots[-1]
        for name in ("velocity", "fluidity", "pressure", "deviator"):
            expected = first.stored(name)
            np.testing.assert_allclose(snapshot.stored(name), expected,
                                       atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("given, message", [
    (("outer_radius", 50), "must exceed -pgran_inner_radius 60"),
    (("element_size", 0.3), "must divide the gap of 20"),
    (("height", 7.3), "must be an integer multiple of -pgran_element_size"),
    (("floor", "soft"), "smooth | rough")])
def test_a_cell_that_cannot_be_meshed_is_an_error(tmp_path, given, message):
    name, value = given
    refused(run_ranks(0, "-m", "pgran", "-options_file", ROOT / "options" / "annular_cell.opts",
                      "-pgran_output", tmp_path / "x.h5", f"-pgran_{name}", value, check=False),
            message)
