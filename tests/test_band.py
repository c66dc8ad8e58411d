"""Bands of known angle and width are measured, on deformed meshes too."""

import json

import h5py
import numpy as np
import pytest

from pgran import measure
from pgran.output import band


def specimen(deformed, nx=41, ny=121):
    """Nodes of a specimen of 40 d x 108 d, undeformed or sheared and bulged."""
    x, y = np.meshgrid(np.linspace(0.0, 40.0, nx), np.linspace(0.0, 108.0, ny))
    if deformed:
        x, y = (x + 4.0 * np.tanh((y - 54.0) / 15.0) + 0.5 * np.sin(y / 9.0),
                y + 0.3 * np.sin(x / 5.0) * np.sin(np.pi * y / 108.0))
    return np.stack([x, y], axis=-1)


PLAIN = specimen(False)


def distance(x, angle, centre):
    """The signed distance of points (..., 2) from the line at an angle through ``centre``."""
    angle = np.radians(angle)
    return (np.array(x) - centre) @ [-np.sin(angle), np.cos(angle)]


def gaussian_band(x, angle, width, centre=(20.0, 54.0)):
    """I of a band of full width at half maximum ``width``, 4e-3 in its middle."""
    return 4e-3 * np.exp(-4.0 * np.log(2.0) * (distance(x, angle, centre) / width)**2)


def write_snapshots(path, *fields, options="", x=PLAIN, attributes=({},)):
    """Write a result file with snapshots of I and the attributes of each; return its path."""
    with h5py.File(path, "w") as file:
        file.attrs["options"] = options
        for number, (I, named) in enumerate(zip(fields, attributes)):
            group = file.create_group(f"snapshots/{number:04d}")
            group.attrs.update(named)
            group["coordinates"], group["inertial_number"] = x, I
    return str(path)


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("width, angles", [
    *((width, (0, 10, -35, 51, -51, 66, -80, 90)) for width in (6.0, 16.0)), (24.5, (35, -51))])
def test_angle_and_width_are_recovered(angles, width, deformed):
    x, wide = specimen(deformed), width > 20.0
    for angle in angles:
        found = band.band(x, gaussian_band(x, angle, width))
        assert found["localised"] and found["bands"] == 1 and not found["reason"]
        assert abs((found["angle"] - angle + 90.0) % 180.0 - 90.0) < (0.3 if wide else 0.1)
        assert -90.0 < found["angle"] <= 90.0 and found["parts"] == 0
        assert found["width"] == pytest.approx(width, rel=0.02)
        assert found["angle_error"] < (1.0 if wide else 0.1)
        assert found["width_error"] < 0.03 * width
        assert abs(distance(found["centre"], angle, (20.0, 54.0))) < 0.1
        assert deformed or found["asymmetry"] < 1e-12


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("angle, centres", [
    (45.0, [(20.0, 20.0), (20.0, 54.0), (20.0, 88.0)]), (85.0, [(10.0, 54.0), (30.0, 54.0)])])
def test_each_of_parallel_bands_is_measured(angle, centres, deformed):
    x = specimen(deformed)
    found = band.band(x, sum(gaussian_band(x, angle, 7.0, centre) for centre in centres))
    assert found["localised"] and found["bands"] == len(centres) == len(found["each_band"])
    for each in found["each_band"]:
        assert each["angle"] == pytest.approx(angle, abs=0.1)
        assert each["width"] == pytest.approx(7.0, rel=0.02)
        assert min(abs(distance(each["centre"], angle, centre)) for centre in centres) < 0.1


@pytest.mark.parametrize("angle", [30.0, 75.0])
def test_both_crossing_bands_are_measured(angle):
    found = band.band(PLAIN, sum(gaussian_band(PLAIN, a, 10.0) for a in (-angle, angle)))
    assert found["bands"] == 2 and found["parts"] == 0
    assert sorted(each["angle"] for each in found["each_band"]) == pytest.approx(
        [-angle, angle], abs=0.5)
    assert [each["width"] for each in found["each_band"]] == pytest.approx([10.0] * 2, rel=0.04)


def test_a_weaker_crossing_band_does_not_turn_the_angle():
    found = band.band(PLAIN, gaussian_band(PLAIN, 51.0, 10.0)
                      + 0.7 * gaussian_band(PLAIN, -51.0, 10.0))
    assert found["angle"] == pytest.approx(51.0, abs=0.5)
    assert found["width"] == pytest.approx(10.0, rel=0.04)


def branching(left, right):
    """A band at the angle ``left`` that continues at the angles ``right`` from the centre."""
    ahead = np.max([gaussian_band(PLAIN, angle, 8.0) for angle in right], axis=0)
    return np.where(PLAIN[..., 0] < 20.0, gaussian_band(PLAIN, left, 8.0), ahead)


@pytest.mark.parametrize("field, angle, width, bands, parts", [
    (0.9 * gaussian_band(PLAIN, 51.0, 8.0, (20.0, 25.0))
     + gaussian_band(PLAIN, 45.0, 8.0, (20.0, 80.0)), 45, 8, 2, None),
    (gaussian_band(PLAIN, 51.0, 14.0, (0.0, 78.0)), 51, 14, 1, 0),
    (branching(51.0, (51.0, 0.0)), 51, None, 1, None),
    (np.max([gaussian_band(PLAIN, angle, 6.0, centre) for angle, centre in (
        (51.0, (40.0, 66.0)), (-51.0, (40.0, 66.0)), (-51.0, (20.0, 15.0)))], axis=0),
     -51, None, 1, 2)],
    ids=["weaker band", "band through a corner", "side branch", "parts that meet at a face"])
def test_other_bands_and_the_boundary_do_not_change_the_angle(field, angle, width, bands, parts):
    found = band.band(PLAIN, field)
    assert found["angle"] == pytest.approx(angle, abs=0.3 if bands != 1 else 0.1)
    assert not width or found["width"] == pytest.approx(width, rel=0.02)
    assert found["bands"] == bands and parts in (None, found["parts"])


BENT = np.stack([0.0 * PLAIN[..., 0], 8.0 * np.sin(np.pi * PLAIN[..., 0] / 40.0)], axis=-1)
NOISE = np.random.default_rng(2).exponential(size=PLAIN.shape[:2])


@pytest.mark.parametrize("field, localised, reason", [
    (4e-3 * np.exp(-((PLAIN - [20.0, 54.0])**2).sum(axis=-1) / 100.0), True,
     "does not cross the specimen"),
    (gaussian_band(PLAIN + BENT, 51.0, 10.0), True, "the band is not straight"),
    (NOISE, True, "continues from cut to cut"),
    (branching(51.0, (66.0, 30.0)), True, "bands branch or cross"),
    (gaussian_band(PLAIN, 51.0, 14.0, (0.0, 98.0)), True, "the boundary cuts off the stretch"),
    (np.full(PLAIN.shape[:2], 1e-3), False, "on 100 % of the area"),
    (2e-3 + gaussian_band(PLAIN, 51.0, 10.0), False, "of its maximum (localised: at most 25 %)"),
    (np.zeros(PLAIN.shape[:2]), False, "nothing flows")],
    ids=["spot", "bent", "noise", "branches", "corner", "homogeneous", "too weak", "at rest"])
def test_without_a_straight_band_the_reason_is_given(field, localised, reason, tmp_path, capsys):
    found = band.band(PLAIN, field)
    assert found["localised"] == localised and found["bands"] == 0 == len(found["each_band"])
    assert not found["angle"] and not found["width"]
    assert found["reason"] and reason in found["reason"]
    path = write_snapshots(tmp_path / "none.h5", field)
    assert measure.main([path]) == 0
    text = capsys.readouterr().out
    assert f"localised  no band: {found['reason']}" in text and "+-" not in text
    assert measure.main([path, "-json"]) == 0
    row, = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert not row["angle"] and row["inertial_number_max"] == field.max()


def test_each_snapshot_of_a_file_is_measured(tmp_path, capsys):
    x = specimen(True)
    path = write_snapshots(
        tmp_path / "bands.h5", gaussian_band(x, 50.0, 15.0), gaussian_band(x, -50.0, 15.0), x=x,
        attributes=[{"compression": c, "label": f"{100 * c:g} % compression"} for c in (0.05, 0.1)])
    assert measure.main([path, "-json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [round(row["angle"]) for row in rows] == [50, -50]
    assert [row["compression"] for row in rows] == [0.05, 0.1]
    assert measure.main([path]) == 0
    assert "localised  1 band" in capsys.readouterr().out


def test_differences_between_meshes_have_the_order_of_convergence():
    results = []
    for n in (10, 20, 40, 80):
        x = specimen(False, n + 1, 3 * n + 1)
        results.append((x, gaussian_band(x, 51.0, 20.0) * (
            1.0 + 3.0 / n**2 * np.cos(x[..., 0] / 8.0))))
    first, *rows = band.mesh_differences(results)
    assert not first["order"]
    assert all(row["order"] == pytest.approx(2.0, abs=0.05) for row in rows)
    assert all(row["maximum"] < 2.0 * row["l2"] for row in (first, *rows))
    with pytest.raises(ValueError, match="do not divide the cells"):
        band.mesh_differences([results[1], results[0]])


@pytest.mark.parametrize("changed, differing", [
    ({}, None), ({"compression": 0.05}, "differ in compression (0.1 and 0.05)"),
    ({"width": 24}, "in -pgran_width (40.0 and 24.0), -pgran_height (120.0 and 72.0)"),
    ({"shear_modulus": 100}, "-pgran_shear_modulus (1000.0 and 100.0)")])
def test_runs_are_compared_if_they_differ_only_by_meshes(changed, differing, tmp_path, capsys):
    paths = []
    for n, more in ((10, {}), (20, changed)):
        x, options = specimen(False, n + 1, 3 * n + 1), {"element_size": 80 / n, **more}
        attributes = [{"compression": options.pop("compression", 0.1)}]
        text = "".join(f"-pgran_{name} {value}\n" for name, value in options.items())
        paths.append(write_snapshots(tmp_path / f"{n}.h5", gaussian_band(x, 51.0, 20.0),
                                     options=text, x=x, attributes=attributes))
    assert measure.main(["-meshes", *paths, "-json"]) == int(bool(differing))
    text = capsys.readouterr()
    if differing:
        assert differing in text.err and paths[1] in text.err
        return
    row, = json.loads(text.out)
    assert not row["order"] and 0.0 <= row["l2"] < 0.1
    assert measure.main(["-meshes", *paths]) == 0
    assert measure.main(["-meshes", paths[0]]) == 1
    assert "requires at least two files" in capsys.readouterr().err
