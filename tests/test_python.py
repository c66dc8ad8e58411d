"""From Python: a run gives its result, a sweep its table, and neither does its work twice."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from conftest import run_ranks

import pgran
from pgran.options import Interrupted, OptionError, ParameterError, SolutionError
from pgran.output.reading import ResultError
from pgran.signals import SIGNALS
from pgran.studies import sweep

SMALL = {"width": 8, "height": 24, "compression": 0.001}


def test_a_run_gives_a_result_and_is_not_made_twice(tmp_path):
    result = pgran.run(tmp_path / "a.h5", inertial_number=0.003, snapshots=[0.0005, 0.001], **SMALL)
    assert result.complete and result.options["inertial_number"] == 0.003
    assert [round(s.attributes["compression"], 6) for s in result.snapshots] == [0.0005, 0.001]
    assert result.history["compression"][-1] == pytest.approx(0.001)
    begun = (tmp_path / "a.h5").stat().st_mtime_ns
    again = pgran.run(tmp_path / "a.h5", inertial_number=0.003, snapshots=[0.0005, 0.001], **SMALL)
    assert (tmp_path / "a.h5").stat().st_mtime_ns == begun
    assert np.array_equal(again.snapshots[-1]["pressure"], result.snapshots[-1]["pressure"])
    on_ranks = pgran.run(tmp_path / "b.h5", inertial_number=0.003, snapshots=[0.0005, 0.001],
                         ranks=2, **SMALL)
    assert on_ranks.attributes["ranks"] == 2
    assert on_ranks.snapshots[-1]["pressure"] == pytest.approx(result.snapshots[-1]["pressure"],
                                                               rel=1e-5)


def test_a_run_in_this_process_is_that_of_its_own_and_leaves_it_as_it_was(tmp_path):
    from petsc4py import PETSc

    options = PETSc.Options()
    options.setValue("mine", "of the caller")
    names = list(options.getAll())
    handlers = [signal.getsignal(number) for number in SIGNALS]
    paths = [tmp_path / f"{name}.h5" for name in ("here", "own", "again")]
    results = [pgran.run(path, ranks=ranks, **SMALL) for path, ranks in zip(paths, (None, 0, None))]
    for other in results[1:]:
        for name, values in other.history.items():
            assert np.array_equal(values, results[0].history[name])
        assert np.array_equal(other.snapshots[-1]["fluidity"], results[0].snapshots[-1]["fluidity"])
    assert list(options.getAll()) == names and options.getString("mine") == "of the caller"
    assert handlers == [signal.getsignal(number) for number in SIGNALS]
    options.delValue("mine")


def test_a_script_on_ranks_runs_on_all_of_them(tmp_path):
    script = (f"import os, pgran; result = pgran.run({str(tmp_path / 'both.h5')!r}, **{SMALL}); "
              "os.write(1, b' %d ' % result.attributes['ranks'])")
    assert run_ranks(2, "-c", script, limit=60).stdout.split() == ["2", "2"]
    assert run_ranks(2, "-c", script, limit=60).stdout.split() == ["2", "2"]  # it is in place


def test_a_signal_stops_a_run_in_this_process_which_the_same_call_goes_on_with(tmp_path):
    path, more = tmp_path / "run.h5", {**SMALL, "element_size": 1, "step_max": 2e-4}

    def ask():
        while not (path.exists() and len(pgran.open(path).history["time"]) > 3):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    with pytest.raises(Interrupted, match="SIGINT"):
        pgran.run(path, **more)
    thread.join()
    assert not pgran.open(path).complete
    whole = pgran.run(tmp_path / "whole.h5", **more)
    assert pgran.run(path, **more).snapshots[-1]["pressure"] == pytest.approx(
        whole.snapshots[-1]["pressure"], rel=1e-6)


def test_a_result_refuses_the_data_of_a_later_run_in_its_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = pgran.run(inertial_number=0.001, **SMALL)
    second = pgran.run(inertial_number=0.01, **SMALL)
    assert first.path == second.path == tmp_path / "results" / "biaxial.h5"
    with pytest.raises(ResultError, match="another run has replaced the run"):
        first.snapshots[-1]["pressure"]
    with pytest.raises(ResultError, match="another run has replaced the run"):
        tuple(first.snapshots[-1].names)
    assert second.snapshots[-1]["inertial_number"].mean() > 0.005
    assert pgran.open(tmp_path / "results" / "biaxial.1.h5").snapshots[-1][
        "inertial_number"].mean() < 0.002


def test_results_and_sweeps_do_not_depend_on_the_current_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    result = pgran.run("a.h5", **SMALL)
    found = pgran.sweep({"inertial_number": [0.001]}, directory="b", **SMALL)
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert result.path == tmp_path / "a.h5" and result.snapshots[-1]["pressure"].mean() > 0.0
    assert [row["complete"] for row in found.rows()] == [True]
    pgran.run(found.paths[0], inertial_number=0.01, **SMALL)
    with pytest.raises(ResultError, match="another run"):
        found.rows()


def test_bad_options_are_told_before_anything_runs(tmp_path):
    with pytest.raises(ParameterError, match="inertial_number"):
        pgran.run(tmp_path / "x.h5", inertial_number=-1)
    with pytest.raises((OptionError, ParameterError)):
        pgran.run(tmp_path / "x.h5", nosuch=1)
    with pytest.raises(ParameterError):
        pgran.sweep({"inertial_number": [0.001, -1]}, directory=tmp_path, **SMALL)
    with pytest.raises(SolutionError, match="exit code 1"):
        pgran.run(tmp_path / "y.h5", petsc={"snes_max_it": 1}, step_min=5e-5, ranks=0, **SMALL)
    with pytest.raises(SolutionError, match="step"):
        pgran.run(tmp_path / "z.h5", petsc={"snes_max_it": 1}, step_min=5e-5, **SMALL)
    with pytest.raises(OptionError, match="did you mean -snes_atol"):
        pgran.run(tmp_path / "x.h5", petsc={"snes_atl": 1e-6}, **SMALL)
    assert not (tmp_path / "x.h5").exists() and not list(tmp_path.glob("inertial*"))


def test_a_sweep_resumes_and_gives_a_table(tmp_path, monkeypatch):
    grid = {"inertial_number": [0.001, 0.01], "law": ["bingham", "jop"]}
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "3")  # one task of a job array
    some = pgran.sweep(grid, directory=tmp_path, **SMALL)
    assert [row["complete"] for row in some.rows()] == [False, False, False, True]
    monkeypatch.delenv("SLURM_ARRAY_TASK_ID")
    before = some.paths[3].stat().st_mtime_ns
    full = pgran.sweep(grid, directory=tmp_path, workers=2, **SMALL)
    assert full.paths[3].stat().st_mtime_ns == before and not full.failures
    rows = full.rows()
    assert all(row["complete"] and row["steps"] > 3 for row in rows)
    assert [row["law"] for row in rows] == ["bingham", "jop"] * 2
    assert full[1].parameters.law == "jop" and full[2].options["inertial_number"] == 0.01
    assert str(full).count("\n") == 5
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "4")
    with pytest.raises(OptionError, match="task 4: allowed is 0 to 3"):
        pgran.sweep(grid, directory=tmp_path, **SMALL)


def test_what_fails_in_a_sweep_is_told_and_the_rest_is_made(tmp_path):
    found = pgran.sweep({"step_min": [1e-8, 6e-5]}, directory=tmp_path, petsc={"snes_max_it": 3},
                        **SMALL)
    assert list(found.failures) == [1] or list(found.failures) == [0, 1]
    assert "exit code 1" in found.failures[1]


def test_shipped_options_are_found():
    assert sweep.shipped("biaxial").name == "biaxial.opts" and sweep.shipped("nosuch") is None
