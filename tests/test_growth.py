"""Growth rates of the linearised step: convergence, theory and nonlinear runs."""

import functools
import json

import h5py
import numpy as np
import pytest
from conftest import ROOT, discretised, parameters, refused, run_ranks

from pgran import cases
from pgran.options import SolutionError
from pgran.runs import run_on_ranks
from pgran.solve.linearised import LinearisedStep, extrapolated
from pgran.theory.specimen import growth_rate
from studies import specimen

SMALL, STEPS = ("-pgran_element_size", 4), (5e-4, 2.5e-4, 1.25e-4)


@functools.cache
def rates(*arguments, largest=1e-4, **options):
    """Return {dt: growth rates, (real, imaginary)} of ``pgran.growth``; cached."""
    given = [text for name, value in options.items() for text in (f"-pgran_{name}", value)]
    done = run_ranks(0, "-m", "pgran.growth", "-options_file", ROOT / "options" / "growth.opts",
                     *SMALL, "-json", *given, *arguments)
    rows = json.loads(done.stdout)
    for row in rows:
        assert len(row["residuals"]) == len(row["growth_rates"]) > 0
        assert all(0.0 < residual < largest for residual in row["residuals"])  # 8e-5 at H = 240 d
    return {row["dt"]: row["growth_rates"] for row in rows}


def undisturbed():
    """Return the rates of the specimen of the options file at three steps."""
    return rates("-dt", ",".join(map(str, STEPS)), largest=1e-5)


def test_growth_rates_converge_with_the_step():
    found = undisturbed()
    a, b, c = (found[dt][0][0] for dt in STEPS)
    assert a == pytest.approx(c, rel=0.03)
    assert abs(c - b) < 0.6 * abs(b - a)


def test_nothing_grows_without_faces_and_geometry():
    found = rates("-dt", "5e-4", "-without", "faces,geometry")[5e-4]
    assert found and all(real < 1.0 for real, _ in found)


def test_a_nonlinear_run_grows_at_the_rate_of_the_linearised_step(tmp_path, monkeypatch):
    monkeypatch.setattr(run_on_ranks, "RANKS", 0)
    found, time = specimen.measured(tmp_path / "run.h5", *SMALL, end=0.016)
    expected = undisturbed()[2.5e-4][0][0]
    assert found == pytest.approx(expected, rel=0.1)
    assert found == pytest.approx(expected * specimen.later((), time), rel=0.03)


def test_an_unknown_part_of_the_coupling_is_refused():
    refused(run_ranks(0, "-m", "pgran.growth", *SMALL, "-without", "mesh", check=False, limit=60),
            "-without mesh: expected one or more of: faces, geometry")


def test_an_undisturbed_step_that_does_not_converge_is_an_error(monkeypatch):
    monkeypatch.setattr("pgran.solve.linearised.MAX_ITERATIONS", 1)
    with pytest.raises(SolutionError, match="undisturbed step of 0.001"):
        LinearisedStep(discretised(element_size=8, imperfection=1), 1e-3)


def test_ranks_leave_the_newton_loop_together():
    """In the second iteration the change of rank 0 is zero, and the change of rank 1 is not."""
    code = """
import numpy as np, petsc4py
petsc4py.init()
from petsc4py import PETSc
from pgran import cases
from pgran.space.weakform import discretise
from pgran.solve.linearised import LinearisedStep
solve, calls = LinearisedStep._newton, []
def uneven(self, *arguments):
    calls.append(1)
    change = solve(self, *arguments)
    return 0.0 * change if len(calls) == 2 and PETSc.COMM_WORLD.rank == 0 else change
LinearisedStep._newton = uneven
given = {"pgran_element_size": "8", "pgran_imperfection": "1"}
LinearisedStep(discretise(cases.read(given), PETSc.COMM_WORLD), 1e-3)
counts = PETSc.COMM_WORLD.tompi4py().gather(len(calls))
if counts:
    print(*counts)
"""
    counts = run_ranks(2, "-c", code, limit=60).stdout.split()
    assert counts == ["3", "3"]


@pytest.mark.parametrize("options, size, tolerance", [
    ({"height": 60}, 2, 2e-3), ({"inertial_number": 0.03}, 2, 2e-3),
    ({"inertia": "true"}, 4, 1e-2), ({"law": "jop"}, 4, 1e-2)], ids=str)
def test_the_linearised_step_converges_to_the_analytical_solution(options, size, tolerance):
    found = rates("-dt", ",".join(map(str, STEPS)), "-eps_nev", 1, "-eps_ncv", 16,
                  element_size=size, shear_modulus=1e6, **options)
    exact = growth_rate(**cases.create(parameters(**options)).specimen)
    fastest = extrapolated(STEPS, [found[dt][0][0] for dt in STEPS])
    assert fastest == pytest.approx(exact, rel=tolerance)


def test_modes_are_sine_waves_along_the_specimen_and_need_plates_with_slip():
    tall, held = (rates("-dt", "5e-4", **options)[5e-4]
                  for options in ({"height": 240}, {"plates_slip": "false"}))
    assert tall[1][0] == pytest.approx(undisturbed()[5e-4][0][0], rel=1e-4)
    assert held[0][0] < 0.1 * undisturbed()[5e-4][0][0]


def test_the_fastest_mode_is_written(tmp_path):
    path = tmp_path / "mode.h5"
    done = run_ranks(2, "-m", "pgran.growth", *SMALL, "-dt", "5e-4", "-mode", path, "-json")
    rate, = json.loads(done.stdout)[0]["growth_rates"][0][:1]
    assert rate == pytest.approx(undisturbed()[5e-4][0][0], rel=1e-5)  # on one rank
    with h5py.File(path) as file:
        group = file["snapshots/0000"]
        lean, x = group["displacement"][..., 0], group["coordinates"][...]
        assert file.attrs["growth_rate"] == rate and group["displacement"].attrs["unit"] == "d"
    assert path.with_suffix(".png").exists() and np.abs(lean).max() == pytest.approx(1.0)
    # Half a cosine up the specimen.
    middle = lean[:, 10] - lean[:, 10].mean()
    wave = np.cos(np.pi * np.linspace(0.0, 1.0, len(x)))
    assert abs(np.corrcoef(middle, wave)[0, 1]) > 0.99
