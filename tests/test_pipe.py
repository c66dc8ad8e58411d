"""Flow through a vertical pipe, compared with one-dimensional solutions."""

import numpy as np
import pytest
from conftest import ROOT, pgran, refused, run_ranks
from scipy.integrate import solve_bvp

import pgran as package


def profile(options):
    """Fluidity and speed over r: A^2 (g'' + g'/r) = F at mu = gravity r/2, v' = -mu g."""
    A, mu_s, b, R, gravity = (options[name] for name in ("A", "mu_s", "b", "radius", "gravity"))
    kink = 2.0 * mu_s / gravity

    def slopes(r, y):
        mu, g = 0.5 * gravity * r, y[0]
        above = mu - mu_s
        if options["model"] == "ngf":
            F = np.abs(above) * (g - np.maximum(above, 0.0) / (b * np.maximum(mu, 1e-12)))
        else:
            F = -above * g + b * mu * g**2
        return np.array([y[1], F / A**2, -mu * g])

    mesh = np.unique(np.concatenate([np.linspace(0.0, R, 400), [kink]]))
    found = solve_bvp(slopes, lambda a, b: np.array([a[1], b[1], b[2]]), mesh,
                      np.array([0.5 + 0.0 * mesh, 0.0 * mesh, R - mesh]),
                      S=np.diag([0.0, -1.0, 0.0]), tol=1e-9, max_nodes=50000)
    assert found.success
    return found.sol


@pytest.mark.parametrize("model", ["ngf", "ngf_primitive"])
def test_the_pipe_converges_to_the_one_dimensional_profile(tmp_path, model):
    """Mu = mu_s lies between two elements."""
    path, errors = tmp_path / "pipe.h5", []
    for size in (0.5, 0.25, 0.125):
        pgran(0, "pipe.opts", path, model=model, radius=8, gravity=0.3819 / 2, height=2 * size,
              element_size=size, shear_modulus=1e6)
        result = package.open(path)
        snapshot, exact = result.snapshots[-1], profile(result.options)
        r = snapshot.x[0, :, 0]
        g, _, v = exact(r)
        errors.append([np.abs(snapshot["fluidity"][0] - g).max() / g.max(),
                       np.abs(snapshot["velocity_2"][0] + v).max() / v.max()])
    assert result.history["newton_iterations"].sum() <= 40
    assert (np.log2(np.array(errors[0]) / errors[-1]) / 2.0 > 3.0).all(), errors
    assert max(errors[-1]) < 1e-6, errors
    assert result.history["shear_stress"][-1] == pytest.approx(0.3819 * 2.0, rel=1e-6)
    speed = 2.0 * np.trapezoid(v * r, r) if hasattr(np, "trapezoid") else 2.0 * np.trapz(v * r, r)
    assert result.history["mean_speed"][-1] == pytest.approx(speed / 64.0, rel=1e-3)


@pytest.mark.parametrize("given, message", [
    (("gravity", 0.02), "the material is static"), (("radius", 3.3), "integer multiple")])
def test_a_pipe_without_flow_or_with_a_bad_mesh_is_reported(tmp_path, given, message):
    name, value = given
    done = run_ranks(0, "-m", "pgran", "-options_file", ROOT / "options" / "pipe.opts",
                     "-pgran_output", tmp_path / "x.h5", f"-pgran_{name}", value, check=False)
    if name == "gravity":
        assert done.returncode == 0 and message in done.stdout + done.stderr
    else:
        refused(done, message)
