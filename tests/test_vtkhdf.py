"""VTK, pyvista and XDMF show a result as Q2 elements over time with the stored values and units."""

import shutil

import h5py
import numpy as np
import pytest
import pyvista
from conftest import ROOT, discretised, pgran as run_pgran, read_vtk, run_ranks

import pgran
from pgran.output import vtkhdf
from pgran.output.connectivity import numbers
from pgran.output.reader import ResultError
from pgran.output.writer import Writer
from pgran.pack import pack


def read_xdmf(path):
    """Yield the grids of the XDMF file of a result."""
    reader = pyvista.get_reader(path.with_suffix(".xdmf"))
    for time in reader.time_values:
        reader.set_active_time_value(time)
        grid = reader.read()
        while isinstance(grid, pyvista.MultiBlock):
            grid = grid[0]
        yield grid


def read_grids(path):
    """Return the grids of `Snapshot.grid`."""
    return [snapshot.grid() for snapshot in pgran.open(path).snapshots]


def area(grid):
    """The area of all cells of a grid, d^2."""
    return grid.compute_cell_sizes(length=False, volume=False)["Area"].sum()


def assert_values(grid, group, tensors):
    """Assert that a grid has all fields of a snapshot; ``tensors`` are columns of tensors."""
    assert set(grid.point_data) == set(group) - {"coordinates"}
    for name, data in group.items():
        values = data[...].reshape(grid.n_points, -1)
        found = grid.points if name == "coordinates" else grid[name].reshape(grid.n_points, -1)
        if values.shape[1] == 3:
            np.testing.assert_array_equal(found[:, tensors], values)
        else:
            np.testing.assert_array_equal(found[:, :values.shape[1]], values)
            assert not found[:, values.shape[1]:].any()


@pytest.mark.parametrize("read, cells, tensors", [
    (read_vtk, 48, [0, 4, 1]), (read_vtk, 48, [0, 4, 3]), (read_xdmf, 192, [0, 1, 2]),
    (read_grids, 48, [0, 1, 2])])
def test_every_value_of_every_snapshot_is_read(small_specimen, read, cells, tensors):
    grids = list(read(small_specimen))
    xdmf = pyvista.get_reader(small_specimen.with_suffix(".xdmf"))
    with h5py.File(small_specimen) as file:
        assert len(grids) == len(file["snapshots"]) == 2
        for grid, group in zip(grids, file["snapshots"].values()):
            assert len(group) == 12 and grid.n_cells == cells
            assert read == read_xdmf or set(grid.celltypes) == {vtkhdf.BIQUADRATIC_QUAD}
            assert area(grid) == pytest.approx(8.0 * 24.0, rel=1e-3)
            assert_values(grid, group, tensors)
        times = [group.attrs["time"] for group in file["snapshots"].values()]
        assert list(file["VTKHDF/Steps/Values"]) == times
        assert xdmf.time_values == pytest.approx(times, rel=1e-15)
        assert all(data.is_virtual for data in file["VTKHDF/PointData"].values())


@pytest.mark.parametrize("case, shape, size, options", [
    ("vertical_chute", (2, 13), (6, 1), "-pgran_element_size 1 -pgran_model li -ts_type beuler"),
    ("periodic", (6, 6), (8, 10), "-pgran_cell_elements 3")])
def test_a_periodic_grid_extends_to_the_end_of_its_period(path, case, shape, size, options):
    run_ranks(2, "-m", "pgran", "-pgran_case", case, "-pgran_width", size[0], "-pgran_height",
              size[1], *options.split(), "-ts_max_steps", 2, "-pgran_output", path)
    snapshot = pgran.open(path).snapshots[-1]
    *_, grid = read_vtk(path)
    assert snapshot.x.shape[:2] == shape
    for found in (grid, snapshot.grid()):
        assert area(found) == pytest.approx(np.prod(size), rel=1e-9)
    (ny, nx), both = shape, case == "periodic"
    node = numbers(shape, (both, True))
    base = both * np.diag([0.5, -0.5])
    x, v = grid.points[node][..., :2], grid["velocity"][node][..., :2]
    pressure = grid["pressure"][node]
    stress = grid["stress_tensor"][node].reshape(*node.shape, 9)[..., [0, 4, 1]]
    for found, name in ((x, "coordinates"), (v, "velocity"), (pressure, "pressure"),
                        (stress, "stress_tensor")):
        np.testing.assert_array_equal(found[:ny, :nx], snapshot[name])
    for axis in range(1 + both):
        change_x, change_v, change_p, change_s = (
            np.take(field, -1, axis) - np.take(field, 0, axis)
            for field in (x, v, pressure, stress))
        assert np.abs(change_x[0]).max() > 0.9
        np.testing.assert_allclose(change_x - change_x[0], 0.0, atol=1e-12)
        np.testing.assert_allclose(change_v, change_x @ base, atol=1e-9)
        assert not change_p.any() and not change_s.any()


def test_the_elements_of_a_ring_close_it(path):
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 16, endpoint=False), [1.0, 1.5, 2.0])
    with h5py.File(path, "w") as file:
        group = file.create_group("snapshots/0000")
        group.attrs["time"] = 0.0
        group["coordinates"] = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
        group["pressure"] = radius
        vtkhdf.link(file, (True, False))
    grid, = read_vtk(path)
    assert grid.n_cells == 8
    with h5py.File(path) as file:
        assert_values(grid, file["snapshots/0000"], None)


def test_a_continued_file_shows_only_fields_of_all_snapshots_and_has_the_right_units(
        small_specimen, tmp_path):
    older = tmp_path / "older.h5"
    pack(small_specimen, older)
    for found in small_specimen.parent.glob("small.checkpoint*"):
        shutil.copy(found, tmp_path / found.name.replace("small", "older"))
    with h5py.File(older, "r+") as file:
        file.attrs["format"] = 3
        del file["cells"]
        for group in file["snapshots"].values():
            del group["spin"]
        file["history/energy_error"].attrs["unit"] = "|sigma_1| d^2"
    run_pgran(0, "biaxial.opts", older, width=8, height=24, restart=older, compression=0.0022)
    grids = [*read_xdmf(older), *read_vtk(older)]
    assert len(grids) == 6
    assert all("spin" not in grid.point_data and len(grid.point_data) == 10 for grid in grids)
    result = pgran.open(older)
    assert "spin" in result.snapshots[-1].names and result.history_units["energy_error"] == ""


def test_every_dataset_has_its_unit(small_specimen):
    with h5py.File(small_specimen) as file:
        units = {name: data.attrs["unit"] for group in (file["history"], file["snapshots/0000"])
                 for name, data in group.items()}
        assert {name: unit for name, unit in units.items() if unit} == {
            "time": "1/gdot0", "step_size": "1/gdot0", "work": "|sigma_1| d^2",
            "dissipation": "|sigma_1| d^2", "stored_energy": "|sigma_1| d^2", "volume": "d^2",
            "top_stress": "|sigma_1|", "coordinates": "d", "velocity": "d gdot0",
            "fluidity": "gdot0", "pressure": "|sigma_1|", "deviator": "|sigma_1|",
            "stress_tensor": "|sigma_1|", "strain_rate_tensor": "gdot0", "spin": "gdot0"}
        assert {"energy_error", "compression", "strain_tensor", "volume_change"} <= set(units)
        for name, unit in (("seconds", "s"), ("memory", "MB"), ("begun", "s")):
            assert file.attrs[f"{name}_unit"] == unit


@pytest.mark.parametrize("case, units", [
    ("planar_shear", {"shear_stress": "P_w"}), ("annular_shear", {"torque": "P_w d^2"}),
    ("vertical_chute", {"shear_stress": "P_w", "mean_speed": "d gdot0"}),
    ("inclined_plane", {"shear_stress": "phi rho_s G d", "surface_speed": "d gdot0"}),
    (f"{ROOT}/docs/examples/planar_shear.py:PlanarShear", {"shear_stress": "P_w"})])
def test_observables_have_their_units(path, case, units):
    form = discretised(case=case)
    writer = Writer(path, form)
    writer.begin()
    writer.close()
    found = pgran.open(path).history_units
    assert {name: found[name] for name in form.case.observables} == units


@pytest.mark.parametrize("number, message", [
    (2, "a release older than 0.2"), (5, "a later version of pgran")])
def test_other_formats_are_refused(small_specimen, path, number, message):
    with h5py.File(shutil.copy(small_specimen, path), "r+") as file:
        file.attrs["format"] = number
    with pytest.raises(ResultError, match=message):
        pgran.open(path)
