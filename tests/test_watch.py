"""A run reports its progress, its remaining time and its end."""

import os
import shlex
import shutil
import subprocess

import h5py
import numpy as np
import pytest
from conftest import pgran as run_pgran, run_ranks

from pgran import watch
from pgran.output import files, progress
from pgran.output.result import Result

SMALL = "-pgran_width 8 -pgran_height 24 -pgran_compression 0.002"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A run that was stopped, with pictures of two steps."""
    path = tmp_path_factory.mktemp("watch") / "small.h5"
    run_pgran(2, "biaxial.opts", path, SMALL, "-ts_max_steps 8", picture_every=4)
    return path


def test_the_remaining_time_is_right_within_a_factor_of_two_after_the_first_tenth():
    done = np.linspace(0.0, 1.0, 200)[1:]**2.0
    spent = 300.0 * np.sqrt(done)
    for count in range(np.searchsorted(done, 0.1) + 1, len(done)):
        found, true = progress.left(done[:count], spent[:count]), spent[-1] - spent[count - 1]
        assert 0.5 * true < found < 2.0 * true
    assert not progress.left([0.1, 0.2], [1.0, 2.0]) and not progress.left([0.2] * 4, [1.0] * 4)


def test_a_curve_of_text_has_its_points_and_scales():
    lines = watch.curve(np.arange(5.0), np.arange(5.0)**2, (17, 5))
    assert [line.find("*") for line in lines[:5]] == [28, -1, 24, 20, 12]
    assert lines[0].strip().startswith("16 |") and lines[4].strip().startswith("0 |")
    assert watch.curve(np.ones(3), np.ones(3))[-3].count("*") == 1


def changed(path, copy, **attributes):
    """Copy a result without its snapshots, with other root attributes; return the path."""
    shutil.copy(path, copy)
    with h5py.File(copy, "r+") as file:
        del file["snapshots"]
        file.create_group("snapshots")
        file.attrs.update(attributes)
    return copy


@pytest.fixture(scope="module")
def ended():
    """The identifier of a process that has ended."""
    code = "import pgran.output.files as f; print(f.process_identity())"
    return run_ranks(0, "-c", code).stdout.strip()


@pytest.mark.parametrize("attributes, words", [
    ({"state": "stopped"}, "compression, stopped"),
    ({"state": "complete", "complete": True, "seconds": 60.0}, "complete after 60 s"),
    ({"state": "running", "process": "another/1 12 345"}, "ended: its file has not changed for"),
    ({"state": "running"}, "killed: its process has ended")],
    ids=["stopped", "complete", "silent on another machine", "killed"])
def test_the_monitor_ends_with_the_run(path, tmp_path, capsys, attributes, words, ended):
    copy = changed(path, tmp_path / "run.h5", **{"process": ended, **attributes})
    os.utime(copy, (1e9, 1e9))
    assert watch.main([str(copy), "-every", "0.1"]) == 0
    assert words in capsys.readouterr().out


def test_only_processes_of_this_machine_are_known_to_have_ended(ended):
    found = map(files.is_running, (ended, files.process_identity(), "another/1 12 345", ""))
    assert list(found) == [False, True, None, None]


def test_the_monitor_shows_the_last_step(path, tmp_path, capsys):
    path = changed(path, tmp_path / "run.h5", state="running", process=files.process_identity())
    assert watch.main([str(path), "-once"]) == 0
    text = capsys.readouterr().out
    assert f"step {len(Result(path).history['time']):4d}  dt" in text and "*" in text
    assert "running for" in text and " left" in text
    assert watch.main([str(path), "-once", "-column", "nosuch"]) == 1
    assert "-column nosuch" in capsys.readouterr().err


def test_a_run_draws_pictures_stores_its_end_and_prints_the_next_commands(path, tmp_path):
    names = sorted(picture.name for picture in path.parent.glob("*.png"))
    assert names == ["small_step0004.png", "small_step0008.png"]
    assert Result(path).attributes["state"] == "stopped"  # by -ts_max_steps
    output = tmp_path / "r.h5"
    text = run_pgran(0, "direct.opts", output, SMALL, compression=1e-4).stdout
    assert Result(output).attributes["state"] == "complete"
    commands = [line.split("next:")[-1].strip() for line in text.splitlines()[-3:]]
    assert [command.split(" ", 1)[1] for command in commands[:2]] == [
        f"-m pgran.plot {output}", f"-m pgran.measure {output}"]
    for command in commands:
        subprocess.run(shlex.split(command), check=True, capture_output=True)
