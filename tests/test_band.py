"""Bands of known angle and width are measured as such, on deformed meshes too."""

import json

import h5py
import numpy as np
import pytest

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


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("angle", [51.0, -51.0, 45.0, 35.0])
@pytest.mark.parametrize("width", [10.0, 24.5])
def test_angle_and_width_are_recovered(angle, width, deformed):
    x = specimen(deformed)
    found = band.band(x, gaussian_band(x, angle, width))
    assert found["angle"] == pytest.approx(angle, abs=0.3)
    assert found["width"] == pytest.approx(width, rel=0.02)
    assert found["angle_error"] < 0.5 and found["width_error"] < 0.03 * width
    assert found["position"] == pytest.approx(
        54.0 + np.tan(np.radians(angle)) * (x[..., 0].mean() - 20.0), abs=1.5)
    assert found["localised"] and found["bands"] == 1


def test_homogeneous_flow_is_not_localised():
    x = specimen(False)
    noise = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(x.shape[:2])
    found = band.band(x, 0.03 * noise)
    assert not found["localised"] and found["angle"] is None


def test_two_bands_are_counted():
    x = specimen(False)
    I = gaussian_band(x, 51.0, 8.0, (20.0, 25.0)) + 0.9 * gaussian_band(x, 51.0, 8.0, (20.0, 80.0))
    found = band.band(x, I)
    assert found["localised"] and found["bands"] == 2


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
        x = specimen(False, n + 1, 3 * n + 1)
        with h5py.File(path, "w") as file:
            group = file.create_group("snapshots/0000")
            group["coordinates"], group["inertial_number"] = x, gaussian_band(x, 51.0, 20.0)
    assert measure.main(["-meshes", *paths, "-json"]) == 0
    row, = json.loads(capsys.readouterr().out)
    assert row["order"] is None and 0.0 <= row["l2"] < 0.1
    assert measure.main(["-meshes", paths[0]]) == 1
    assert "allowed are two files or more" in capsys.readouterr().err


def test_flow_at_rest_is_measured_without_numbers_that_are_none(tmp_path, capsys):
    path = tmp_path / "rest.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("snapshots/0000")
        group["coordinates"], group["inertial_number"] = specimen(False), np.zeros((121, 41))
    assert measure.main([str(path), "-json"]) == 0
    row, = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert not row["localised"] and row["inertial_number_max"] == 0.0 and row["angle"] is None
