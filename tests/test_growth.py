"""Growth rates of the linearised step: independent of the step, and those of nonlinear runs."""

import json

import h5py
import numpy as np
import pytest
from conftest import ROOT, run_ranks

import specimen
from pgran.growth import column_growth_rate
from pgran.options import read

SMALL = "-pgran_element_size", 4


def rates(ranks, *arguments):
    done = run_ranks(ranks, "-m", "pgran.growth", "-options_file", ROOT / "options" / "growth.opts",
                     *SMALL, "-json", *arguments)
    return {row["dt"]: row["growth_rates"] for row in json.loads(done.stdout)}


def test_growth_rates_converge_with_the_step():
    found = rates(1, "-dt", "5e-4,2.5e-4,1.25e-4")
    a, b, c = (found[dt][0][0] for dt in (5e-4, 2.5e-4, 1.25e-4))
    assert a == pytest.approx(c, rel=0.03)
    assert abs(c - b) < 0.6 * abs(b - a)


def test_growth_rates_do_not_depend_on_the_ranks():
    one, three = (rates(n, "-dt", "5e-4")[5e-4] for n in (1, 2))
    assert one[0][0] == pytest.approx(three[0][0], rel=1e-5)


def test_nothing_grows_where_the_mesh_takes_no_part():
    found = rates(1, "-dt", "5e-4", "-without", "faces,geometry")[5e-4]
    assert all(real < 1.0 for real, _ in found)


def test_a_nonlinear_run_grows_as_the_linearised_step_says(tmp_path):
    found, time = specimen.measured(tmp_path / "run.h5", *SMALL, end=0.016)
    expected = rates(1, "-dt", "2.5e-4")[2.5e-4][0][0]
    assert found == pytest.approx(expected, rel=0.1)
    assert found == pytest.approx(expected * specimen.later((), time), rel=0.03)


def test_unknown_parts_of_the_coupling_are_refused():
    done = run_ranks(2, "-m", "pgran.growth", "-without", "mesh", check=False)
    assert done.returncode == 1
    assert "-without mesh: allowed is faces | geometry | interior | spin | memory" in done.stderr


def test_the_lateral_faces_alone_carry_the_instability():
    whole, faces_alone = (rates(1, "-dt", "5e-4", *more)[5e-4][0][0] for more in (
        (), ("-without", "interior,spin,memory")))
    assert faces_alone == pytest.approx(whole, rel=0.05)


@pytest.mark.parametrize("options", [
    {"height": 240}, {"inertial_number": 1e-4}, {"inertial_number": 0.03},
    {"width": 20, "height": 60}, {"inertia": "true"}, {"law": "jop"}], ids=str)
def test_a_slender_specimen_sways_as_a_column_does(options):
    given = [text for name, value in options.items() for text in (f"-pgran_{name}", value)]
    found = rates(1, "-dt", "2.5e-4", *given)[2.5e-4][0][0]
    settings = read({f"pgran_{name}": str(value) for name, value in options.items()})
    assert found == pytest.approx(column_growth_rate(settings), rel=0.12)


def test_modes_of_a_specimen_are_sine_waves_along_it():
    tall = rates(1, "-dt", "5e-4", "-pgran_height", 240)[5e-4]
    assert tall[1][0] == pytest.approx(rates(1, "-dt", "5e-4")[5e-4][0][0], rel=1e-4)


def test_plates_that_hold_a_specimen_leave_no_sway():
    free, held = (rates(1, "-dt", "5e-4", *more)[5e-4] for more in (
        (), ("-pgran_plates_slip", "false")))
    assert held[0][0] < 0.1 * free[0][0]


def test_the_fastest_mode_is_written(tmp_path):
    path = tmp_path / "mode.h5"
    run_ranks(2, "-m", "pgran.growth", *SMALL, "-dt", "1e-3", "-mode", path)
    with h5py.File(path) as file:
        group = file["snapshots/0000"]
        lean, x = group["displacement"][..., 0], group["coordinates"][...]
        assert file.attrs["growth_rate"] > 300.0
    assert path.with_suffix(".png").exists() and np.abs(lean).max() == pytest.approx(1.0)
    # Half a cosine up the specimen.
    middle = lean[:, 10] - lean[:, 10].mean()
    wave = np.cos(np.pi * np.linspace(0.0, 1.0, len(x)))
    assert abs(np.corrcoef(middle, wave)[0, 1]) > 0.99
