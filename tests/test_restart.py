"""A run that is stopped, killed or out of disk space is continued to the same result."""

import signal
import subprocess
import time

import h5py
import numpy as np
import pytest
from conftest import LIMIT, ROOT, discretised, pgran, refused, run_ranks, start
from test_runs import differences

from pgran.cli import STOPPED
from pgran.kinematics import PLANE
from pgran.output import checkpoint
from pgran.output.result import Result
from pgran.output.snapshots import linked
from pgran.runs import run_on_ranks
from pgran.solve import state
from studies import kill

#: A specimen that yields in about twenty steps, which take a second.
SMALL = "-pgran_element_size 8 -pgran_compression 0.008 -pgran_progress quiet"
SHORT = f"{SMALL} -pgran_snapshots 0.004,0.008"
#: A run that takes long enough to be interrupted.
LONG = f"{SHORT} -pgran_element_size 4"
DIRECT = ROOT / "options" / "direct.opts"
#: A column of a layer on a slope.
SLOPE = "-ts_type beuler -pgran_width 1 -pgran_element_size 1 -pgran_progress quiet"
#: It slows down to rest; the rest speed follows.
SLOWER = (f"{SLOPE} -pgran_end_time 50 -pgran_height 2 -pgran_inertia true -pgran_model li "
          "-pgran_slope 15 -pgran_start flow -pgran_step_max 0.1 -pgran_rest_speed")


def same(path, other, tolerance, exact=False):
    """Assert that two complete results are equal, and with ``exact`` also their iterations."""
    assert max(differences(path, other).values()) <= tolerance
    a, b = Result(path), Result(other)
    assert a.complete and b.complete
    assert [x.time for x in a.snapshots] == pytest.approx([x.time for x in b.snapshots], rel=1e-12)
    assert a.history.keys() == b.history.keys()
    np.testing.assert_allclose(a.history["time"], b.history["time"], rtol=max(tolerance, 1e-12))
    np.testing.assert_allclose(np.cumsum(a.history["step_size"]), a.history["time"], rtol=1e-12)
    if exact:
        for name in ("newton_iterations", "linear_iterations"):
            np.testing.assert_array_equal(a.history[name], b.history[name])
        for name in ("steps", "steps_repeated"):
            assert a.attributes[name] == b.attributes[name]


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """An uninterrupted run on one rank."""
    path = tmp_path_factory.mktemp("short") / "short.h5"
    pgran(0, "direct.opts", path, SHORT)
    return path


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """A longer uninterrupted run on one rank."""
    path = tmp_path_factory.mktemp("long") / "long.h5"
    pgran(0, "direct.opts", path, LONG)
    return path


def test_a_restart_on_the_same_ranks_gives_the_same_result(short, path):
    pgran(0, "direct.opts", path, SHORT, "-ts_max_steps", 16)
    stopped = Result(path)
    assert not stopped.complete and stopped.snapshots[-1].time == stopped.history["time"][-1]
    pgran(0, "direct.opts", path, SHORT, restart=path)
    same(short, path, 1e-10, exact=True)
    with h5py.File(path) as file:
        kept = linked(file).values()
    assert {entry.name for entry in path.parent.iterdir() if "checkpoint" not in entry.name} == {
        "run.h5", *kept, "run.xdmf"}  # nothing is renamed, nothing left over
    assert path.with_suffix(".xdmf").read_text().count("<Time") == 2


def test_a_checkpoint_with_tensor_components_is_read(short, path):
    """Checkpoints before release 0.4 have tensor instead of Mandel components."""
    pgran(0, "direct.opts", path, SHORT, "-ts_max_steps", 8)
    newest, *others = checkpoint.checkpoints_of(path)
    for other in others:
        other.unlink()
    with h5py.File(newest, "r+") as file:
        del file.attrs["mandel"]
        for data in file["elements"].values():
            data[...] = np.moveaxis(PLANE.tensor(np.moveaxis(data[...], -2, 0)), 0, -2)
    pgran(0, "direct.opts", path, SHORT, restart=path)
    same(short, path, 1e-8)


def test_a_run_continues_on_any_number_of_ranks(short, path):
    pgran(2, "direct.opts", path, SHORT, "-ts_max_steps", 8)
    for ranks, steps in ((3, 13), (0, 10**6)):
        pgran(ranks, "direct.opts", path, SHORT, "-ts_max_steps", steps, restart=path)
    same(short, path, 1e-7)


@pytest.mark.parametrize("options_file, ranks, tolerance, steps, more", [
    ("biaxial.opts", 2, 5e-3, 15, SMALL),
    ("li.opts", 0, 1e-7, 8, f"{SMALL} -pgran_compression 0.004"),
    ("direct.opts", 0, 1e-7, 14,
     f"{SMALL} -pgran_inertia true -pgran_law jop -pgran_compression 0.002"),
    ("periodic.opts", 0, 1e-7, 14, "-pgran_cell_elements 4 -pgran_end_time 0.003"),
    ("planar_shear.opts", 0, 1e-7, 8, "-ts_type beuler -pgran_end_time 0.002"),
    # Stopped after one attempt of the first step, which failed.
    ("inclined_plane.opts", 0, 1e-10, 1, f"{SLOPE} -pgran_end_time 0.01 -pgran_height 6 "
     "-pgran_model ngf_primitive -pgran_snapshots 0.0011,0.0012,0.004"),
    ("inclined_plane.opts", 0, 1e-10, 20, f"{SLOWER} 0.05")],
    ids=["fieldsplit", "li", "inertia and jop", "periodic", "fixed mesh", "close targets",
         "coming to rest"])
def test_every_kind_of_run_can_be_continued(tmp_path, path, options_file, ranks, tolerance, steps,
                                            more):
    complete = tmp_path / "complete.h5"
    pgran(0, options_file, complete, more)
    pgran(ranks, options_file, path, more, "-ts_max_steps", steps)
    assert kill.steps(path) <= steps and not Result(path).complete
    pgran(0, options_file, path, more, restart=path)
    same(complete, path, tolerance, exact=tolerance == 1e-10)


def test_a_run_at_rest_is_not_continued_without_a_smaller_rest_speed(path):
    def end(rest_speed, **more):
        pgran(0, "inclined_plane.opts", path, SLOWER, rest_speed, **more)
        return Result(path).history["time"][-1]

    first = end(0.05)
    assert end(0.05, restart=path) == first < end(0.01, restart=path) < 5.0


def test_a_restart_after_an_error_begins_with_the_desired_step(path):
    more = f"{SMALL} -pgran_step_first 1.5e-4"
    done = pgran(0, "direct.opts", path, more, step_min=1e-4, check=False)
    refused(done, "no step down to -pgran_step_min 0.0001 converges", "a larger -pgran_step_error")
    steps = kill.steps(path)
    assert steps
    with h5py.File(checkpoint.checkpoints_of(path)[0]) as file:
        wanted = file.attrs["wanted"]
    pgran(0, "direct.opts", path, more, "-ts_max_steps", steps + 1, step_error=100, restart=path)
    assert Result(path).history["step_size"][steps] == wanted


def test_a_complete_run_can_be_extended(short, path):
    pgran(0, "direct.opts", path, SMALL, compression=0.004)
    pgran(0, "direct.opts", path, restart=path, compression=0.008)
    same(short, path, 1e-10)  # with the other options of the run
    done = pgran(2, "direct.opts", path, restart=path, compression=1e-5, check=False)
    refused(done, "is later than the requested end of the run")


#: Messages for damaged checkpoints, the damaged dataset or attribute, and its new value.
DAMAGE = (("coordinates is not an array of 31 x 11 x 2 numbers", "nodes/coordinates", None),
          ("stress is not an array of 15 x 5 x 3 x 9 numbers", "elements/stress",
           np.zeros((15, 5, 2, 9))),
          ("velocity contains NaN", "nodes/velocity", np.full((31, 11, 2), np.nan)),
          ("wanted is not a finite number", "wanted", "soon"),
          ("it contains invalid numbers", "period", 0.0), ("steps is missing", "steps", None))


def test_a_damaged_checkpoint_is_skipped(short, tmp_path, path):
    pgran(0, "direct.opts", path, SHORT, "-ts_max_steps", 17, checkpoint_steps=5)
    newest, older = checkpoint.checkpoints_of(path)
    assert [entry.name for entry in (newest, older)] == [
        "run.checkpoint_000017.h5", "run.checkpoint_000015.h5"]
    kept, content, form = path.read_bytes(), newest.read_bytes(), discretised(
        element_size=8, restart=path)
    for words, name, value in DAMAGE:
        newest.write_bytes(content)
        with h5py.File(newest, "r+") as file:
            holder = file if "/" in name else file.attrs
            del holder[name]
            if value is not None:
                holder[name] = value
        _, values, damaged = state.checkpoint_start(form)
        assert values["steps"] == 15 and len(damaged) == 1
        assert damaged[0].startswith(f"{newest.name}: {words}")
    for damaged in (b"", content[:-5000] + bytes(5000), content[:len(content) // 2]):
        newest.write_bytes(damaged)
        assert state.checkpoint_start(form)[1]["steps"] == 15
    other = tmp_path / "other.h5"
    done = pgran(0, "direct.opts", other, SHORT, restart=path, progress="brief")
    assert "skipped a damaged checkpoint, run.checkpoint_000017.h5: " in done.stdout
    same(short, other, 1e-7)
    assert path.read_bytes() == kept  # a restart with another name keeps the result
    older.write_bytes(b"")
    refused(pgran(0, "direct.opts", path, SHORT, restart=path, check=False),
            "it has no checkpoint to resume from", older.name, newest.name)


def test_a_restarted_run_that_is_killed_in_its_first_step_can_be_restarted(short, path):
    pgran(0, "direct.opts", path, SHORT, "-ts_max_steps", 8)
    done = pgran(0, "direct.opts", path, SHORT, "-pgran_restart", path, check=False, patch="""
from pgran.__main__ import Run
Run.checkpoint = lambda self: os._exit(9)
""")
    assert done.returncode == 9 and kill.steps(path) == 9
    pgran(0, "direct.opts", path, SHORT, restart=path)
    same(short, path, 1e-7)


def start_long(ranks, path):
    """Start a long run in the background, in its own group of processes."""
    return start(ranks, "-m", "pgran", "-options_file", DIRECT, "-pgran_output", path,
                 *LONG.split(), stdout=subprocess.DEVNULL, start_new_session=True)


def wait_for(path, steps):
    """Wait until a result contains ``steps`` steps."""
    end = time.monotonic() + LIMIT
    while kill.steps(path) < steps:
        assert time.monotonic() < end, f"{path} does not have {steps} steps after {LIMIT} s"
        time.sleep(0.02)


@pytest.mark.parametrize("name, ranks", [("SIGTERM", 0), ("SIGUSR1", 2)])
def test_a_signal_stops_a_run_with_a_checkpoint_and_exit_code_75(long, path, name, ranks):
    run = start_long(ranks, path)
    wait_for(path, 5)
    run.send_signal(getattr(signal, name))
    errors = run.communicate(timeout=LIMIT)[1]
    assert run.returncode == STOPPED, errors
    assert f"pgran: stopped by {name} at " in errors and f"-pgran_restart {path}" in errors
    assert "error" not in errors.split("Primary job")[0].split("------")[0]
    assert len(checkpoint.checkpoints_of(path)) == 1
    if name == "SIGTERM":
        pgran(0, "direct.opts", path, LONG, restart=path)
        same(long, path, 1e-7)


EARLY = """
import os, runpy, signal, sys
class Finder:
    def find_spec(name, *rest):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGTERM)
sys.meta_path.insert(0, Finder)
runpy.run_module("pgran", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("module, kind, words", [
    ("numpy", "beuler", "resume with: <same command> -pgran_restart {path}"),
    ("pgran.solve.driver", "pseudo", "there is nothing to resume from: start it again")])
def test_a_signal_before_the_first_step_stops_the_run(short, path, module, kind, words):
    done = run_ranks(0, "-c", EARLY.format(module=module), "-options_file", DIRECT,
                     *SHORT.split(), "-ts_type", kind, "-pgran_output", path, check=False)
    assert done.returncode == STOPPED, done.stderr
    assert done.stderr.splitlines() == [
        f"pgran: stopped by SIGTERM at 0 % compression; {words.format(path=path)}"]
    if kind == "beuler":
        pgran(0, "direct.opts", path, SHORT, restart=path)
        same(short, path, 1e-10)


def test_the_launcher_forwards_a_signal_and_restarts_the_run(long, path, monkeypatch):
    monkeypatch.setattr(run_on_ranks, "RANKS", 0)
    with start(0, "-m", "pgran.runs.run_on_ranks", path, DIRECT, *LONG.split()) as run:
        wait_for(path, 3)
        run.send_signal(signal.SIGTERM)
        errors = run.communicate(timeout=LIMIT)[1]
    assert run.returncode == STOPPED, errors
    run_on_ranks.run(path, DIRECT, *LONG.split())  # the same command restarts
    same(long, path, 1e-7)


def test_ranks_killed_by_a_forwarded_signal_count_as_stopped(monkeypatch):
    monkeypatch.setattr(run_on_ranks, "SIGNALS", (signal.SIGTERM,))
    code = "import os, signal, time; os.kill(os.getppid(), signal.SIGTERM); time.sleep(30)"
    assert run_on_ranks.python(0, "-c", code, check=False).returncode == STOPPED


@pytest.mark.nightly
def test_a_run_killed_at_random_moments_on_changing_ranks_ends_the_same(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    kill.kills(3, tmp_path)


def test_the_history_can_be_read_during_the_run(path):
    run = start_long(2, path)
    wait_for(path, 4)
    with h5py.File(path) as held:  # an open reader
        seen = len(held["history/time"])
        wait_for(path, seen + 8)
        assert len(held["history/time"]) == seen
        run_on_ranks.kill(run)
        run.communicate()
    assert kill.steps(path) >= seen + 8


def test_one_file_has_one_writer(path):
    run = start_long(0, path)
    wait_for(path, 2)
    run.send_signal(signal.SIGSTOP)  # so that it still runs when the other one starts
    done = pgran(2, "direct.opts", path, SMALL, check=False)
    refused(done, f"-pgran_output {path}: another run writes it (process {run.pid} on ")
    for number in (signal.SIGTERM, signal.SIGCONT):
        run.send_signal(number)
    run.communicate()
    assert not list(path.parent.glob(".*"))  # no lock and no temporary file


FAULT = """
import itertools, pathlib, resource, shutil
allocate, calls, path = os.posix_fallocate, itertools.count(), {path!r}
def fail(*arguments):
    if next(calls) >= 8:
        {fault}
    allocate(*arguments)
os.posix_fallocate = fail
{setup}
"""


@pytest.mark.parametrize("fault, setup, message", [
    ("open('/dev/full', 'w', 1).write('full\\n')", "", "No space left on device"),
    ("shutil.rmtree(os.path.dirname(path), ignore_errors=True)", "", ""),
    ("pathlib.Path(path).unlink(missing_ok=True)", "", "it was removed while the run wrote it"),
    ("", "resource.setrlimit(resource.RLIMIT_FSIZE, (1_100_000,) * 2)", "File too large")],
    ids=["full disk", "folder removed", "result removed", "size limit"])
def test_a_failing_disk_gives_one_error_and_keeps_the_last_checkpoint(tmp_path, fault, setup,
                                                                      message):
    path = tmp_path / "inner" / "run.h5"
    path.parent.mkdir()
    done = pgran(2, "direct.opts", path, SMALL, checkpoint_steps=2, check=False,
                 patch=FAULT.format(path=str(path), fault=fault or "pass", setup=setup))
    refused(done, f"-pgran_output {path}: {message}")
    if message == "File too large":
        assert kill.steps(path) >= 1 and not list(path.parent.glob(".*"))
    elif message == "No space left on device":
        pgran(0, "direct.opts", path, SMALL, restart=path, compression=0.002)
        assert Result(path).complete and not list(path.parent.glob(".*"))


@pytest.mark.parametrize("command, streams, code, errors", [
    ("pgran", "| head -n 1", 0, ""),
    ("pgran", ">/dev/full", 0, "pgran: warning: standard output cannot be written (No space left on"
     " device); further output is discarded\n"),
    ("pgran", ">&- 2>&- <&-", 0, ""),
    ("pgran.stability", ">/dev/full", 1, "No space left on device")])
def test_an_unwritable_log_does_not_end_a_run_but_an_unwritable_answer_is_an_error(
        path, command, streams, code, errors):
    options = "-cutoff" if code else (
        f"-options_file {DIRECT} {SMALL} -pgran_progress steps -ts_monitor -pgran_output {path}")
    line, environment = run_on_ranks.command(0, "-m", command, *options.split())
    done = subprocess.run(["bash", "-o", "pipefail", "-c", f'"$@" {streams}', "bash", *line],
                          env=environment, cwd=ROOT, capture_output=True, text=True,
                          timeout=LIMIT)
    assert done.returncode == code
    assert errors in done.stderr if code else done.stderr == errors and Result(path).complete
