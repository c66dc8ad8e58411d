"""Result files: snapshot files and links, earlier results of the same name, locks and folders."""

import errno
import fcntl
import shutil
from pathlib import Path
from unittest.mock import Mock
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from conftest import discretised, pgran, read_vtk, refused

from pgran.output import snapshots
from pgran.output.reader import ResultError
from pgran.output.result import Result
from pgran.output.start import Source
from pgran.output.writer import Writer
from pgran.pack import main as pack


@pytest.fixture(scope="module")
def form():
    return discretised(width=8, height=24)


def fields(form, number=0.0):
    """Fields of a snapshot that depend on a number."""
    x = form.case.coordinates(*form.grid.nodes.index)
    return {"coordinates": x, "velocity": x + number, "pressure": x[0] + number,
            "deviator": np.stack([x[0], x[1], x[0] + number])}


def write(path, form, count, source=None, first=0, **attributes):
    """Write a result with some snapshots, after the snapshots of a source."""
    writer = Writer(path, form)
    writer.begin(source, **attributes)
    for number in range(first, first + count):
        writer.snapshot(float(number), fields(form, number))
    writer.flush(state="complete")
    writer.close()
    return path


def snapshot_files(path):
    return sorted(path.parent.glob(f"{path.stem}.snapshot_*"))


def assert_pressures(path, form, count):
    """Assert that pgran and VTK read the pressures of all snapshots."""
    for found in (Result(path).snapshots, list(read_vtk(path))):
        assert len(found) == count
        for number, snapshot in enumerate(found):
            np.testing.assert_array_equal(np.ravel(snapshot["pressure"]),
                                          fields(form, number)["pressure"])


def test_a_result_can_be_moved_and_renamed(tmp_path, path, form):
    write(path, form, 3)
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for entry in (path, *snapshot_files(path)):
        entry.rename(moved / entry.name)
    assert_pressures((moved / path.name).rename(moved / "renamed.h5"), form, 3)


def test_a_missing_or_foreign_snapshot_file_is_named(path, form):
    write(path, form, 3)
    names, later = snapshot_files(path), Result(path)
    content = names[1].read_bytes()
    names[1].unlink()
    for action in (lambda: Result(path), lambda: later.snapshots[1]["pressure"]):
        with pytest.raises(ResultError, match=f"snapshot 0001: its file {names[1]} is missing"):
            action()
    assert np.isfinite(later.snapshots[2]["pressure"]).all()
    with h5py.File(path) as file:  # in VTK the data ends
        assert len(file["VTKHDF/PointData/pressure"]) == np.prod(form.grid.nodes.shape)
    shutil.copy(names[0], names[1])
    with pytest.raises(ResultError, match=f"{names[1]} was written as {names[0].name}"):
        Result(path)
    names[1].write_bytes(content)
    assert len(Result(path).snapshots) == 3


def test_a_packed_result_is_one_file(tmp_path, path, form, capsys):
    one = tmp_path / "inner" / "one.h5"
    one.parent.mkdir()
    write(path, form, 3, note="kept")
    assert pack([str(path), str(one)]) == 0
    for entry in (path, *snapshot_files(path)):
        entry.unlink()
    assert Result(one).attributes["note"] == "kept" and "time" in Result(one).history
    assert_pressures(one, form, 3)
    assert pack([str(one), str(one)]) == 1
    assert str(one) in capsys.readouterr().err


def test_a_new_run_renames_an_earlier_result_of_the_same_name(tmp_path, form):
    path = write(tmp_path / "a&b <c>.h5", form, 2)
    content = {entry: entry.read_bytes() for entry in snapshot_files(path)}
    write(path, form, 1)
    assert all(entry.read_bytes() == old for entry, old in content.items())
    for name, count in (("a&b <c>", 1), ("a&b <c>.1", 2)):
        result = Result(tmp_path / f"{name}.h5")
        assert len(result.snapshots) == count
        items = [item.text.rpartition(":/") for item in ElementTree.parse(
            tmp_path / f"{name}.xdmf").iter("DataItem") if item.get("Format") == "HDF"]
        assert {file for file, _, dataset in items if dataset == "cells"} == {f"{name}.h5"}
        assert {file for file, _, dataset in items if dataset != "cells"} == {
            f"a&b <c>.snapshot_{result.run}_{serial:04d}.h5" for serial in range(count)}


def test_a_continued_run_removes_only_unused_files_of_its_own(tmp_path, path, form):
    stale, other = Result(write(path, form, 3)), write(tmp_path / "other.h5", form, 2)
    snapshots.file_name(path, stale.run, 3).write_bytes(b"")  # as after a kill before the link
    for last in (4, 5):
        write(path, form, 1, Source(path, stale.run, 0, 2), first=7)
        assert [int(entry.stem[-4:]) for entry in snapshot_files(path)] == [0, 1, last]
    assert len(Result(other).snapshots) == 2
    assert Result(path).snapshots[2].time == 7.0
    with pytest.raises(ResultError, match="snapshot 0002 was replaced"):
        stale.snapshots[2]["pressure"]
    shutil.copy(path, tmp_path / "copy.h5")  # it links to the files
    write(path, form, 0, Source(path, stale.run, 0, 1))
    assert len(Result(path).snapshots) == 1
    assert np.isfinite(Result(tmp_path / "copy.h5").snapshots[2]["pressure"]).all()


def test_more_than_9999_snapshots_are_in_order(path):
    names = ["0000", "9998", "9999", "10000", "10001"]
    with h5py.File(path, "w") as file:
        for name in names:
            file.create_group(f"snapshots/{name}")
        assert list(snapshots.linked(file)) == names


def test_a_file_system_without_locks_causes_a_warning(path, form, monkeypatch, capsys):
    monkeypatch.setattr(fcntl, "flock", Mock(side_effect=OSError(errno.ENOLCK, "No locks")))
    write(path, form, 1)
    assert len(Result(path).snapshots) == 1 and not list(path.parent.glob(".*"))
    assert f"pgran: warning: {path}: the file system has no locks (No locks)" in (
        capsys.readouterr().err)


def test_a_symbolic_link_as_output_is_kept(tmp_path, path, form):
    target = tmp_path / "disk" / "data.h5"
    target.parent.mkdir()
    path.symlink_to(target)
    for count in (1, 2):
        write(path, form, count)
        assert path.is_symlink() and target.is_file() and not target.is_symlink()
        assert len(Result(path).snapshots) == count
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["disk", "run.h5"]


def test_a_missing_folder_is_created_only_below_results(tmp_path, form, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "typo" / "x.h5"
    refused(pgran(2, "direct.opts", path, "-pgran_width", 8, "-pgran_height", 24, check=False),
            f"-pgran_output {path}: there is no folder {path.parent}")
    assert not path.parent.exists()
    write(Path("results") / "case" / "x.h5", form, 1)
    assert len(Result("results/case/x.h5").snapshots) == 1
