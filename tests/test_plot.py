"""What is in a picture: known fields give known colours at known places."""

import shutil

import h5py
import matplotlib
import numpy as np
import pytest
from conftest import run_ranks

import pgran
from pgran import plot, watch
from pgran.output import pictures
from pgran.output.reader import ResultError
from pgran.output.result import QUANTITIES, Result, q2_elements


@pytest.fixture(scope="module")
def path(small_specimen, tmp_path_factory):
    """A result of a small specimen; two snapshots."""
    folder = tmp_path_factory.mktemp("plot")
    for file in small_specimen.parent.glob("*.h5"):
        shutil.copy(file, folder)
    return folder / small_specimen.name


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


#: The strains that a file of an earlier release may lack.
STRAINS = "strain_rate_tensor", "strain_tensor", "spin", "volume_change"


def lacking(snapshot, *names):
    """Return the snapshot as if its file lacked fields."""
    snapshot.names = tuple(name for name in snapshot.names if name not in names)
    return snapshot


def run(path, *options):
    """Make a run on one rank; return its last snapshot."""
    run_ranks(0, "-m", "pgran", *options, "-pgran_output", path, "-pgran_progress", "quiet")
    return Result(path).snapshots[-1]


def test_strains_of_a_file_that_lacks_them_are_those_of_the_solver(path):
    stored, computed = Result(path).snapshots[-1], lacking(Result(path).snapshots[-1], *STRAINS)
    for name in ("strain_rate", "strain", "spin", "volume_change"):
        assert np.abs(stored[name]).max() > 1e-8
        np.testing.assert_allclose(computed[name], stored[name], rtol=1e-9, atol=1e-12)


def test_gradients_of_a_quadratic_velocity_are_exact(snapshot):
    x1, x2 = np.moveaxis(snapshot.x, -1, 0)
    snapshot._read["velocity"] = np.stack([x1 * x2, x1**2], axis=-1)
    (l11, l12), (l21, l22) = lacking(snapshot, *STRAINS).velocity_gradient
    for found, wanted in ((l11, x2), (l12, x1), (l21, 2.0 * x1), (l22, 0.0 * x1)):
        np.testing.assert_allclose(found, wanted, atol=0.03)  # the mesh is curved by 1e-3
    assert snapshot["spin"] == pytest.approx((l21 - l12) / 2.0)


@pytest.mark.parametrize("case", ["planar_shear", "vertical_chute", "cell"])
def test_gradients_at_the_ends_of_a_period_are_those_between_them(tmp_path, case):
    """A velocity that is moved around the grid by an element has its strain rate moved."""
    cell = ("-pgran_case", "periodic", "-pgran_cell_elements", 4, "-pgran_height", 40)
    flow = ("-pgran_case", case, "-pgran_width", 4, "-pgran_height", 4, "-pgran_element_size", 1)
    shape = run(tmp_path / "flow.h5", *(cell if case == "cell" else flow), "-ts_type", "beuler",
                "-ts_max_steps", 1).x.shape
    axis = 0 if case == "vertical_chute" else 1
    velocity, found = np.random.default_rng(1).standard_normal(shape), []
    for shift in (0, 2):
        snapshot = lacking(Result(tmp_path / "flow.h5").snapshots[-1], *STRAINS)
        snapshot.keep({"velocity": np.roll(velocity, shift, axis)}, {"velocity": np.zeros(2)})
        found.append([snapshot["strain_rate"], snapshot["spin"]])
    for first, moved in zip(*found):
        np.testing.assert_allclose(np.roll(first, 2, axis), moved, atol=1e-6)


def test_one_element_across_a_periodic_direction_is_enough(tmp_path):
    """Shear of a layer of one element: rate and spin along the height, a picture, and cells."""
    from PIL import Image

    snapshot = run(tmp_path / "one.h5", "-pgran_case", "planar_shear", "-pgran_width", 1,
                   "-pgran_height", 6, "-pgran_element_size", 1, "-pgran_model", "li",
                   "-ts_type", "beuler", "-ts_max_steps", 2)
    assert snapshot.x.shape == (13, 2, 2)
    for name in ("strain_rate", "spin"):
        older = lacking(Result(snapshot.result.path).snapshots[-1], *STRAINS)
        np.testing.assert_allclose(snapshot[name], older[name], atol=1e-12)
    assert snapshot["spin"] == pytest.approx(-snapshot["strain_rate"] / 2.0, abs=1e-9)
    assert snapshot["strain_rate"].mean() == pytest.approx(1.0, rel=0.2)
    grid = snapshot.grid("pressure", "velocity")
    assert grid.n_cells == 6
    assert grid.compute_cell_sizes(length=False, volume=False)["Area"].sum() == pytest.approx(6.0)
    picture, = pictures.pictures(snapshot.result.path, "strain_rate", which=-1)
    assert np.ptp(np.asarray(Image.open(picture).convert("L"))) > 100
    distance, values = pictures.along_line(snapshot, "velocity_1", (0.9, 0.0, 0.9, 6.0))
    assert np.isfinite(values).all() and values[-1] == pytest.approx(6.0)


def test_a_strain_that_cannot_be_had_says_why(tmp_path):
    cell = ("-pgran_case", "periodic", "-pgran_cell_elements", 2, "-ts_max_steps", 1)
    snapshot = lacking(run(tmp_path / "cell.h5", *cell), *STRAINS)
    snapshot.keep({}, {"coordinates": np.zeros((2, 2)), "velocity": np.zeros((2, 2))})
    with pytest.raises(ResultError, match="lacks the period of its grid"):
        snapshot["spin"]


def test_derived_quantities_are_those_of_homogeneous_compression(snapshot):
    """Velocity (x1/2, -x2/2) and height H exp(-t/2): no spin, strain t, no volume change."""
    x, (ny, nx) = lacking(snapshot, *STRAINS).x, snapshot.x.shape[:2]
    snapshot._read["velocity"] = np.stack([x[..., 0] / 2.0, -x[..., 1] / 2.0], axis=-1)
    assert snapshot["strain_rate"] == pytest.approx(np.ones((ny, nx)))
    assert snapshot["spin"] == pytest.approx(np.zeros((ny, nx)), abs=1e-12)
    time, start = 0.3, np.stack(np.meshgrid(np.linspace(0, 8, nx), np.linspace(0, 24, ny)), -1)
    snapshot = lacking(Result(snapshot.result.path).snapshots[-1], *STRAINS)
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


def test_labels_have_the_units_of_what_they_name(snapshot):
    result = snapshot.result
    for name, wanted in (("spin", r"$\omega$ ($\dot\gamma_0$)"), ("strain", r"$\gamma$"),
                         ("speed", r"$|v|$ (d $\dot\gamma_0$)"),
                         ("pressure", r"$P$ ($|\sigma_1|$)"),
                         ("stress_tensor", r"stress_tensor ($|\sigma_1|$)")):
        assert pictures.label(result, name) == wanted
    for name, unit in (("work", "|sigma_1| d^2"), ("energy_error", ""), ("time", "1/gdot0")):
        assert result.history_units[name] == unit
    assert pictures.with_unit("torque", "P_w d^2") == "torque ($P_w$ d$^2$)"


def test_the_distance_to_yield_needs_a_yield_value(snapshot, monkeypatch):
    monkeypatch.setattr(type(snapshot.result.case.law), "yield_ratio", 0.0)
    with pytest.raises(ResultError, match="its law bingham has no yield value"):
        snapshot["above_yield"]


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
    (["-field", "spin", "-log", "-limits", "-1,1"], "has no logarithm"),
    (["-field", "presure"], "has no field presure; did you mean pressure?"),
    (["-field", "spin,velocity"], "-field velocity: it has several components at a point; allowed "
     "are speed, velocity_1, velocity_2"),
    (["-field", "deviator"], "-field deviator: it has several components at a point"),
    (["-field", "presure", "-line", "0,12,8,12"], "did you mean pressure?"),
    (["-line", "20,0,30,0"], "-line 20,0,30,0: the line does not meet the body"),
    (["-line", "20,0,30,0"], "x2 = 0 to 23.95 d"),
    (["-line", "1,1,1,1"], "-line 1,1,1,1: the two points must differ"),
    (["-history", "top_stres"], "did you mean top_stress?")])
def test_what_cannot_be_drawn_is_refused(path, given, wanted, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert plot.main([str(path), *given]) == 1
    assert wanted in capsys.readouterr().err


def steady_result(path):
    """A copy of a result whose steps all have the same time, as those in pseudo-time have."""
    steady = path.with_name("steady.h5")
    shutil.copy(path, steady)
    with h5py.File(steady, "r+") as file:
        for name in ("time", "compression"):
            file["history"][name][...] = 0.0
        file.attrs["steady_residual"] = 1e-9
    return steady


def test_the_history_of_a_steady_flow_is_drawn_against_its_steps(path, capsys):
    steady = steady_result(path)
    name, values = Result(steady).progress()
    steps = len(Result(path).history["time"])
    assert name == "step" and list(values) == list(range(1, steps + 1))
    assert Result(path).progress()[0] == "compression" and not Result(path).steady
    assert plot.main([str(steady), "-history", "top_stress", "-format", "svg"]) == 0
    text = steady.with_name("steady_top_stress.svg").read_text()
    assert "step in pseudo-time" in text and "compression" not in text
    assert plot.main([str(steady), str(path), "-history", "top_stress"]) == 1
    assert "is drawn against step, and that of" in capsys.readouterr().err
    assert watch.main([str(steady), "-once", "-column", "top_stress"]) == 0
    text = capsys.readouterr().out
    assert "steady flow" in text and "top_stress over step:" in text


def crossing(x):
    """I of two bands that cross at 51 and -51 degrees, in the specimen of `SMALL`."""
    slope, middle = np.tan(np.radians(51.0)), x[..., 1] - 12.0
    return sum(np.exp(-((middle - sign * slope * (x[..., 0] - 4.0)) / 1.5)**2)
               for sign in (-1.0, 1.0))


@pytest.mark.parametrize("field, lines, wanted", [
    (crossing, 6, ["51.0°", "-51.0°"]),
    (lambda x: np.exp(-((x - [4.0, 12.0])**2).sum(axis=-1)), 0, ["no band: "]),
    (lambda x: np.ones(x.shape[:2]), 0, ["no band: I exceeds half"])])
def test_a_picture_shows_the_bands_that_are_there_and_no_other(snapshot, field, lines, wanted):
    x, y = np.meshgrid(np.linspace(0.0, 8.0, 41), np.linspace(0.0, 24.0, 121))
    x = np.stack([x, y], axis=-1)
    snapshot._read.update(coordinates=x, inertial_number=field(x))
    axes = matplotlib.figure.Figure().subplots()
    pictures.band_line(axes, snapshot)
    assert len(axes.lines) == lines
    text = axes.texts[0].get_text().replace("\n", " ")
    assert all(part in text for part in wanted)
    assert lines or "°" not in text
