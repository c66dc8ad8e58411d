"""Failures are reported with reason and location and stop all ranks."""

import h5py
import pytest
from conftest import ROOT, pgran, refused, run_ranks

from pgran.output import checkpoint

COARSE = "-pgran_element_size", 8, "-pgran_progress", "quiet"


@pytest.mark.parametrize("options_file, more, messages", [
    ("direct.opts", ("-snes_max_it", 1, "-pgran_step_min", 1e-5), (
        "no step down to -pgran_step_min 1e-05 converges at 0.02963 % compression",
        "Newton's method did not converge in 1 iterations (DIVERGED_MAX_IT)",
        "the largest residual is 5.44e-05, in fluidity at x = (20.01, 59.98) d",
        "What may help: a larger -snes_max_it or a smaller -pgran_step_max")),
    ("biaxial.opts", ("-ksp_max_it", 2), (
        "the linear solver failed (DIVERGED_LINEAR_SOLVE)", "it did not converge in 2 iterations",
        "What may help: a larger -ksp_max_it, or -options_file options/direct.opts")),
    ("direct.opts", ("-mat_mumps_icntl_23", 1), (
        "MUMPS may not use the memory that it needs (INFOG(1) = -19",
        "What may help: a larger -mat_mumps_icntl_23")),
    ("direct.opts", ("-pgran_body_force", "0,0.05"), (
        "the residual is NaN", "pressure is negative, -0.685 |sigma_1|, at x = (",
        "What may help: loads that leave the pressure positive")),
    ("direct.opts", ("-pgran_law", "jop", "-pgran_inertial_number", 0.1, "-pgran_mu_2", 0.45,
                     "-pgran_step_first", 0.01, "-pgran_step_max", 1, "-pgran_step_min", 1e-3), (
        "the residual is NaN", "mu reaches 2.513 at x = (",
        "112.8) d, and the law bears less than 0.45", "What may help: a start and loads that need "
        "mu < 0.45 everywhere, a smaller -pgran_step_max")),
    ("direct.opts", ("-pgran_step_error", 1e-9, "-pgran_step_min", 1e-4, "-pgran_step_first", 1e-3,
                     "-pgran_compression", 0.01), (
        "no step down to -pgran_step_min 0.0001 converges", "error estimate",
        "exceeds -pgran_step_error",
        "What may help: a larger -pgran_step_error")),
    # After a failure of MUMPS PETSc skips factorisations: the first one has to be repeated.
    pytest.param("inclined_plane.opts", (
        "-pgran_model", "li", "-pgran_height", 10, "-pgran_slope", 24, "-pgran_grading", 3.2,
        "-pgran_element_size", 2**-7, "-pgran_width", 2**-6, "-pgran_step_min", 4e-4), (
        "no step down to", "MUMPS found the matrix singular (INFOG(1) = -10"),
        marks=pytest.mark.nightly)],
    ids=["Newton", "Krylov", "MUMPS", "negative pressure", "NaN", "error estimate", "singular"])
def test_a_failed_run_reports_reason_and_location_and_keeps_accepted_steps(
        tmp_path, request, options_file, more, messages):
    path = tmp_path / "run.h5"
    done = pgran(0, options_file, path, *COARSE, *more, check=False, limit=60)
    refused(done, *messages)
    if request.node.callspec.id != "Newton":  # it fails in its first step
        assert not list(tmp_path.iterdir())
        return
    assert checkpoint.checkpoints_of(path)
    with h5py.File(path) as file:
        assert len(file["history/time"]) and file.attrs["state"] == "failed"
        assert not file.attrs.get("complete", False)


def test_a_failed_step_is_never_repeated_with_the_same_size(tmp_path):
    code = """
import sys, petsc4py
petsc4py.init()
from pgran.__main__ import main
from pgran.solve import driver
driver.check_options = lambda *_: None
sys.exit(main(sys.argv))
"""
    words = "fails, and PETSc's options repeat it without making it smaller at "
    for options_file, message in (("direct.opts", words), ("steady.opts", "What may help")):
        done = run_ranks(0, "-c", code, "-options_file", ROOT / "options" / options_file, *COARSE,
                         "-ts_adapt_scale_solve_failed", 1, "-snes_max_it", 1, "-pgran_output",
                         tmp_path / "run.h5", check=False, limit=60)
        refused(done, message)


def test_a_run_stops_when_a_free_face_reaches_a_plate(tmp_path):
    path = tmp_path / "run.h5"
    done = pgran(0, "direct.opts", path, "-pgran_element_size", 20, "-pgran_progress", "quiet",
                 "-pgran_compression", 0.6, "-pgran_step_max", 0.05, "-pgran_step_error", 1,
                 check=False)
    refused(done, "the mesh becomes invalid at ", "a free face reaches a plate at x = (",
            "What may help: an earlier end, or a smaller -pgran_step_max")
    with h5py.File(path) as file:
        assert file["history/compression"][-1] > 0.3
        assert file["snapshots/0000/coordinates"][1:-1, :, 1].min() > 0.0


CASE = """
import numpy as np
from pgran.cases.biaxial import Biaxial


class Folding(Biaxial):
    options = Biaxial.options

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        values[0, (j == 0) & (i == 2)] = 40.0
        return values
"""


def test_an_inverted_mesh_is_not_accepted(tmp_path):
    (tmp_path / "folding.py").write_text(CASE)
    path = tmp_path / "run.h5"
    done = pgran(2, "direct.opts", path, "-pgran_case", f"{tmp_path / 'folding.py'}:Folding",
                 "-pgran_element_size", 20, "-pgran_step_max", 0.5, "-pgran_step_error", 1e9,
                 "-pgran_step_first", 0.01, "-pgran_step_min", 1e-3, check=False)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "element is inverted" in done.stderr or "NaN" in done.stderr, done.stderr


FAIL = """
import os, signal, sys
from mpi4py import MPI
from pgran.space import weakform
from pgran.__main__ import main
original, calls = weakform.WeakForm.{method}, []
def fail(self, *arguments):
    calls.append(1)
    if MPI.COMM_WORLD.rank == {rank} and len(calls) == 3:
        {fault}
    return original(self, *arguments)
weakform.WeakForm.{method} = fail
sys.exit(main(sys.argv))
"""


@pytest.mark.parametrize("method, rank, fault, message", [
    ("jacobian", 0, "raise MemoryError('of rank 0')", "not enough memory"),
    ("residual", 1, "from pgran.options import SolutionError; raise SolutionError('of rank 1')",
     "of rank 1"),
    ("residual", 1, "os.kill(os.getpid(), signal.SIGKILL)", "signal 9 (Killed)")],
    ids=["memory", "a reported error", "kill"])
def test_when_one_rank_fails_all_stop(tmp_path, method, rank, fault, message):
    done = run_ranks(2, "-c", FAIL.format(method=method, rank=rank, fault=fault), "-options_file",
                     ROOT / "options" / "direct.opts", *COARSE, "-pgran_output",
                     tmp_path / "run.h5", check=False, limit=60)
    assert done.returncode != 0
    assert message in done.stderr + done.stdout, done.stderr


def test_an_error_of_all_ranks_is_reported_once(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from pgran.cases.biaxial import Biaxial\nclass Mine(Biaxial):\n"
        "    options = Biaxial.options\n"
        "    def tractions(self, time):\n        return {'left': 1 / 0}\n")
    done = run_ranks(2, "-m", "pgran", "-pgran_case", f"{tmp_path / 'mine.py'}:Mine", *COARSE,
                     "-pgran_output", tmp_path / "run.h5", check=False, limit=60)
    assert done.returncode == 1
    assert done.stderr.count("ZeroDivisionError: division by zero") == 1, done.stderr
    assert "mine.py" in done.stderr


MESSAGES = (
    "no step down to", "did not converge in", "residual is NaN", "pressure is negative",
    "mu reaches", "MUMPS may not use the memory", "exceeds -pgran_step_error",
    "a free face reaches a plate", "an element is inverted", "another run writes it",
    "No space left on device", "it was removed while the run wrote it",
    "it has no checkpoint to resume from", "skipped a damaged checkpoint",
    "a restarted run cannot change", "unknown option", "unused PETSc option",
    "no -pc_type is given", "failed and others did not", "not enough memory", "GB per rank",
    "the first step, a tenth of the time of elastic loading", "stopped by SIGTERM",
    "not a pgran result file", "no eigenvalue converged", "ranks are too many",
    "two times to reach lie closer", "is NaN or infinite at", "nothing to resume from",
    "standard output cannot be written", "repeat it without making it smaller",
    "no steady flow within", "cannot be imported")


def test_the_troubleshooting_page_contains_each_message():
    page = (ROOT / "docs" / "howto" / "troubleshooting.md").read_text()
    assert not [words for words in MESSAGES if words not in page]
