"""The solver avoids the root mu = mu_s of F = (A^2 d^2/xi^2) (g - g_loc)."""

import numpy as np
import pytest
from conftest import ROOT, at_rest, discretised, noise, pgran as run_pgran
from test_weakform import assert_jacobian_is_derivative

import pgran
from pgran.runs import run_in_process, run_on_ranks
from pgran.solve.driver import Driver
from pgran.solve.state import State, reference


def deviations(result):
    """Return the largest |mu - mu_loc(I0)| and |I/I0 - 1| of each snapshot."""
    I0, mu = result.options["inertial_number"], result.case.stress_ratio
    return [(np.abs(snapshot["stress_ratio"] - mu).max(),
             np.abs(snapshot["inertial_number"] / I0 - 1.0).max())
            for snapshot in result.snapshots]


@pytest.mark.parametrize("law, I0, more", [
    ("bingham", 1e-4, {"imperfection": 1 - 1e-8}), ("jop", 1e-3, {"step_first": 1e-3}),
    ("bingham", 1e-3, {"snapshots": [0.01, 0.02, 0.03, 0.05]}), ("jop", 0.1, {"step_error": 1.0})])
def test_a_uniform_cell_reaches_the_local_stress_ratio_with_any_step_control(
        tmp_path, law, I0, more):
    result = pgran.run(tmp_path / "cell.h5", case="periodic", cell_elements=2, end_time=0.05,
                       law=law, inertial_number=I0, **{"imperfection": 1, **more})
    found = deviations(result)
    assert found and all(mu < 1e-6 and I < 1e-3 for mu, I in found)


def test_a_specimen_without_imperfection_keeps_the_local_stress_ratio(tmp_path):
    """Newton's method must not cycle around the double root, also with multigrid."""
    path = tmp_path / "a.h5"
    run_pgran(0, "biaxial.opts", path, "-pgran_element_size", 5, "-pgran_imperfection", 1,
              "-pgran_compression", 0.03, "-pgran_snapshots", "0.001,0.002,0.003,0.03")
    result = pgran.open(path)
    found, history, mu = deviations(result), result.history, result.case.stress_ratio
    assert len(found) == 4 and all(mu < 1e-6 and I < 1e-3 for mu, I in found)
    start = np.argmax(history["compression"] > 0.0029)
    assert history["top_stress"][start] == pytest.approx(-(1 + mu) / (1 - mu), abs=1e-5)
    assert len(history["time"]) < 60  # steps must not become tiny


def uniform(form, mu):
    """Return mesh and unknowns of the reference flow with the fluidity of a stress ratio."""
    grid, x = form.grid, form.case.coordinates(*form.grid.nodes.index)
    velocity, fluidity, _ = form.case.reference(x)
    pressure = np.full(grid.corners.size, form.material.pressure)
    return x, grid.join(velocity, fluidity * form.material.stress_ratio / mu, pressure)


def test_the_spurious_root_is_detected_and_removed_by_a_limited_length():
    form = discretised(element_size=20, imperfection=1)
    mu_s, mu = form.material.law.mu_s, form.material.stress_ratio
    for ratio, expected in ((mu, 0.0), (mu_s, mu - mu_s), (0.9 * mu_s, 0.0)):
        x, local = uniform(form, ratio)
        step = at_rest(form, x, 0.0)
        step.prescribed[:] = np.nan
        assert form.spurious_root(local, step) == pytest.approx(expected, rel=1e-2, abs=1e-12)
    x, local = uniform(form, mu_s)
    sizes = []
    for decay in (0.0, mu - mu_s):
        step = at_rest(form, x, 0.0)
        step.decay = decay
        rows = form.residual(local, np.zeros_like(local), step)
        sizes.append(np.abs(form.fluidity_defect(rows, step)).max())
    fluidity = form.grid.split(local)[1].max()
    assert sizes == pytest.approx([0.0, (mu - mu_s) * fluidity], abs=1e-9)


def test_the_length_is_limited_close_to_a_free_surface_too():
    """The source has a different quadrature rule there."""
    form = discretised(case="inclined_plane", width=1, height=4, element_size=1)
    grid, rate, decay = form.grid, 0.3, 0.2
    x = form.case.coordinates(*grid.nodes.index)
    local = grid.join(np.array([rate * x[1], 0.0 * x[1]]),
                      np.full(grid.nodes.size, rate / form.material.law.mu_s),
                      np.ones(grid.corners.size))
    step = at_rest(form, x, 0.0)
    step.prescribed[:] = np.nan
    form.held[:] = False
    step.decay = decay
    defect = form.fluidity_defect(form.residual(local, np.zeros_like(local), step), step)
    assert defect == pytest.approx(decay * rate / form.material.law.mu_s, rel=1e-6)


def test_the_jacobian_with_a_limited_length_is_the_derivative_of_the_residual():
    form = discretised(width=4, height=6, element_size=1, inertial_number=0.1)
    x, local = uniform(form, 0.4)
    local = local + 0.05 * noise(form.grid, 1)
    step = at_rest(form, x, 0.2, 0.1)
    step.decay = 0.3
    assert_jacobian_is_derivative(form, local, step)


def test_pseudo_time_leaves_the_root_at_the_yield_value():
    """The initial state is the spurious steady flow, whose residual vanishes."""
    with run_in_process.database(run_on_ranks.combined_options(
            ROOT / "options" / "steady.opts", "-pgran_case", "periodic", "-pgran_cell_elements", 2,
            "-pgran_imperfection", 1)):
        form = discretised(case="periodic", cell_elements=2, imperfection=1)
        law = form.material.law
        start = reference(form)
        _, local = uniform(form, law.mu_s)
        stress = start.stress * law.mu_s / form.material.stress_ratio
        driver = Driver(form, State(0.0, start.x, local, stress), lambda *_: None, steady=True)
        driver.solve()
        mu = form.collect(driver.state.local, driver._accepted[2],
                          lambda p: p.response.stress_ratio)
        assert np.abs(mu - form.material.stress_ratio).max() < 1e-6
