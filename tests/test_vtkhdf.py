"""A result opens in VTK as what it is: Q2 elements over time, with the same numbers."""

import shutil

import h5py
import numpy as np
import pytest
from conftest import ROOT, discretised, pgran as run_pgran, run_ranks

import pgran
from pgran.output import vtkhdf
from pgran.output.reader import FORMAT, ResultError
from pgran.output.result import numbers
from pgran.output.writer import Writer
from pgran.pack import pack

SIZE = "-pgran_width", 8, "-pgran_height", 24


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


def read_xdmf(path):
    """Yield the grids of the XDMF file of a result, one for each time."""
    import pyvista

    reader = pyvista.get_reader(path.with_suffix(".xdmf"))
    for time in reader.time_values:
        reader.set_active_time_value(time)
        grid = reader.read()
        while isinstance(grid, pyvista.MultiBlock):
            grid = grid[0]
        yield grid


def area(grid):
    """The area of all cells of a grid, d^2."""
    return grid.compute_cell_sizes(length=False, volume=False)["Area"].sum()


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


def test_xdmf_has_every_array_of_every_snapshot(path):
    with h5py.File(path) as file:
        groups = list(file["snapshots"].values())
        grids = list(read_xdmf(path))
        assert len(grids) == len(groups) == 2
        for grid, group in zip(grids, groups):
            assert set(grid.array_names) == set(group) - {"coordinates"}
            assert len(grid.array_names) == 11 and grid.n_cells == 8 * 24
            assert area(grid) == pytest.approx(8.0 * 24.0, rel=1e-3)
            for name, data in group.items():
                flat = data[...].reshape(grid.n_points, -1)
                found = grid.points if name == "coordinates" else (
                    grid[name].reshape(grid.n_points, -1))
                assert found.shape[1] == (1 if flat.shape[1] == 1 else 3)
                np.testing.assert_array_equal(found[:, :flat.shape[1]], flat)
                assert not found[:, flat.shape[1]:].any()


@pytest.mark.parametrize("case, shape, whole", [
    ("planar_shear", (13, 2), 6.0), ("vertical_chute", (2, 13), 6.0), ("periodic", (6, 6), 80.0)])
def test_a_periodic_grid_reaches_to_the_end_of_its_period(tmp_path, case, shape, whole):
    """The first nodes are repeated there, and the elements fill the domain."""
    path = tmp_path / "flow.h5"
    sizes = {"planar_shear": (1, 6), "vertical_chute": (6, 1), "periodic": (8, 10)}[case]
    more = {"periodic": ("-pgran_cell_elements", 3)}.get(
        case, ("-pgran_element_size", 1, "-pgran_model", "li", "-ts_type", "beuler"))
    run_ranks(2, "-m", "pgran", "-pgran_case", case, "-pgran_width", sizes[0], "-pgran_height",
              sizes[1], *more, "-ts_max_steps", 2, "-pgran_output", path)
    snapshot, grid = pgran.open(path).snapshots[-1], list(read(path))[-1]
    assert snapshot.x.shape[:2] == shape
    assert area(grid) == pytest.approx(whole, rel=1e-9)
    assert area(snapshot.grid()) == pytest.approx(whole, rel=1e-9)
    ny, nx = shape
    right, top = case != "vertical_chute", case != "planar_shear"
    high, wide = ny + int(top), nx + int(right)
    place = numbers(shape, (right, top))  # the repeated nodes come last
    x, v = grid.points[place][..., :2], grid["velocity"][place][..., :2]
    assert place.shape == (high, wide)
    np.testing.assert_array_equal(x[:ny, :nx], snapshot.x)
    np.testing.assert_array_equal(v[:ny, :nx], snapshot["velocity"])
    base = np.diag([0.5, -0.5]) if case == "periodic" else np.zeros((2, 2))
    for ends, (first, last) in ((right, (x[:, 0], x[:, -1])), (top, (x[0], x[-1]))):
        period = last - first
        if ends:
            assert period == pytest.approx(np.broadcast_to(period[0], period.shape), abs=1e-12)
            assert np.abs(period[0]).max() > 0.9
    if right:
        np.testing.assert_allclose(v[:, -1] - v[:, 0], (x[:, -1] - x[:, 0]) @ base, atol=1e-9)
    if top:
        np.testing.assert_allclose(v[-1] - v[0], (x[-1] - x[0]) @ base, atol=1e-9)
    for name in ("pressure", "stress_tensor"):
        values = grid[name].reshape(grid.n_points, -1)[place]
        columns = [0, 4, 1] if values.shape[2] == 9 else [0]
        np.testing.assert_array_equal(
            values[:ny, :nx][..., columns], snapshot[name].reshape(ny, nx, -1))
        if right:
            np.testing.assert_array_equal(values[:, -1], values[:, 0])
        if top:
            np.testing.assert_array_equal(values[-1], values[0])


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
    for snapshot in path.parent.glob("small.snapshot*"):
        shutil.copy(snapshot, tmp_path)
    for checkpoint in path.parent.glob("small.checkpoint*"):
        shutil.copy(checkpoint, tmp_path / checkpoint.name.replace("small", "moved"))
    assert len(list(read(moved))) == 2
    run_pgran(0, "biaxial.opts", moved, "-pgran_width", 8, "-pgran_height", 24, "-pgran_restart",
              moved, "-pgran_compression", 0.0022)
    assert len(list(read(moved))) == 3


def test_a_run_that_goes_on_from_a_file_without_a_field_leaves_it_out_of_both(path, tmp_path):
    """As an earlier release wrote it: arrays that only the later snapshots have are not shown."""
    older = tmp_path / "older.h5"
    pack(path, older)
    for found in path.parent.glob("small.checkpoint*"):
        shutil.copy(found, tmp_path / found.name.replace("small", "older"))
    with h5py.File(older, "r+") as file:
        del file["cells"]
        for group in file["snapshots"].values():
            del group["spin"]
    run_pgran(1, "biaxial.opts", older, *SIZE, "-pgran_restart", older, "-pgran_compression",
              0.0022, "-pgran_progress", "quiet")
    grids = [*read_xdmf(older), *read(older)]
    assert len(grids) == 6
    assert all("spin" not in grid.point_data and len(grid.point_data) == 10 for grid in grids)
    assert "spin" in pgran.open(older).snapshots[-1].names


def test_every_dataset_has_its_unit(path):
    with h5py.File(path) as file:
        for group in (file["history"], *file["snapshots"].values()):
            for name, data in group.items():
                assert "unit" in data.attrs, name
        units = {name: data.attrs["unit"] for group in (file["history"], file["snapshots/0000"])
                 for name, data in group.items()}
        assert {name: unit for name, unit in units.items() if unit} == {
            "time": "1/gdot0", "step_size": "1/gdot0", "work": "|sigma_1| d^2",
            "dissipation": "|sigma_1| d^2", "stored_energy": "|sigma_1| d^2", "volume": "d^2",
            "top_stress": "|sigma_1|", "coordinates": "d", "velocity": "d gdot0",
            "fluidity": "gdot0", "pressure": "|sigma_1|", "deviator": "|sigma_1|",
            "stress_tensor": "|sigma_1|", "strain_rate_tensor": "gdot0", "spin": "gdot0"}
        assert not {"energy_error", "compression", "strain_tensor", "volume_change"} - set(units)
        for name, unit in (("seconds", "s"), ("memory", "MB"), ("begun", "s")):
            assert file.attrs[f"{name}_unit"] == unit


def test_a_file_with_a_wrong_unit_has_the_right_one_once_a_run_goes_on(path, tmp_path):
    older = tmp_path / "older.h5"
    pack(path, older)
    for found in path.parent.glob("small.checkpoint*"):
        shutil.copy(found, tmp_path / found.name.replace("small", "older"))
    with h5py.File(older, "r+") as file:
        file["history/energy_error"].attrs["unit"] = "|sigma_1| d^2"
    run_pgran(1, "biaxial.opts", older, *SIZE, "-pgran_restart", older, "-pgran_compression",
              0.0022, "-pgran_progress", "quiet")
    assert pgran.open(older).history_units["energy_error"] == ""


@pytest.mark.parametrize("case, units", [
    ("planar_shear", {"shear_stress": "P_w"}), ("annular_shear", {"torque": "P_w d^2"}),
    ("vertical_chute", {"shear_stress": "P_w", "mean_speed": "d gdot0"}),
    ("inclined_plane", {"shear_stress": "phi rho_s G d", "surface_speed": "d gdot0"}),
    (f"{ROOT}/docs/examples/planar_shear.py:PlanarShear", {"shear_stress": "P_w"})])
def test_observables_have_their_units(tmp_path, case, units):
    form = discretised(case=case)
    writer = Writer(tmp_path / "run.h5", form)
    writer.begin()
    writer.close()
    found = pgran.open(tmp_path / "run.h5").history_units
    assert {name: found[name] for name in form.case.observables} == units


def test_older_formats_are_read_and_later_ones_are_refused(path, tmp_path):
    old = tmp_path / "old.h5"
    pack(path, old)
    with h5py.File(old, "r+") as file:
        del file["VTKHDF"]
        file.attrs["format"] = 2
    assert len(pgran.open(old).snapshots) == 2
    assert FORMAT == FORMAT == 4
    with h5py.File(old, "r+") as file:
        file.attrs["format"] = FORMAT + 1
    with pytest.raises(ResultError, match="that of a later pgran"):
        pgran.open(old)
