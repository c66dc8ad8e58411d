"""Spectra of the Jacobian agree with linear theory."""

import json

import h5py
import numpy as np
import pytest
from conftest import ROOT, discretised, parameters, pgran, refused, run_ranks
from petsc4py import PETSc

from pgran.eigen import complete, main
from pgran.output.writer import write_once
from pgran.solve import spectrum


def eigen(ranks, *arguments, **more):
    """Run ``python -m pgran.eigen`` with options/eigen.opts; return what it prints."""
    return run_ranks(ranks, "-m", "pgran.eigen", "-options_file", ROOT / "options" / "eigen.opts",
                     *arguments, **more)


def pairs(ranks, *arguments):
    return json.loads(eigen(ranks, "-json", *arguments).stdout)


def pairs_here(k=None, targets=None, **options):
    """Return the rows of `pgran.solve.spectrum.spectrum` in this process."""
    PETSc.Options().setValue("eps_tol", "1e-10")
    given = parameters(case="periodic", **options)
    k = spectrum.fastest(given) if k is None else np.array(k)
    return spectrum.spectrum(given, PETSc.COMM_WORLD, k, targets)[1]


def test_fastest_mode_has_its_analytic_growth():
    found = pairs(2, "-pgran_cell_elements", 32, "-wave_vector", "0.06481,0.05300")
    assert set(found[0]) == {"computed", "analytic", "relative_error", "residual"}
    assert found[0]["analytic"] == pytest.approx(355.4, abs=0.1)
    # Both signs of k2, and two phases, share the growth rate.
    assert all(pair["relative_error"] < 3e-4 for pair in found[:4])
    assert [p["computed"] for p in found] == sorted((p["computed"] for p in found), reverse=True)
    assert all(pair["residual"] < 1e-6 and np.isfinite(pair["computed"]) for pair in found)


def test_infinite_eigenvalues_are_discarded():
    few, many = (pairs(0, "-pgran_cell_elements", 4, "-eps_nev", count) for count in (8, 300))
    assert len(many) > 50
    assert many[0]["computed"] == pytest.approx(few[0]["computed"], rel=1e-6)
    assert max(abs(pair["computed"]) for pair in many) < 1e8


def test_error_falls_with_order_4():
    errors = [pairs_here(cell_elements=n)[0]["relative_error"] for n in (16, 32)]
    assert np.log2(errors[0] / errors[1]) > 3.85


@pytest.mark.parametrize("relaxation_time, law", [(0.1, "bingham"), (10.0, "jop")])
def test_dynamic_ngf_grows_at_its_analytical_rate(relaxation_time, law):
    given = {"model": "ngf_primitive", "law": law, "relaxation_time": relaxation_time}
    found = pairs_here(cell_elements=32, **given)
    k = np.array([[0.04, 0.03], [0.1, 0]])
    rates = spectrum.theory(parameters(case="periodic", **given), k)
    assert found[0]["analytic"] > rates.max()  # unless given, the wave vector is the fastest one
    assert all(pair["relative_error"] < 1e-4 for pair in found[:4])


@pytest.mark.parametrize("model, law, inertial_number", [
    ("ngf", "bingham", 1e-4), ("ngf", "jop", 1.0), ("ngf_primitive", "bingham", 0.3),
    ("ngf_primitive", "jop", 1e-4), ("li", "bingham", 0.03), ("li", "jop", 1e-4),
    ("li", "barker_gray", 1.0)])
def test_laws_and_models_over_inertial_numbers(law, inertial_number, model):
    # Away from neutral wave vectors, where a relative error says little.
    k = np.array([0.10, 0.03])
    given = {"law": law, "model": model, "inertial_number": inertial_number}
    rate = float(spectrum.theory(parameters(case="periodic", **given), k))
    found = pairs_here(k, [rate * 0.999], **given)
    pair = min(found, key=lambda p: abs(p["analytic"] - rate))
    assert pair["analytic"] == pytest.approx(rate, rel=1e-9)
    assert pair["relative_error"] < 2e-3


def test_mode_is_written_and_drawn(tmp_path):
    path = tmp_path / "mode.h5"
    done = eigen(2, "-pgran_output", path, "-refinement", "8")
    assert "(1, 1)" in done.stdout and "8 x 8" in done.stdout
    with h5py.File(path) as file:
        group = file["snapshots/0000"]
        velocity = group["velocity"][...]
        assert file.attrs["growth_rate"] == pytest.approx(354.46, abs=0.1)
        assert file.attrs["growth_rate_unit"] == "gdot0"
        assert group["speed"].attrs["unit"] == "d gdot0"
    # A transverse wave: one wavelength each way, normal to k.
    k = np.array([0.0648, 0.0530])
    power = np.abs(np.fft.fft2(velocity[..., 0]))
    a, b = np.unravel_index(np.argmax(power), power.shape)
    assert (min(a, 32 - a), min(b, 32 - b)) == (1, 1)
    ratio = np.abs(velocity[..., 0]).max() / np.abs(velocity[..., 1]).max()
    assert ratio == pytest.approx(k[1] / k[0], rel=0.05)
    assert path.with_suffix(".xdmf").exists() and path.with_suffix(".png").stat().st_size > 5000


def test_sweep_compares_the_plane_of_wave_vectors(tmp_path):
    path = tmp_path / "sweep.h5"
    eigen(2, "-sweep", 2, "-pgran_output", path, "-pgran_cell_elements", 16)
    table = np.genfromtxt(path.with_suffix(".csv"), delimiter=",", names=True)
    assert table.size == 4 and (table["relative_error"] < 0.01).all()


def test_an_interrupted_sweep_keeps_its_rows(tmp_path, monkeypatch, capsys):
    """The second wave vector fails after the row of the first is written."""
    original, calls = spectrum.spectrum, []

    def cut(*arguments):
        calls.append(arguments)
        if len(calls) > 1:
            raise MemoryError("no more")
        return original(*arguments)

    monkeypatch.setattr(spectrum, "spectrum", cut)
    assert main(["", "-options_file", str(ROOT / "options" / "eigen.opts"), "-sweep", "2",
                 "-pgran_output", str(tmp_path / "s.h5"), "-pgran_cell_elements", "8"]) == 1
    assert "no more" in capsys.readouterr().err
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 2


@pytest.mark.parametrize("arguments, message", [
    (("-wave_vector", "0.1,0"), "-wave_vector 0.1,0: must be two numbers other than zero"),
    (("-refinement", "8,1"), "-refinement 8,1: must be a list of integers >= 2"),
    (("-pgran_inertial_number", "0.03"), "-wave_vector: a wave vector has to be given"),
    (("-pgran_case", "biaxial", "-wave_vector", "0.1,0.1"),
     "allowed only with a case that has plane waves"),
    (("-pgran_model", "ig", "-wave_vector", "0.1,0.1"), "-pgran_model ig")])
def test_bad_input_gets_one_clear_error(arguments, message):
    refused(eigen(0, *arguments, "-json", check=False, limit=60), message)


def test_spectrum_and_mode_about_a_flowing_specimen_do_not_depend_on_the_ranks(tmp_path):
    """Newton's method for the undisturbed step begins far from its solution."""
    path, size, rates, fields = tmp_path / "x.h5", ("-pgran_element_size", 8), [], []
    pgran(0, "direct.opts", path, *size, "-pgran_compression", 0.02)
    about = "-m", "pgran.eigen", "-pgran_restart", path
    found = json.loads(run_ranks(0, *about, "-json").stdout)
    assert found[0]["computed"] > 0.0 and all(row["residual"] < 1e-6 for row in found)
    for ranks in (0, 2):
        mode = tmp_path / f"mode{ranks}.h5"
        run_ranks(ranks, *about, "-dt", 5e-4, "-eps_nev", 1, "-pgran_output", mode)
        assert mode.with_suffix(".png").stat().st_size > 5000
        with h5py.File(mode) as file:
            rates.append(file.attrs["growth_rate"])
            fields.append(file["snapshots/0000/displacement"][...])
    assert rates[1] == pytest.approx(rates[0], rel=1e-3)
    one, two = fields
    assert min(np.abs(two - one).max(), np.abs(two + one).max()) < 1e-3 * np.abs(one).max()
    refused(pgran(0, "direct.opts", tmp_path / "y.h5", *size, "-pgran_mode_file", mode,
                  check=False), "belongs to a deformed mesh")


def test_a_mode_has_a_default_file_that_is_not_the_result_of_a_run(tmp_path):
    assert complete({"pgran_case": "periodic"})["pgran_output"] == "results/periodic_ngf_mode.h5"
    assert complete({"pgran_output": "a.h5"})["pgran_output"] == "a.h5"
    form = discretised(width=8, height=24)
    x = form.case.coordinates(*form.grid.nodes.index)
    write_once(tmp_path / "run.h5", form, {"coordinates": x})
    texts = complete({"pgran_restart": str(tmp_path / "run.h5")})
    assert texts["pgran_output"] == str(tmp_path / "run_mode.h5")
    assert texts["pgran_width"] == "8.0"
