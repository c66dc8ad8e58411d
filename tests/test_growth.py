"""Growth rates of the linearised step: independent of the step, and those of nonlinear runs."""

import json

import pytest
from conftest import ROOT, run_ranks

import specimen

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
    found = specimen.measured(tmp_path / "run.h5", *SMALL, end=0.016)
    expected = rates(1, "-dt", "2.5e-4")[2.5e-4][0][0]
    assert found == pytest.approx(expected, rel=0.1)


def test_unknown_parts_of_the_coupling_are_refused():
    done = run_ranks(2, "-m", "pgran.growth", "-without", "mesh", check=False)
    assert done.returncode == 1
    assert "-without mesh: allowed is faces | geometry | interior | spin | memory" in done.stderr


def test_the_lateral_faces_alone_carry_the_instability():
    whole, faces_alone = (rates(1, "-dt", "5e-4", *more)[5e-4][0][0] for more in (
        (), ("-without", "interior,spin,memory")))
    assert faces_alone == pytest.approx(whole, rel=0.05)
