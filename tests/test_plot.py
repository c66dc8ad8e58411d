"""Fields of a result, pictures, and the figures of the paper with their numbers."""

import shutil
from pathlib import Path

import h5py
import matplotlib
import numpy as np
import pytest
from conftest import run_ranks
from PIL import Image

from pgran import figures, plot, watch
from pgran.kinematics import PLANE, SOLID, SWIRL
from pgran.output import pictures
from pgran.output.result import QUANTITIES, Result, ResultError

#: Strains that files of earlier releases may lack.
STRAINS = "strain_rate_tensor", "strain_tensor", "spin", "volume_change"
CELL = "-pgran_case periodic -pgran_cell_elements 4"


@pytest.fixture(scope="module")
def path(small_specimen, tmp_path_factory):
    """A result of a small specimen with two snapshots."""
    folder = tmp_path_factory.mktemp("plot")
    shutil.copytree(small_specimen.parent, folder, dirs_exist_ok=True)
    return folder / small_specimen.name


@pytest.fixture
def snapshot(path):
    return Result(path).snapshots[-1]


def run(path, options):
    """Run on one rank; return the last snapshot."""
    run_ranks(0, "-m", "pgran", *options.split(), "-pgran_output", path)
    return Result(path).snapshots[-1]


def without_strains(path):
    """The last snapshot of a file, as if the file lacked the strains."""
    snapshot = Result(path).snapshots[-1]
    snapshot.names = tuple(name for name in snapshot.names if name not in STRAINS)
    return snapshot


def test_a_known_field_has_its_colours_at_its_positions(snapshot):
    snapshot._read["known"] = snapshot.x[..., 1] + 2.0 * snapshot.x[..., 0]
    figure = pictures.panels([snapshot], "known", pictures.Style((0.0, 40.0), outline=False))
    figure.canvas.draw()
    image = np.asarray(figure.canvas.buffer_rgba())[::-1, :, :3] / 255.0
    for x1, x2 in ((2.0, 3.0), (4.0, 12.0), (7.0, 20.0), (4.0, 24.1)):
        column, row = figure.axes[0].transData.transform((x1, x2)).astype(int)
        wanted = matplotlib.colormaps[pictures.COLOURS]((x2 + 2.0 * x1) / 40.0)[:3]
        wanted = wanted if x2 < 24.0 else (1.0, 1.0, 1.0)  # above the plate
        assert image[row, column] == pytest.approx(wanted, abs=0.03)


def test_snapshots_in_one_picture_have_one_colour_scale(path):
    snapshots = Result(path).snapshots
    for number, snapshot in enumerate(snapshots):
        snapshot._read["known"] = np.full(snapshot.x.shape[:2], float(number))
    figure = pictures.panels(snapshots, "known", pictures.Style())
    assert figure.axes[0].collections[0].norm is figure.axes[1].collections[0].norm


def test_computed_strains_equal_those_of_the_solver(path, snapshot):
    computed = without_strains(path)
    for name in ("strain_rate", "strain", "spin", "volume_change"):
        assert np.abs(snapshot[name]).max() > 1e-8
        np.testing.assert_allclose(computed[name], snapshot[name], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("axis, options", [
    (0, "-pgran_case vertical_chute -pgran_width 4 -pgran_height 4 -pgran_element_size 1"),
    (1, f"{CELL} -pgran_height 40")])
def test_gradients_are_periodic(tmp_path, axis, options):
    """A velocity field that is shifted by one element has a shifted strain rate."""
    path = tmp_path / "flow.h5"
    shape = run(path, f"{options} -ts_type beuler -ts_max_steps 1").x.shape
    velocity, found = np.random.default_rng(1).standard_normal(shape), []
    for shift in (0, 2):
        snapshot = without_strains(path)
        snapshot.keep({"velocity": np.roll(velocity, shift, axis)}, {"velocity": np.zeros(2)})
        found.append([snapshot["strain_rate"], snapshot["spin"]])
    for first, shifted in zip(*found):
        np.testing.assert_allclose(np.roll(first, 2, axis), shifted, atol=1e-6)


def test_one_element_in_a_periodic_direction_is_sufficient(tmp_path):
    snapshot = run(tmp_path / "one.h5", "-pgran_case planar_shear -pgran_width 1 -pgran_height 6 "
                   "-pgran_element_size 1 -pgran_model li -ts_type beuler -ts_max_steps 2")
    assert snapshot.x.shape == (13, 2, 2)
    assert snapshot["spin"] == pytest.approx(-snapshot["strain_rate"] / 2.0, abs=1e-9)
    assert snapshot["strain_rate"].mean() == pytest.approx(1.0, rel=0.2)
    _, values = pictures.along_line(snapshot, "velocity_1", (0.9, 0.0, 0.9, 6.0))
    assert np.isfinite(values).all() and values[-1] == pytest.approx(6.0)


def test_a_periodic_cell_has_the_strains_of_its_base_flow(tmp_path):
    snapshot = run(tmp_path / "cell.h5", f"{CELL} -ts_max_steps 2")
    assert snapshot["strain_rate"] == pytest.approx(1.0, abs=1e-10)
    for name, size in (("strain_rate_tensor", 1.0), ("strain_tensor", snapshot.time)):
        wanted = np.broadcast_to([size / 2.0, -size / 2.0, 0.0], snapshot[name].shape)
        np.testing.assert_allclose(snapshot[name], wanted, atol=1e-8 * size, rtol=1e-4)


def test_every_quantity_exists_and_is_drawn_in_every_format(path, snapshot):
    others = {f"stress_{label}" for label in {*SOLID.labels, *SWIRL.labels} - {*PLANE.labels}}
    for name in QUANTITIES:
        if name in {"velocity_3", "angular_velocity", *others}:
            with pytest.raises(ResultError, match="is undefined"):
                snapshot[name]
        else:
            assert np.isfinite(snapshot[name]).all()
    style = pictures.Style(band=True, arrows=True, mesh=True)
    for suffix in (".png", ".pdf", ".svg"):
        written, = pictures.pictures(path, "spin", style, suffix, -1)
        assert written.name.endswith(suffix) and written.stat().st_size > 3000


def test_labels_have_units(snapshot):
    result = snapshot.result
    for name, wanted in (("spin", r"$\omega$ ($\dot\gamma_0$)"), ("strain", r"$\gamma$"),
                         ("stress_tensor", r"stress_tensor ($|\sigma_1|$)")):
        assert pictures.label(result, name) == wanted
    assert result.history_units["work"] == "|sigma_1| d^2"
    assert pictures.with_unit("torque", "P_w d^2") == "torque ($P_w$ d$^2$)"


def test_a_profile_is_the_field_along_the_line(snapshot):
    snapshot._read["known"] = 3.0 * snapshot.x[..., 1]
    distance, values = pictures.along_line(snapshot, "known", (4.0, 2.0, 4.0, 22.0))
    assert values == pytest.approx(3.0 * (2.0 + distance))
    assert np.isnan(pictures.along_line(snapshot, "known", (4.0, 2.0, 4.0, 40.0))[1][-1])


def test_curves_profiles_and_movies_are_drawn(path, tmp_path, capsys):
    for words in (["-history", "top_stress,volume"], ["-line", "0,12,8,12"],
                  ["-together", "-format", "pdf"], ["-movie", str(tmp_path / "m.gif")]):
        assert plot.main([str(path), *words]) == 0
    names = capsys.readouterr().out.split()
    assert len(names) == 4 and all(Path(name).stat().st_size for name in names)
    with Image.open(tmp_path / "m.gif") as film:
        assert film.n_frames == 2


@pytest.mark.parametrize("words, message", [
    (["-format", "bmp"], "png | svg | pdf"), (["-snapshot", "7"], "holds 2 snapshots"),
    (["-limits", "2,1"], "the first number must be < the second"), (["-line", "1,2"], "4 numbers"),
    (["-movie", "x.avi"], "ends in .gif or .mp4"),
    (["-show"], "no display"), (["-field", "presure"], "no field presure; did you mean pressure?"),
    (["-field", "spin", "-log", "-limits", "-1,1"], "the colour scale must be > 0"),
    (["-field", "spin,velocity"], "-field velocity: not a scalar field; expected one of: "),
    (["-line", "20,0,30,0"], "-line 20,0,30,0: does not cross the material"),
    (["-line", "1,1,1,1"], "-line 1,1,1,1: the two points must differ"),
    (["-history", "top_stres"], "did you mean top_stress?")])
def test_invalid_options_of_plot_are_refused(path, words, message, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert plot.main([str(path), *words]) == 1
    assert message in capsys.readouterr().err


def test_the_history_of_a_steady_flow_is_drawn_over_its_steps(path, capsys):
    steady = path.with_name("steady.h5")
    shutil.copy(path, steady)
    with h5py.File(steady, "r+") as file:
        for name in ("time", "compression"):
            file["history"][name][...] = 0.0
        file.attrs["steady_residual"] = 1e-9
    assert plot.main([str(steady), "-history", "top_stress", "-format", "svg"]) == 0
    text = steady.with_name("steady_top_stress.svg").read_text()
    assert "step in pseudo-time" in text and "compression" not in text
    assert plot.main([str(steady), str(path), "-history", "top_stress"]) == 1
    assert "the histories have different horizontal axes: step" in capsys.readouterr().err
    assert watch.main([str(steady), "-once", "-column", "top_stress"]) == 0
    text = capsys.readouterr().out
    assert "steady flow" in text and "top_stress over step:" in text


def crossing(x):
    """I of two bands that cross at 51 and -51 degrees."""
    slope, middle = np.tan(np.radians(51.0)), x - [4.0, 12.0]
    return sum(np.exp(-((middle[..., 1] - sign * middle[..., 0]) / 1.5)**2)
               for sign in (-slope, slope))


@pytest.mark.parametrize("field, lines, wanted", [
    (crossing, 6, ["51.0°", "-51.0°"]),
    (lambda x: np.ones(x.shape[:2]), 0, ["no band: I exceeds half"])])
def test_a_picture_shows_the_measured_bands(snapshot, field, lines, wanted):
    x = np.stack(np.meshgrid(np.linspace(0.0, 8.0, 41), np.linspace(0.0, 24.0, 121)), axis=-1)
    snapshot._read.update(coordinates=x, inertial_number=field(x))
    axes = matplotlib.figure.Figure().subplots()
    pictures.band_line(axes, snapshot)
    text = axes.texts[0].get_text().replace("\n", " ")
    assert len(axes.lines) == lines and all(part in text for part in wanted)
    assert bool(lines) == ("°" in text)


def test_figures_of_the_theory_are_drawn_with_their_numbers(tmp_path, capsys):
    assert figures.main(["fig1", "fig2", "fig8", "fig9", "-output", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    for row in ("| quasi-static cut-off, mu_s = 0.3819 | 0.123 | 0.12265 |",
                "| IG, I0 = 0.1: unstable near the origin | no | no |",
                "unstable ones, I0 = 1 | quite different | 15.236 |",
                "| b I0 where the Bingham cut-off vanishes | 0.0158 | 0.015723 |"):
        assert row in text
    for name in ("fig1", "fig2", "fig8", "fig9"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10000
    with h5py.File(tmp_path / "fig2.h5") as file:
        assert file["k_cut"].shape == (200, 200)


@pytest.mark.parametrize("name, model, compression", [("fig6", "ngf", 0.1), ("fig7", "li", 0.01)])
def test_a_figure_of_simulations_shows_the_runs_that_exist(tmp_path, capsys, name, model,
                                                           compression):
    arguments = [name, "-results", str(tmp_path), "-output", str(tmp_path)]
    assert figures.main(arguments) == 1
    assert f"run bash jobs/study.sh section4 {name}" in capsys.readouterr().err
    x, y = np.meshgrid(np.linspace(0.0, 42.0, 21), np.linspace(0.0, 108.0, 61))
    for size in (2, 1):
        with h5py.File(tmp_path / f"{model}_L40_I0.001_h{size}.h5", "w") as file:
            file.attrs["options"] = (f"-pgran_model {model}\n-pgran_element_size {size:g}\n"
                                     "-pgran_inertial_number 0.001\n")
            group = file.create_group("snapshots/0000")
            group.attrs["compression"] = compression
            group["coordinates"] = np.stack([x, y], axis=-1)
            group["inertial_number"] = 4e-3 * np.exp(-((y - 54.0 - 1.23 * (x - 21.0)) / 15.0)**2)
    assert figures.main(arguments) == 0
    text = capsys.readouterr().out
    assert (tmp_path / f"{name}.png").stat().st_size > 10000
    assert f"not drawn, because the run is missing: {model}_L40_I0.001_h0.5" in text
    assert ("angle (degrees)" in text) != ("bands across the line at L/4" in text)
    with h5py.File(tmp_path / f"{name}.h5") as file:
        assert file["a/I"].shape == file["b/I"].shape == (61, 21)
