"""Bands of known angle and width are measured as such, on deformed meshes too."""

import json

import h5py
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pgran import measure
from pgran.output import band


def specimen(deformed, nx=41, ny=121):
    """Nodes of a specimen of 40 d x 108 d, plain or sheared and bulged."""
    x, y = np.meshgrid(np.linspace(0.0, 40.0, nx), np.linspace(0.0, 108.0, ny))
    if deformed:
        x, y = (x + 4.0 * np.tanh((y - 54.0) / 15.0) + 0.5 * np.sin(y / 9.0),
                y + 0.3 * np.sin(x / 5.0) * np.sin(np.pi * y / 108.0))
    return np.stack([x, y], axis=-1)


def gaussian_band(x, angle, width, centre=(20.0, 54.0)):
    """I of a band of full width at half maximum ``width``, 4e-3 at its middle."""
    normal = np.array([-np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    distance = (x - np.array(centre)) @ normal
    return 4e-3 * np.exp(-4.0 * np.log(2.0) * (distance / width)**2)


def angle_between(one, other):
    """The angle between two lines, degrees."""
    return abs((one - other + 90.0) % 180.0 - 90.0)


def distance_from_line(point, angle, centre):
    """The distance of a point from the line at an angle through ``centre``."""
    angle = np.radians(angle)
    return abs((np.array(point) - centre) @ [-np.sin(angle), np.cos(angle)])


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("angle", [0, 10, 20, 35, 45, 51, 60, 66, 70, 75, 80, 86, 90])
@pytest.mark.parametrize("width", [6.0, 10.0, 16.0])
def test_angle_and_width_are_recovered(angle, width, deformed):
    x = specimen(deformed)
    for signed in (angle, -angle):
        found = band.band(x, gaussian_band(x, signed, width))
        assert found["localised"] and found["bands"] == 1 and found["reason"] is None
        assert angle_between(found["angle"], signed) < 0.1
        assert -90.0 < found["angle"] <= 90.0
        assert found["width"] == pytest.approx(width, rel=0.02)
        assert found["angle_error"] < 0.1 and found["width_error"] < 0.03 * width
        assert distance_from_line(found["centre"], signed, (20.0, 54.0)) < 0.1


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("angle", [51.0, -51.0, 45.0, 35.0])
def test_wide_bands_are_recovered(angle, deformed):
    x = specimen(deformed)
    found = band.band(x, gaussian_band(x, angle, 24.5))
    assert found["angle"] == pytest.approx(angle, abs=0.3)
    assert found["width"] == pytest.approx(24.5, rel=0.02)
    assert found["bands"] == 1 and found["parts"] == 0


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("angle, centres", [
    (51.0, [(20.0, 25.0), (20.0, 80.0)]), (51.0, [(20.0, 42.0), (20.0, 66.0)]),
    (45.0, [(20.0, 20.0), (20.0, 54.0), (20.0, 88.0)]), (85.0, [(10.0, 54.0), (30.0, 54.0)])])
def test_each_of_parallel_bands_is_measured(angle, centres, deformed):
    x = specimen(deformed)
    found = band.band(x, sum(gaussian_band(x, angle, 7.0, centre) for centre in centres))
    assert found["localised"] and found["bands"] == len(centres) == len(found["each_band"])
    for each in found["each_band"]:
        assert each["angle"] == pytest.approx(angle, abs=0.1)
        assert each["width"] == pytest.approx(7.0, rel=0.02)
    for centre in centres:
        assert min(distance_from_line(each["centre"], angle, centre)
                   for each in found["each_band"]) < 0.1


@pytest.mark.parametrize("angle", [30.0, 51.0, 75.0])
@pytest.mark.parametrize("combined", [np.add, np.maximum])
def test_both_of_crossing_bands_are_measured(angle, combined):
    x = specimen(False)
    found = band.band(x, combined(gaussian_band(x, angle, 10.0), gaussian_band(x, -angle, 10.0)))
    assert found["bands"] == 2 and found["parts"] == 0
    assert sorted(each["angle"] for each in found["each_band"]) == pytest.approx(
        [-angle, angle], abs=0.5)
    assert [each["width"] for each in found["each_band"]] == pytest.approx([10.0] * 2, rel=0.04)


def test_a_weaker_crossing_band_does_not_turn_the_angle():
    x = specimen(False)
    found = band.band(x, gaussian_band(x, 51.0, 10.0) + 0.7 * gaussian_band(x, -51.0, 10.0))
    assert found["angle"] == pytest.approx(51.0, abs=0.5)
    assert found["width"] == pytest.approx(10.0, rel=0.04)


def test_a_band_that_leaves_through_a_corner_is_measured():
    x = specimen(False)
    for centre in ((0.0, 0.0), (0.0, 78.0), (40.0, 108.0)):
        found = band.band(x, gaussian_band(x, 51.0, 14.0, centre))
        assert found["bands"] == 1
        assert found["angle"] == pytest.approx(51.0, abs=0.1)
        assert found["width"] == pytest.approx(14.0, rel=0.02)


def branching(x, left, right):
    """A band at the angle ``left`` that continues at the angles ``right`` from the centre on."""
    ahead = np.max([gaussian_band(x, angle, 8.0) for angle in right], axis=0)
    return np.where(x[..., 0] < 20.0, gaussian_band(x, left, 8.0), ahead)


def test_a_side_branch_does_not_turn_the_angle_of_a_straight_band():
    x = specimen(False)
    found = band.band(x, branching(x, 51.0, (51.0, 0.0)))
    assert found["bands"] == 1 and found["angle"] == pytest.approx(51.0, abs=0.1)


def test_parts_of_bands_that_meet_at_a_face_are_counted_apart():
    x = specimen(False)
    meeting = [gaussian_band(x, angle, 6.0, (40.0, 66.0)) for angle in (51.0, -51.0)]
    found = band.band(x, np.max([*meeting, gaussian_band(x, -51.0, 6.0, (20.0, 15.0))], axis=0))
    assert found["bands"] == 1 and found["parts"] == 2
    assert found["angle"] == pytest.approx(-51.0, abs=0.1)


def spot(x):
    return 4e-3 * np.exp(-((x - [20.0, 54.0])**2).sum(axis=-1) / 100.0)


def bent(x):
    return gaussian_band(x + np.stack([0.0 * x[..., 0], 8.0 * np.sin(np.pi * x[..., 0] / 40.0)],
                                      axis=-1), 51.0, 10.0)


def noise(x):
    return np.random.default_rng(2).exponential(size=x.shape[:2])


def wide_noise(x):
    return gaussian_filter(noise(x), 4.0)**8


@pytest.mark.parametrize("field, reason", [
    (spot, "does not cross the specimen"), (bent, "the band is not straight"),
    (noise, "continues from cut to cut"), (wide_noise, ""),
    (lambda x: branching(x, 51.0, (66.0, 30.0)), "bands branch or cross"),
    (lambda x: gaussian_band(x, 51.0, 14.0, (0.0, 98.0)), "the boundary cuts off the stretch"),
    (lambda x: np.maximum(gaussian_band(x, 51.0, 10.0, (40.0, 80.0)),
                          gaussian_band(x, -51.0, 10.0, (40.0, 80.0))), "")])
def test_a_field_without_a_straight_band_has_no_angle_but_a_reason(field, reason, tmp_path, capsys):
    x = specimen(False)
    found = band.band(x, field(x))
    assert found["localised"] and found["bands"] == 0 == len(found["each_band"])
    assert found["angle"] is None and found["width"] is None
    assert found["reason"] and reason in found["reason"]
    with h5py.File(tmp_path / "none.h5", "w") as file:
        group = file.create_group("snapshots/0000")
        group["coordinates"], group["inertial_number"] = x, field(x)
    assert measure.main([str(tmp_path / "none.h5")]) == 0
    text = capsys.readouterr().out
    assert f"localised  no band: {found['reason']}" in text and "+-" not in text


@pytest.mark.parametrize("field, reason", [
    (lambda x: np.full(x.shape[:2], 1e-3), "on 100 % of the area"),
    (lambda x: gaussian_band(x, 90.0, 24.5), "on 62 % of the area"),
    (lambda x: 2e-3 + gaussian_band(x, 51.0, 10.0), "of its maximum (localised: at most 25 %)"),
    (lambda x: np.zeros(x.shape[:2]), "nothing flows")])
def test_flow_that_is_not_localised_has_no_band_and_a_reason(field, reason):
    x = specimen(False)
    found = band.band(x, field(x))
    assert not found["localised"] and found["angle"] is None and reason in found["reason"]


def test_homogeneous_flow_is_not_localised():
    x = specimen(False)
    noise = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(x.shape[:2])
    found = band.band(x, 0.03 * noise)
    assert not found["localised"] and found["angle"] is None


def test_the_stronger_of_two_bands_comes_first():
    x = specimen(False)
    I = 0.9 * gaussian_band(x, 51.0, 8.0, (20.0, 25.0)) + gaussian_band(x, 45.0, 8.0, (20.0, 80.0))
    found = band.band(x, I)
    assert found["localised"] and found["bands"] == 2
    assert found["angle"] == pytest.approx(45.0, abs=0.3)
    assert found["each_band"][1]["angle"] == pytest.approx(51.0, abs=0.3)


def test_asymmetry_tells_a_band_off_the_centre():
    x = specimen(False)
    assert band.band(x, gaussian_band(x, 51.0, 15.0))["asymmetry"] < 1e-12
    assert band.band(x, gaussian_band(x, 51.0, 15.0, (20.0, 64.0)))["asymmetry"] > 0.3


def test_a_file_is_measured_by_snapshot(tmp_path, capsys):
    path = tmp_path / "bands.h5"
    x = specimen(True)
    with h5py.File(path, "w") as file:
        for number, angle in enumerate((50.0, -50.0)):
            group = file.create_group(f"snapshots/{number:04d}")
            group.attrs["compression"] = 0.05 * (number + 1)
            group.attrs["label"] = f"{5 * (number + 1)} % compression"
            group["coordinates"], group["inertial_number"] = x, gaussian_band(x, angle, 15.0)
    rows = band.measure(path)
    assert [round(row["angle"]) for row in rows] == [50, -50]
    assert measure.main([str(path), "-json"]) == 0
    assert '"angle"' in capsys.readouterr().out
    assert measure.main([str(path)]) == 0
    assert "localised  1 band" in capsys.readouterr().out
    assert measure.main([str(tmp_path / "none.h5")]) == 1


def test_differences_between_meshes_find_the_order():
    results = []
    for n in (10, 20, 40, 80):
        x = specimen(False, n + 1, 3 * n + 1)
        I = gaussian_band(x, 51.0, 20.0) * (1.0 + 3.0 / n**2 * np.cos(x[..., 0] / 8.0))
        results.append((x, I))
    rows = band.mesh_differences(results)
    assert rows[0]["order"] is None
    assert all(row["order"] == pytest.approx(2.0, abs=0.05) for row in rows[1:])
    assert all(row["maximum"] < 2.0 * row["l2"] for row in rows)
    with pytest.raises(ValueError, match="do not divide the cells"):
        band.mesh_differences([results[1], results[0]])


def test_meshes_are_compared_in_json_too(tmp_path, capsys):
    paths = [str(tmp_path / f"{n}.h5") for n in (10, 20)]
    for path, n in zip(paths, (10, 20)):
        write_run(path, n, element_size=80 / n)
    assert measure.main(["-meshes", *paths, "-json"]) == 0
    row, = json.loads(capsys.readouterr().out)
    assert row["order"] is None and 0.0 <= row["l2"] < 0.1
    assert measure.main(["-meshes", paths[0]]) == 1
    assert "allowed are two files or more" in capsys.readouterr().err


def write_run(path, n, compression=0.1, **options):
    """Write a result of ``n`` elements across, and options of the run that made it."""
    x = specimen(False, n + 1, 3 * n + 1)
    with h5py.File(path, "w") as file:
        file.attrs["options"] = "".join(f"-pgran_{name} {value}\n"
                                        for name, value in options.items())
        group = file.create_group("snapshots/0000")
        group.attrs["compression"] = compression
        group["coordinates"], group["inertial_number"] = x, gaussian_band(x, 51.0, 20.0)


@pytest.mark.parametrize("changed, wanted", [
    ({"compression": 0.05}, "these differ in compression (0.1 and 0.05)"),
    ({"width": 24}, "these differ in -pgran_width (40.0 and 24.0), -pgran_height (120.0 and 72.0)"),
    ({"model": "li"}, "-pgran_model (ngf and li)"),
    ({"inertial_number": 0.003}, "-pgran_inertial_number (0.001 and 0.003)"),
    ({"shear_modulus": 100}, "-pgran_shear_modulus (1000.0 and 100.0)")])
def test_meshes_of_different_problems_are_not_compared(changed, wanted, tmp_path, capsys):
    paths = [str(tmp_path / f"{n}.h5") for n in (10, 20)]
    write_run(paths[0], 10, element_size=8)
    write_run(paths[1], 20, **{"element_size": 4, **changed})
    assert measure.main(["-meshes", *paths]) == 1
    error = capsys.readouterr().err
    assert wanted in error and paths[1] in error


def test_flow_at_rest_is_measured_without_numbers_that_are_none(tmp_path, capsys):
    path = tmp_path / "rest.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("snapshots/0000")
        group["coordinates"], group["inertial_number"] = specimen(False), np.zeros((121, 41))
    assert measure.main([str(path), "-json"]) == 0
    row, = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert not row["localised"] and row["inertial_number_max"] == 0.0 and row["angle"] is None
