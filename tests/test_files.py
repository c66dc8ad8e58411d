"""Snapshot files, links to them, locks, folders and names of results."""

import errno
import fcntl
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import discretised, pgran, refused, run_ranks

from pgran.output import files, snapshots, vtkhdf
from pgran.output.reader import ResultError, opened
from pgran.output.result import Result
from pgran.output.start import Source
from pgran.output.writer import Writer
from pgran.pack import main as pack_main, pack
from pgran.runs import run_on_ranks

SMALL = "-pgran_width", 8, "-pgran_height", 24, "-pgran_compression", 0.0002


@pytest.fixture(scope="module")
def form():
    return discretised(width=8, height=24)


def fields(form, number=0.0):
    """Fields of a snapshot, which a number tells apart."""
    x = form.case.coordinates(form.grid.nodes.i, form.grid.nodes.j)
    return {"coordinates": x, "velocity": x + number, "pressure": x[0] + number,
            "deviator": np.stack([x[0], x[1], x[0] + number])}


def write(path, form, count, **attributes):
    """Write a result with so many snapshots."""
    writer = Writer(path, form)
    writer.begin(**attributes)
    for number in range(count):
        writer.snapshot(float(number), fields(form, number))
    writer.flush(state="complete")
    writer.close()
    return path


def snapshot_files(path):
    return sorted(path.parent.glob(f"{path.stem}.snapshot_*"))


def read_by_vtk(path):
    """Return the pressures of all steps as VTK reads them."""
    import pyvista
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    found = []
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        found.append(np.array(pyvista.wrap(reader.GetOutput())["pressure"]))
    return found


def test_the_bytes_written_for_a_snapshot_do_not_depend_on_their_number(tmp_path):
    form = discretised(element_size=4)
    writer = Writer(tmp_path / "run.h5", form)
    writer.begin()

    def written():
        with open("/proc/self/io") as file:
            return int(dict(line.split(": ") for line in file)["wchar"])

    sizes = []
    for number in range(40):
        before = written()
        writer.snapshot(float(number), fields(form))
        sizes.append(written() - before)
    writer.close()
    # What is left is a link and a time in the result file.
    assert sizes[-1] - sizes[1] < 500 * 38
    assert sizes[-1] < 1.2 * sizes[1]


def test_users_h5py_and_vtk_open_only_the_result(tmp_path, form):
    path = write(tmp_path / "run.h5", form, 3)
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for entry in (path, *snapshot_files(path)):
        entry.rename(moved / entry.name)
    path = (moved / path.name).rename(moved / "renamed.h5")  # the links hold
    expected = [fields(form, number)["pressure"] for number in range(3)]
    with h5py.File(path) as file:
        assert list(file["snapshots"]) == ["0000", "0001", "0002"]
        assert [file[f"snapshots/000{number}"].attrs["time"] for number in range(3)] == [0, 1, 2]
        for number, values in enumerate(expected):
            link = file["snapshots"].get(f"000{number}", getlink=True)
            assert os.path.basename(link.filename) == link.filename
            np.testing.assert_array_equal(
                file[f"snapshots/000{number}/pressure"][...].ravel(), values)
    for values, found, mine in zip(expected, read_by_vtk(path), Result(path).snapshots):
        np.testing.assert_array_equal(found, values)
        np.testing.assert_array_equal(mine["pressure"].ravel(), values)


def test_a_missing_and_a_foreign_snapshot_file_are_named(tmp_path, form):
    path = write(tmp_path / "run.h5", form, 3)
    names, later = snapshot_files(path), Result(path)
    content = names[1].read_bytes()
    names[1].unlink()
    with pytest.raises(ResultError, match=f"snapshot 0001: its file {names[1]} is missing"):
        Result(path)
    with pytest.raises(ResultError, match="is missing"):
        later.snapshots[1]["pressure"]
    assert np.isfinite(later.snapshots[2]["pressure"]).all()
    with h5py.File(path) as file:  # VTK sees that data ends, instead of zeros
        assert file["VTKHDF/PointData/pressure"].shape == (form.grid.nodes.shape[0]
                                                           * form.grid.nodes.shape[1],)
    shutil.copy(names[0], names[1])
    with pytest.raises(ResultError, match=f"{names[1]} was written as "
                                          f"{names[0].name}"):
        Result(path)
    names[1].write_bytes(content)
    assert len(Result(path).snapshots) == 3


def test_a_packed_result_is_one_file(tmp_path, form, capsys):
    path, one = write(tmp_path / "run.h5", form, 3, note="kept"), tmp_path / "inner" / "one.h5"
    one.parent.mkdir()
    assert pack_main([str(path), str(one)]) == 0
    expected = [fields(form, number)["pressure"] for number in range(3)]
    for entry in (path, *snapshot_files(path)):
        entry.unlink()
    result = Result(one)
    assert result.attributes["note"] == "kept" and "time" in result.history
    for values, found, mine in zip(expected, read_by_vtk(one), result.snapshots):
        np.testing.assert_array_equal(found, values)
        np.testing.assert_array_equal(mine["pressure"].ravel(), values)
    assert pack_main([str(one), str(one)]) == 1
    assert f"{one}: this file exists already" in capsys.readouterr().err
    assert pack_main([str(tmp_path / "no.h5"), str(tmp_path / "two.h5")]) == 1
    assert not (tmp_path / "two.h5").exists()


def test_a_new_run_of_the_same_name_leaves_the_files_of_the_earlier_one(tmp_path, form):
    path = write(tmp_path / "run.h5", form, 2)
    first = {entry.name: entry.read_bytes() for entry in snapshot_files(path)}
    write(path, form, 1)
    assert len(snapshot_files(path)) == 3
    assert all((tmp_path / name).read_bytes() == content for name, content in first.items())
    assert len(Result(tmp_path / "run.1.h5").snapshots) == 2 and len(Result(path).snapshots) == 1


def test_a_continued_run_removes_only_its_own_files_and_reuses_no_name(tmp_path, form):
    path = write(tmp_path / "run.h5", form, 3)
    other = write(tmp_path / "other.h5", form, 2)
    names = [entry.name for entry in snapshot_files(path)]
    orphan = snapshots.file_name(path, Result(path).run, 3)  # of a run killed before the link
    orphan.write_bytes(b"")
    stale = Result(path)
    for kept, last in ((2, 4), (2, 5)):
        writer = Writer(path, form)
        writer.begin(Source(path, Result(path).run, 0, kept))
        assert [entry.name for entry in snapshot_files(path)] == names[:2]
        writer.snapshot(7.0, fields(form, 7.0))
        writer.close()
        assert [int(entry.stem[-4:]) for entry in snapshot_files(path)] == [0, 1, last]
    assert len(snapshot_files(other)) == 2 and len(Result(other).snapshots) == 2
    assert Result(path).snapshots[2].time == 7.0
    with pytest.raises(ResultError, match="snapshot 0002 was replaced"):
        stale.snapshots[2]["pressure"]


def test_files_that_a_copy_of_the_result_links_to_are_kept(tmp_path, form):
    path = write(tmp_path / "run.h5", form, 2)
    shutil.copy(path, tmp_path / "copy.h5")
    writer = Writer(path, form)
    writer.begin(Source(path, Result(path).run, 0, 1))
    writer.close()
    assert len(Result(path).snapshots) == 1
    assert np.isfinite(Result(tmp_path / "copy.h5").snapshots[1]["pressure"]).all()


def test_a_run_goes_on_from_a_file_that_holds_its_snapshots(tmp_path, form):
    """Earlier releases wrote such files, and so does pgran.pack."""
    path = write(tmp_path / "run.h5", form, 2)
    old = tmp_path / "old.h5"
    pack(path, old)
    with h5py.File(old, "r+") as file:
        file.attrs["format"] = 3
    assert len(Result(old).snapshots) == 2 and Result(old).snapshots[0].target is None
    writer = Writer(old, form)
    writer.begin(Source(old, Result(old).run, 0, 2))
    writer.snapshot(2.0, fields(form, 2.0))
    writer.close()
    assert len(snapshot_files(old)) == 3 and not (tmp_path / "old.1.h5").exists()
    for number, snapshot in enumerate(Result(old).snapshots):
        np.testing.assert_array_equal(snapshot["pressure"].ravel(),
                                      fields(form, number)["pressure"])


def test_more_than_9999_snapshots_are_in_order(tmp_path):
    names = ["0000", "9998", "9999", "10000", "10001"]
    with h5py.File(tmp_path / "long.h5", "w") as file:
        file.attrs["options"] = ""
        for time_, name in enumerate(names):
            group = file.create_group(f"snapshots/{name}")
            group.attrs["time"] = float(time_)
            group["coordinates"] = np.zeros((3, 3, 2))
            group["pressure"] = np.full((3, 3), float(time_))
        vtkhdf.link(file)
        assert list(file["VTKHDF/Steps/Values"]) == [0, 1, 2, 3, 4]
        assert list(file["VTKHDF/PointData/pressure"][::9]) == [0, 1, 2, 3, 4]
    assert snapshots.ordered(reversed(names)) == names
    with opened(tmp_path / "long.h5") as file:
        assert list(snapshots.linked(file)) == names


PIECES = """
import numpy as np
from mpi4py import MPI
from pgran.output import files
comm, files.MESSAGE_SIZE = MPI.COMM_WORLD, 8 * 12
sent = []
class Comm:
    rank, size, Recv = comm.rank, comm.size, comm.Recv
    def Send(self, values, target):
        sent.append(values.nbytes)
        comm.Send(values, target)
whole = np.arange(7 * 11 * 3, dtype=float).reshape(7, 11, 3)
rows = slice(0, 7) if comm.size == 1 else (slice(0, 2), slice(2, 7))[comm.rank]
block = rows, slice(0, 11)
target = {"a": np.zeros(whole.shape), "b": np.zeros((7, 11))} if comm.rank == 0 else None
problem = files.write_blocks(Comm(), target, [("a", block, whole[block]),
                                              ("b", block, whole[..., 0][block])])
assert problem is None and all(size <= files.MESSAGE_SIZE for size in sent)
if comm.rank == 0:
    assert (target["a"] == whole).all() and (target["b"] == whole[..., 0]).all()
else:
    assert len(sent) > 15
"""


def test_ranks_send_fields_as_buffers_of_bounded_size():
    run_ranks(2, "-c", PIECES, limit=60)


@pytest.mark.parametrize("code", [errno.ENOSYS, errno.ENOLCK])
def test_a_file_system_without_locks_gives_a_warning_only(tmp_path, form, monkeypatch, capsys,
                                                          code):
    def flock(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    path = write(tmp_path / "run.h5", form, 1)
    assert len(Result(path).snapshots) == 1 and not list(tmp_path.glob(".*"))
    error = capsys.readouterr().err
    assert f"pgran: warning: {path}: the file system has no locks ({os.strerror(code)})" in error


def test_a_symbolic_link_as_output_stays_one(tmp_path, form):
    (tmp_path / "disk").mkdir()
    link, target = tmp_path / "run.h5", tmp_path / "disk" / "data.h5"
    link.symlink_to(target)
    for count in (1, 2):
        write(link, form, count)
        assert link.is_symlink() and target.is_file() and not target.is_symlink()
        assert len(Result(link).snapshots) == count
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["disk", "run.h5"]


def test_the_xdmf_of_a_renamed_result_names_it_whatever_the_name(tmp_path, form):
    from xml.etree import ElementTree

    path = tmp_path / "a&b <c>.h5"
    for count in (1, 2):
        write(path, form, count)
    for name, count in (("a&b <c>", 2), ("a&b <c>.1", 1)):
        tree = ElementTree.parse(tmp_path / f"{name}.xdmf")
        items = [item.text.rpartition(":/") for item in tree.iter("DataItem")
                 if item.get("Format") == "HDF"]
        run = Result(tmp_path / f"{name}.h5").run
        assert {file for file, _, dataset in items if dataset == "cells"} == {f"{name}.h5"}
        assert {file for file, _, dataset in items if dataset != "cells"} == {
            f"a&b <c>.snapshot_{run}_{serial:04d}.h5" for serial in range(count)}


def test_a_missing_folder_is_made_only_below_results(tmp_path, form, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(pgran(2, "direct.opts", tmp_path / "typo" / "x.h5", *SMALL, check=False),
            f"-pgran_output {tmp_path / 'typo' / 'x.h5'}: there is no folder {tmp_path / 'typo'}")
    assert not (tmp_path / "typo").exists()
    write(Path("results") / "case" / "x.h5", form, 1)
    assert len(Result("results/case/x.h5").snapshots) == 1


def test_kill_ends_the_processes_of_a_run_and_no_others(tmp_path):
    path = str(tmp_path / "run.h5")
    code = ("import subprocess, sys, time; "
            "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']); "
            "print('ready', flush=True); time.sleep(60)")
    line = [sys.executable, "-c", code, path]
    with subprocess.Popen(line, start_new_session=True, stdout=subprocess.PIPE, text=True) as run, \
            subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)", path]) as other:
        try:
            assert run.stdout.readline() == "ready\n"
            found = []
            run_on_ranks.for_processes(run, found.append)
            assert len(found) == 2 and run.pid in found
            run_on_ranks.kill(run)
            run.wait(10)
            time.sleep(0.1)
            assert not any(files.process_identity(number) for number in found)
            assert other.poll() is None
        finally:
            other.kill()
            run_on_ranks.kill(run)
