"""A result opens in VTK as what it is: Q2 elements over time, with the same numbers."""

import shutil

import h5py
import numpy as np
import pytest
from conftest import pgran as run_pgran

import pgran
from pgran.output import results, vtkhdf
from pgran.output.reading import FORMAT, ResultError


@pytest.fixture
def path(small_specimen):
    return small_specimen


def read(path):
    """Yield the grids of a file, one for each step, as VTK reads them."""
    import pyvista
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        yield pyvista.wrap(reader.GetOutput()).copy()


def agree(grid, fields):
    x = fields.pop("coordinates")
    np.testing.assert_array_equal(grid.points[:, :2], x.reshape(-1, 2))
    assert set(fields) == set(grid.point_data)
    for name, values in fields.items():
        found, flat = grid[name], values.reshape(len(grid.points), -1)
        if flat.shape[1] == 3:
            assert found.shape[1] == 9
            np.testing.assert_array_equal(found[:, [0, 4, 1]], flat)
            np.testing.assert_array_equal(found[:, 3], found[:, 1])
        elif flat.shape[1] == 2:
            np.testing.assert_array_equal(found[:, :2], flat)
            assert not found[:, 2].any()
        else:
            np.testing.assert_array_equal(found, flat[:, 0])


def test_vtk_reads_every_value_of_every_snapshot(path):
    grids = list(read(path))
    assert len(grids) == 2
    with h5py.File(path) as file:
        for grid, group in zip(grids, file["snapshots"].values()):
            assert set(grid.celltypes) == {vtkhdf.BIQUADRATIC_QUAD} and grid.n_cells == 48
            agree(grid, {name: data[...] for name, data in group.items()})
        assert list(file["VTKHDF/Steps/Values"]) == [
            group.attrs["time"] for group in file["snapshots"].values()]
        assert all(data.is_virtual for data in file["VTKHDF/PointData"].values())


def test_a_quadratic_field_is_shown_as_one(path):
    """Between its nodes VTK evaluates the biquadratic, not pieces of planes."""
    grid = next(read(path))
    grid.points[:, :2] = np.stack(np.meshgrid(np.linspace(0, 8, 9), np.linspace(0, 24, 25)),
                                  -1).reshape(-1, 2)
    grid["square"] = grid.points[:, 0]**2
    import pyvista
    probe = pyvista.PolyData([[0.3, 1.7, 0.0], [5.1, 20.3, 0.0]]).sample(grid)
    assert probe["square"] == pytest.approx([0.09, 26.01], abs=1e-6)


def test_a_ring_is_whole(tmp_path):
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 16, endpoint=False), [1.0, 1.5, 2.0])
    with h5py.File(tmp_path / "ring.h5", "w") as file:
        group = file.create_group("snapshots/0000")
        group.attrs["time"] = 0.0
        group["coordinates"] = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
        group["pressure"] = radius
        vtkhdf.link(file, (True, False))
    grid, = read(tmp_path / "ring.h5")
    assert grid.n_cells == 8
    agree(grid, {"coordinates": grid.points[:, :2].reshape(3, 16, 2), "pressure": radius})


def test_a_renamed_and_a_continued_file_are_whole(path, tmp_path):
    moved = tmp_path / "moved.h5"
    shutil.copy(path, moved)
    for checkpoint in path.parent.glob("small.checkpoint*"):
        shutil.copy(checkpoint, tmp_path / checkpoint.name.replace("small", "moved"))
    assert len(list(read(moved))) == 2
    run_pgran(0, "biaxial.opts", moved, "-pgran_width", 8, "-pgran_height", 24, "-pgran_restart",
              moved, "-pgran_compression", 0.0022)
    assert len(list(read(moved))) == 3


def test_every_dataset_has_its_unit(path):
    with h5py.File(path) as file:
        for group in (file["history"], *file["snapshots"].values()):
            for name, data in group.items():
                assert "unit" in data.attrs, name
        assert file["history/top_stress"].attrs["unit"] == "|sigma_1|"
        assert file["snapshots/0000/velocity"].attrs["unit"] == "d gdot0"
        assert file["history/newton_iterations"].attrs["unit"] == ""


def test_older_formats_are_read_and_later_ones_are_refused(path, tmp_path):
    old = tmp_path / "old.h5"
    shutil.copy(path, old)
    with h5py.File(old, "r+") as file:
        del file["VTKHDF"]
        file.attrs["format"] = 2
    assert len(pgran.open(old).snapshots) == 2
    assert results.FORMAT == FORMAT == 3
    with h5py.File(old, "r+") as file:
        file.attrs["format"] = FORMAT + 1
    with pytest.raises(ResultError, match="that of a later pgran"):
        pgran.open(old)
