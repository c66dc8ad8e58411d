"""What is in a picture: known fields give known colours at known places."""

import shutil
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from conftest import run_ranks

import pgran
from pgran import plot
from pgran.output import pictures
from pgran.output.result import QUANTITIES, Result, nodal_slope, q2_elements


@pytest.fixture(scope="module")
def path(small_specimen, tmp_path_factory):
    """A result of a small specimen; two snapshots."""
    return Path(shutil.copy(small_specimen, tmp_path_factory.mktemp("plot")))


@pytest.fixture
def snapshot(path):
    return Result(path).snapshots[-1]


def colour(figure, axes, x):
    """The colour (4,) of a drawn figure at coordinates of axes."""
    figure.canvas.draw()
    image = np.asarray(figure.canvas.buffer_rgba())
    column, row = axes.transData.transform(x)
    return image[image.shape[0] - 1 - int(row), int(column)] / 255.0


def test_a_known_field_has_its_colours_at_its_places(snapshot):
    x = snapshot.x
    snapshot._read["known"] = x[..., 1] + 2.0 * x[..., 0]
    figure = pictures.panels([snapshot], "known", pictures.Style((0.0, 40.0), outline=False))
    norm, shades = matplotlib.colors.Normalize(0.0, 40.0), matplotlib.colormaps[pictures.COLOURS]
    for at in ((2.0, 3.0), (4.0, 12.0), (7.0, 20.0)):
        wanted = shades(norm(at[1] + 2.0 * at[0]))
        assert colour(figure, figure.axes[0], at) == pytest.approx(wanted, abs=0.03)
    assert colour(figure, figure.axes[0], (4.0, 24.1))[:3] == pytest.approx(1.0)  # above the plate


def test_files_side_by_side_have_one_scale(path):
    first, last = Result(path).snapshots
    for number, snapshot in enumerate((first, last)):
        snapshot._read["known"] = np.full(snapshot.x.shape[:2], float(number))
    figure = pictures.panels([first, last], "known", pictures.Style(outline=False))
    shades = matplotlib.colormaps[pictures.COLOURS]
    for axes, share in zip(figure.axes, (0.0, 1.0)):
        assert colour(figure, axes, (4.0, 10.0)) == pytest.approx(shades(share), abs=0.02)


def test_gradients_are_those_of_the_parabolas_of_elements():
    x = np.linspace(0.0, 1.0, 9)
    field = np.outer(np.ones(3), x**2)
    assert nodal_slope(field, 1)[0] == pytest.approx(2.0 * x / 8.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    slope = nodal_slope(np.sin(angle)[None], 1, closed=True)[0] * 32.0 / np.pi
    assert slope == pytest.approx(np.cos(angle), abs=4e-3)


def test_derived_quantities_are_those_of_homogeneous_compression(snapshot):
    """Velocity (x1/2, -x2/2) and height H exp(-t/2): no spin, strain t, no volume change."""
    x, (ny, nx) = snapshot.x, snapshot.x.shape[:2]
    snapshot._read["velocity"] = np.stack([x[..., 0] / 2.0, -x[..., 1] / 2.0], axis=-1)
    assert snapshot["strain_rate"] == pytest.approx(np.ones((ny, nx)))
    assert snapshot["spin"] == pytest.approx(np.zeros((ny, nx)), abs=1e-12)
    time, start = 0.3, np.stack(np.meshgrid(np.linspace(0, 8, nx), np.linspace(0, 24, ny)), -1)
    snapshot._read["coordinates"] = start * [np.exp(time / 2.0), np.exp(-time / 2.0)]
    assert snapshot["strain"] == pytest.approx(np.full((ny, nx), time))
    assert snapshot["volume_change"] == pytest.approx(np.zeros((ny, nx)), abs=1e-12)
    assert snapshot["stress_11"] + snapshot["stress_22"] == pytest.approx(
        -2.0 * snapshot["pressure"], abs=5e-3)  # div v = 0 holds weakly


def test_a_base_flow_is_counted_once(tmp_path):
    """A periodic cell at rest in its base flow: D = diag(1, -1)/2, and the strain of two steps."""
    run_ranks(0, "-m", "pgran", "-pgran_case", "periodic", "-pgran_cell_elements", 4,
              "-ts_max_steps", 2, "-pgran_output", tmp_path / "cell.h5")
    snapshot = Result(tmp_path / "cell.h5").snapshots[-1]
    assert snapshot["strain_rate"] == pytest.approx(1.0, abs=1e-10)
    for name, size in (("strain_rate_tensor", 1.0), ("strain_tensor", snapshot.time)):
        wanted = np.broadcast_to([size / 2.0, -size / 2.0, 0.0], snapshot[name].shape)
        np.testing.assert_allclose(snapshot[name], wanted, atol=1e-8 * size, rtol=1e-4)


def test_pyvista_has_the_elements_as_biquadratic_ones(snapshot):
    grid = snapshot.grid()
    assert set(grid.celltypes) == {28} and grid.n_cells == 4 * 12
    assert grid["velocity"].shape == (grid.n_points, 3)
    assert grid["pressure"] == pytest.approx(snapshot["pressure"].ravel())
    middle = grid.compute_cell_sizes(length=False, volume=False)["Area"].sum()
    assert middle == pytest.approx(8.0 * 24.0, rel=1e-3)  # as deformation keeps the volume


def test_a_ring_has_elements_all_around():
    elements = q2_elements((5, 8), (True, False))
    assert len(elements) == 4 * 2 and set(elements.ravel()) == set(range(40))


def test_every_quantity_is_there_and_drawn_in_every_format(path, snapshot):
    assert all(np.isfinite(snapshot[name]).all() for name in QUANTITIES)
    style = pictures.Style(band=True, arrows=True, mesh=True)
    for name, suffix in (("speed", ".png"), ("spin", ".svg"), ("spin", ".pdf")):
        written, = pictures.pictures(path, name, style, suffix, -1)
        assert written.name.endswith(suffix) and written.stat().st_size > 3000
    text = path.with_name(f"small_spin_{Result(path).snapshots[-1].name}.svg").read_text()
    assert "omega" in text or "ω" in text


def test_a_profile_is_the_field_along_the_line(snapshot):
    snapshot._read["known"] = 3.0 * snapshot.x[..., 1]
    distance, values = pictures.along_line(snapshot, "known", (4.0, 2.0, 4.0, 22.0))
    assert values == pytest.approx(3.0 * (2.0 + distance))
    _, beyond = pictures.along_line(snapshot, "known", (4.0, 2.0, 4.0, 40.0))
    assert np.isnan(beyond[-1])


def test_curves_and_movies_are_made(path, tmp_path, capsys):
    for given in (["-history", "top_stress,volume"], ["-line", "0,12,8,12"],
                  ["-movie", str(tmp_path / "m.gif")], ["-together", "-format", "pdf"]):
        assert plot.main([str(path), *given]) == 0
    names = [line for line in capsys.readouterr().out.splitlines() if line]
    assert len(names) == 4 and all(pgran.output.result.Path(name).stat().st_size for name in names)
    from PIL import Image
    with Image.open(tmp_path / "m.gif") as film:
        assert film.n_frames == 2


@pytest.mark.parametrize("given, wanted", [
    (["-field", "nosuch"], "has no field nosuch"), (["-format", "bmp"], "allowed is png | svg"),
    (["-snapshot", "7"], "holds 2 snapshots"), (["-limits", "1"], "allowed are 2 numbers"),
    (["-limits", "2,1"], "the first must be the smaller one"),
    (["-line", "1,2"], "allowed are 4 numbers"), (["-history", "nosuch"], "-history nosuch"),
    (["-movie", "x.avi"], "allowed are files .gif or .mp4"), (["-show"], "there is no display"),
    (["-field", "spin", "-log", "-limits", "-1,1"], "has no logarithm")])
def test_what_cannot_be_drawn_is_refused(path, given, wanted, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert plot.main([str(path), *given]) == 1
    assert wanted in capsys.readouterr().err
