"""Failures are reported with reason and location and stop all ranks."""

from types import SimpleNamespace

import pytest
from conftest import discretised, pgran, refused

from pgran.options import SolutionError
from pgran.output import checkpoint
from pgran.output.result import Result
from pgran.solve.driver import Driver

COARSE = "-pgran_element_size 8 -pgran_progress quiet"


@pytest.mark.parametrize("options_file, more, messages", [
    ("direct.opts", "-snes_max_it 1 -pgran_step_min 1e-5", (
        "no step down to -pgran_step_min 1e-05 converges at 0.02963 % compression",
        "Newton's method did not converge in 1 iterations (DIVERGED_MAX_IT)",
        "the largest residual is 5.44e-05, in fluidity at x = (20.01, 59.98) d",
        "What may help: a larger -snes_max_it or a smaller -pgran_step_max")),
    ("biaxial.opts", "-ksp_max_it 2", (
        "the linear solver failed (DIVERGED_LINEAR_SOLVE)", "it did not converge in 2 iterations",
        "What may help: a larger -ksp_max_it, or -options_file options/direct.opts")),
    ("direct.opts", "-mat_mumps_icntl_23 1", (
        "MUMPS may not use the memory that it needs (INFOG(1) = -19",
        "What may help: a larger -mat_mumps_icntl_23")),
    ("direct.opts", "-pgran_body_force 0,0.05", (
        "the residual is NaN", "pressure is negative, -0.685 |sigma_1|, at x = (",
        "What may help: loads that leave the pressure positive")),
    ("direct.opts", "-pgran_law jop -pgran_inertial_number 0.1 -pgran_mu_2 0.45 -pgran_step_max 1 "
     "-pgran_step_first 0.01 -pgran_step_min 1e-3", (
         "the residual is NaN", "mu reaches 2.513 at x = (",
         "112.8) d, and the law bears less than 0.45", "What may help: a start and loads that need "
         "mu < 0.45 everywhere, a smaller -pgran_step_max")),
    ("direct.opts", "-pgran_step_error 1e-9 -pgran_step_min 1e-4 -pgran_step_first 1e-3", (
        "no step down to -pgran_step_min 0.0001 converges", "error estimate",
        "exceeds -pgran_step_error", "What may help: a larger -pgran_step_error")),
    # After a failure of MUMPS PETSc skips factorisations: the first one has to be repeated.
    pytest.param(
        "inclined_plane.opts", "-pgran_model li -pgran_height 10 -pgran_slope 24 -pgran_grading 3.2"
        f" -pgran_element_size {2**-7} -pgran_width {2**-6} -pgran_step_min 4e-4", (
            "no step down to", "MUMPS found the matrix singular (INFOG(1) = -10"),
        marks=pytest.mark.nightly)],
    ids=["Newton", "Krylov", "MUMPS", "negative pressure", "NaN", "error estimate", "singular"])
def test_a_failed_run_reports_reason_and_location_and_keeps_accepted_steps(
        path, options_file, more, messages):
    done = pgran(0, options_file, path, COARSE, more, check=False)
    refused(done, *messages)
    if "Newton's method" not in done.stderr:  # the first step fails
        assert not list(path.parent.iterdir())
        return
    assert checkpoint.checkpoints_of(path)
    result = Result(path)
    assert len(result.history["time"]) and result.attributes["state"] == "failed"
    assert not result.complete


@pytest.mark.parametrize("options_file, message", [
    ("direct.opts", "fails, and PETSc's options repeat it without making it smaller at "),
    ("steady.opts", "What may help")])
def test_a_failed_step_is_never_repeated_with_the_same_size(path, options_file, message):
    words = "-ts_adapt_scale_solve_failed 1 -snes_max_it 1"
    done = pgran(0, options_file, path, COARSE, words, check=False, patch="""
from pgran.solve import driver
driver.check_options = lambda *_: None
""")
    refused(done, message)


def test_a_run_stops_when_a_free_face_reaches_a_plate(path):
    done = pgran(0, "direct.opts", path, element_size=20, progress="quiet", compression=0.6,
                 step_max=0.05, step_error=1, check=False)
    refused(done, "the mesh becomes invalid at ", "a free face reaches a plate at x = (",
            "What may help: an earlier end, or a smaller -pgran_step_max")
    result = Result(path)
    assert result.history["compression"][-1] > 0.3
    assert result.snapshots[0].x[1:-1, :, 1].min() > 0.0


def test_an_inverted_mesh_is_not_accepted():
    form = discretised(element_size=20)
    x = form.case.coordinates(*form.grid.nodes.index)
    driver = SimpleNamespace(grid=form.grid, case=form.case, comm=form.grid.comm.tompi4py())
    with pytest.raises(SolutionError, match="an element is inverted at x = "):
        Driver._check_mesh(driver, SimpleNamespace(time=0.0, x=x[::-1]))


def test_an_error_of_all_ranks_is_reported_once(path):
    done = pgran(2, "direct.opts", path, COARSE, check=False, patch="""
from pgran.cases.biaxial import Biaxial
Biaxial.tractions = lambda self, time: {"left": 1 / 0}
""")
    assert done.returncode == 1
    assert done.stderr.count("ZeroDivisionError: division by zero") == 1, done.stderr


FAIL = """
import signal
from mpi4py import MPI
from pgran.options import SolutionError
from pgran.space import weakform
original, calls = weakform.WeakForm.{method}, []
def fail(self, *arguments):
    calls.append(1)
    if MPI.COMM_WORLD.rank == {rank} and len(calls) == 3:
        {fault}
    return original(self, *arguments)
weakform.WeakForm.{method} = fail
"""


@pytest.mark.parametrize("method, rank, fault, message", [
    ("jacobian", 0, "raise MemoryError('of rank 0')", "not enough memory"),
    ("residual", 1, "raise SolutionError('of rank 1')", "of rank 1"),
    ("residual", 1, "os.kill(os.getpid(), signal.SIGKILL)", "signal 9 (Killed)")])
def test_when_one_rank_fails_all_stop(path, method, rank, fault, message):
    done = pgran(2, "direct.opts", path, COARSE, check=False,
                 patch=FAIL.format(method=method, rank=rank, fault=fault))
    assert done.returncode and message in done.stderr + done.stdout, done.stderr
