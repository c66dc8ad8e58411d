"""Runs and sweeps from Python: results, reuse of completed runs, errors, signals and threads."""

import copy
import gc
import os
import pickle
import shutil
import signal
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np
import pytest
from conftest import run_ranks

import pgran
from pgran.options import Interrupted, OptionError, ParameterError, SolutionError, shipped
from pgran.output.reader import ResultError
from pgran.signals import SIGNALS

SMALL = {"width": 8, "height": 24, "compression": 0.001}
#: No step converges.
FAILING = {"petsc": {"snes_max_it": 1}, "step_min": 5e-5}


def test_runs_in_this_process_separate_and_on_ranks_agree_and_are_reused(tmp_path):
    from petsc4py import PETSc

    options = PETSc.Options()
    options.setValue("mine", "of the caller")
    state = [options.getAll(), *map(signal.getsignal, SIGNALS)]
    given = {"inertial_number": 0.003, "snapshots": [0.0005, 0.001], **SMALL}
    first, again, separate, on_ranks = (pgran.run(tmp_path / f"{ranks}{n}.h5", ranks=ranks, **given)
                                        for n, ranks in enumerate((None, None, 0, 2)))
    assert first.complete and first.options["inertial_number"] == 0.003
    assert [round(s.attributes["compression"], 6) for s in first.snapshots] == [0.0005, 0.001]
    for other in (again, separate):
        for name, values in other.history.items():
            assert np.array_equal(values, first.history[name])
        assert np.array_equal(other.snapshots[-1]["fluidity"], first.snapshots[-1]["fluidity"])
    assert on_ranks.attributes["ranks"] == 2
    assert on_ranks.snapshots[-1]["pressure"] == pytest.approx(first.snapshots[-1]["pressure"],
                                                               rel=1e-5)
    assert state == [options.getAll(), *map(signal.getsignal, SIGNALS)]
    options.delValue("mine")
    written = first.path.stat().st_mtime_ns
    assert pgran.run(first.path, **given).complete and first.path.stat().st_mtime_ns == written


def test_a_script_on_ranks_runs_on_all_ranks_and_only_in_the_main_thread(path):
    script = f"""
import os, threading, pgran
result = pgran.run({str(path)!r}, **{SMALL})
os.write(1, b" %d " % result.attributes["ranks"])
def run():
    try: pgran.run({str(path)!r}, inertial_number=0.01, **{SMALL})
    except pgran.options.OptionError: os.write(1, b" refused ")
thread = threading.Thread(target=run)
thread.start()
thread.join()
"""
    found = run_ranks(2, "-c", script).stdout.split()
    assert sorted(found) == ["2", "2", "refused", "refused"]


def test_a_signal_stops_a_run_in_this_process_and_the_same_call_resumes_it(tmp_path, path):
    more = {**SMALL, "element_size": 1, "step_max": 1e-4}

    def interrupt():
        while not (path.exists() and len(pgran.open(path).history["time"]) > 3):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(Interrupted, match="SIGINT"):
        pgran.run(path, **more)
    assert not pgran.open(path).complete
    complete = pgran.run(tmp_path / "complete.h5", **more)
    assert pgran.run(path, **more).snapshots[-1]["pressure"] == pytest.approx(
        complete.snapshots[-1]["pressure"], rel=1e-6)


def test_results_are_absolute_and_refuse_the_data_of_a_later_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    first = pgran.run(inertial_number=0.001, **SMALL)
    second = pgran.run(inertial_number=0.01, **SMALL)
    found = pgran.sweep({"inertial_number": [0.001]}, directory="b", **SMALL)
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert first.path == second.path == tmp_path / "results" / "biaxial.h5"
    with pytest.raises(ResultError, match="another run has replaced the run"):
        first.snapshots[-1]["pressure"]
    assert second.snapshots[-1]["inertial_number"].mean() > 0.005
    assert pgran.open(tmp_path / "results" / "biaxial.1.h5").snapshots[-1][
        "inertial_number"].mean() < 0.002
    assert [row["complete"] for row in found.rows()] == [True]
    pgran.run(found.paths[0], inertial_number=0.01, **SMALL)
    with pytest.raises(ResultError, match="another run"):
        found.rows()


@pytest.mark.parametrize("given, error, message", [
    ({"inertial_number": -1}, ParameterError, "inertial_number"), ({"nosuch": 1}, OptionError, ""),
    ({"petsc": {"log_view": ""}}, OptionError,
     "-log_view: PETSc reads this option only when it starts"),
    ({**FAILING, "ranks": 0}, SolutionError, "exit code 1"), (FAILING, SolutionError, "step")])
def test_errors_are_raised(path, given, error, message):
    with pytest.raises(error, match=message):
        pgran.run(path, **SMALL, **given)
    assert not path.exists()  # no step was accepted


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
    with pytest.raises(OptionError, match="task 4: must be >= 0 and <= 3"):
        pgran.sweep(grid, directory=tmp_path, **SMALL)


def test_a_sweep_runs_equal_points_once_and_reports_failures(tmp_path):
    found = pgran.sweep({"step_min": [1e-8, 6e-5, 6e-5]}, directory=tmp_path, workers=2,
                        petsc={"snes_max_it": 3}, **SMALL)
    assert list(found.failures)[-2:] == [1, 2] and "exit code 1" in found.failures[1]
    assert found.paths[1] == found.paths[2] and len(found.rows()) == 3
    with pytest.raises(ParameterError):
        pgran.sweep({"inertial_number": [0.001, -1]}, directory=tmp_path / "new", **SMALL)
    assert not (tmp_path / "new").exists()
    with pytest.raises(OptionError, match="results of a sweep are named after their points"):
        pgran.sweep({"inertial_number": [0.001]}, directory=tmp_path, output="x.h5", **SMALL)


@pytest.mark.parametrize("more", [
    {"petsc": {"options_file": shipped("large")}}, {"options_file": shipped("direct")},
    FAILING], ids=["multigrid", "direct", "fails"])
def test_a_run_in_this_process_frees_its_objects(tmp_path, more):
    counts = []
    for number in range(3):
        with suppress(SolutionError):
            pgran.run(tmp_path / f"{number}.h5", **SMALL, **more)
        gc.collect()
        counts.append(sum(str(type(thing).__module__).startswith(
            ("petsc4py", "pgran.solve", "pgran.space")) for thing in gc.get_objects()))
    # PETSc keeps the last error that a callback has raised.
    assert counts[2] == counts[1] and (more is FAILING or counts[0] == counts[1])


def test_simultaneous_threads_get_separate_results(tmp_path):
    def run(number):
        path = tmp_path / f"{min(number, 0.003)}.h5"  # the last two have the same file
        return pgran.run(path, element_size=4, inertial_number=number, **SMALL)

    wanted = [0.001, 0.002, 0.003, 0.004]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(run, wanted))
    assert [result.options["inertial_number"] for result in found] == wanted
    assert all(result.complete for result in found)


def user_case(folder, elements=4):
    """Write a file with a user-defined case, a periodic cell; return the options of a run."""
    (folder / "cell.py").write_text(f"from pgran.cases.periodic import Periodic\n"
                                    f"class Cell(Periodic):\n    shape = {elements}, 4\n")
    return {"case": f"{folder}/cell.py:Cell", "end_time": 0.001, "imperfection": 1}


def test_a_run_of_a_user_defined_case_is_repeated_only_when_its_file_changes(tmp_path, path):
    given = user_case(tmp_path)
    assert pgran.run(path, **given).snapshots[-1].x.shape == (8, 8, 2)
    begun = path.stat().st_mtime_ns
    assert pgran.run(path, **given).complete and path.stat().st_mtime_ns == begun
    assert pgran.run(path, **user_case(tmp_path, 6)).snapshots[-1].x.shape == (8, 12, 2)


def test_results_can_be_pickled(tmp_path):
    result = pgran.run(tmp_path / "a.h5", **user_case(tmp_path))
    result.case, result.snapshots[-1]["pressure"]  # are cached
    again = pickle.loads(pickle.dumps(result))
    assert again.parameters == result.parameters and again.options == result.options
    assert again.parameters.part("case") is result.parameters.part("case")
    assert np.array_equal(again.snapshots[-1]["speed"], result.snapshots[-1]["speed"])
    assert copy.deepcopy(result.parameters) == result.parameters


def test_a_locale_with_a_decimal_comma_has_no_effect(tmp_path, path, monkeypatch):
    """PETSc reads numbers as the locale writes them."""
    if shutil.which("localedef"):
        subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", tmp_path / "de_DE.UTF-8"],
                       check=False, capture_output=True)
    if not (tmp_path / "de_DE.UTF-8").is_dir():
        pytest.skip("no locale with a decimal comma can be made")
    monkeypatch.setenv("LOCPATH", str(tmp_path))
    run_ranks(0, "-c", f"""
import locale, pgran
from pgran.__main__ import main
assert locale.setlocale(locale.LC_NUMERIC, "de_DE.UTF-8")
pgran.run({str(path)!r}, petsc={{"snes_rtol": "0.5e-1"}}, **{SMALL})
code = main(["pgran", "-snes_rtol", "0.5e-1", "-pgran_output", {str(path)!r},
             "-pgran_element_size", "20", "-pgran_compression", "0.0001"])
assert code == 0 and locale.localeconv()["decimal_point"] == ","
""")
