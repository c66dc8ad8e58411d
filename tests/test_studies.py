"""Studies at tiny size: reuse of runs, start of studies, fits, tables and figures."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import ROOT, discretised, parameters, run_ranks

from pgran.options import OptionError, SolutionError
from pgran.runs import run_on_ranks
from studies import (
    __main__,
    bench,
    flow_spectra,
    flows,
    growth,
    primitive,
    reference,
    section4,
    specimen,
    spectra,
    stopping,
    study,
    transfer,
)

FILE = "options/biaxial.opts"
SMALL = "-pgran_width", 8, "-pgran_height", 24
SHORT = "-pgran_compression", 0.001, "-pgran_snapshots", 0.0005
TINY = (*SMALL, *SHORT)
nightly = pytest.mark.nightly


@pytest.fixture(autouse=True)
def docs(monkeypatch, tmp_path):
    """The directory of generated pages and figures."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(run_on_ranks, "RANKS", 1)  # fastest for tiny runs
    monkeypatch.setattr(study, "DOCS", tmp_path / "docs")
    return tmp_path / "docs"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A result file of a tiny run."""
    path = tmp_path_factory.mktemp("studies") / "tiny.h5"
    run_ranks(0, "-m", "pgran.runs.run_on_ranks", path, FILE, *TINY)
    return path


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def put(monkeypatch, module, **values):
    for name, value in values.items():
        monkeypatch.setattr(module, name, value)


def test_a_result_is_done_only_with_the_requested_options(tiny):
    large = ROOT / "options" / "large.opts"
    for more in ((), ("-pgran_output", "elsewhere.h5"), study.QUIET,
                 ("-pgran_width", "8.0", "-pgran_inertia", "no"), ("-snes_atol", "5e-4")):
        assert run_on_ranks.done(tiny, FILE, (*TINY, *more)), more
    for more in (("-pgran_shear_modulus", 100), ("-pgran_law", "jop"), ("-pgran_inertia", "true"),
                 ("-pgran_snapshots", 0.0007), ("-snes_atol", 1e-7), ("-options_file", large)):
        assert not run_on_ranks.done(tiny, FILE, (*TINY, *more)), more
    assert not run_on_ranks.done(tiny, "options/li.opts", TINY)


def test_a_result_is_done_only_if_complete_and_newer_than_its_sources(tmp_path):
    options, mode, path = (tmp_path / name for name in ("a.opts", "mode.h5", "x.h5"))
    options.write_text(f"-options_file {ROOT / FILE}\n")
    mode.write_text("")
    more = "-pgran_mode_file", mode
    assert not run_on_ranks.done(path, options, more)
    for complete in (False, True):
        with h5py.File(path, "w") as file:
            text = study.parameters(None, "-options_file", options, *more).text()
            file.attrs.update(options=text, complete=complete)
        assert run_on_ranks.done(path, options, more) == complete
    for newer in (options, mode):
        os.utime(newer, (2e9, 2e9))
        assert not run_on_ranks.done(path, options, more)
        os.utime(newer, (1e9, 1e9))
    path.write_bytes(path.read_bytes()[:100])
    assert not run_on_ranks.done(path, options, more)


@pytest.mark.parametrize("launcher, ranks, expected", [
    ("", 3, ["mpiexec", "-n", "3"]), ("", 0, []), ("srun", 2, ["srun"]),
    ("srun --mpi=pmix", 1, ["srun", "--mpi=pmix", "-n", "1"])])
def test_the_environment_determines_how_runs_start(monkeypatch, launcher, ranks, expected):
    monkeypatch.setattr(run_on_ranks, "RANKS", 2)
    for name, value in (("PGRAN_PYTHON", "python9"), ("OMPI_COMM_WORLD_RANK", "1"),
                        ("PGRAN_LAUNCH", launcher)):
        monkeypatch.setenv(name, value)
    command, environment = run_on_ranks.command(ranks, "-m", "pgran", "-pgran_width", 8)
    assert command == [*expected, "python9", "-m", "pgran", "-pgran_width", "8"]
    assert ("OMPI_COMM_WORLD_RANK" in environment) == bool(launcher)


def test_a_run_beyond_its_time_limit_ends_with_all_ranks(tmp_path):
    path = tmp_path / "pids"
    code = f"import os, time; open('{path}', 'a').write(f'{{os.getpid()}} '); time.sleep(600)"
    with pytest.raises(subprocess.TimeoutExpired):
        run_on_ranks.python(2, "-c", code, timeout=10, stderr=subprocess.DEVNULL)
    states = [Path(f"/proc/{pid}/stat") for pid in path.read_text().split()]
    assert len(states) == 2  # they are gone, or wait to be reaped
    assert all(not state.exists() or ") Z " in state.read_text() for state in states)


def test_the_script_lists_and_explains_studies_and_rejects_wrong_arguments(capsys):
    done = subprocess.run(["bash", "jobs/study.sh"], text=True, capture_output=True, check=True,
                          env={**os.environ, "PGRAN_PYTHON": sys.executable})
    for name in __main__.STUDIES:
        assert f"  {name} " in done.stdout
        assert __main__.main([name, "-help"]) == 0
    assert "well-posed" in capsys.readouterr().out
    for words, message in ((["nothing"], "unknown study"), (["verify", "a", "b"], "too many"),
                           (["section4", "fig9"], "fig3"), (["bench", "speed"], "answer, "),
                           (["verify", "-pgran_widht", "3"], "did you mean -pgran_width")):
        assert __main__.main(words) == 1
        assert message in capsys.readouterr().err


def test_a_table_is_stored_with_all_digits_and_written_to_the_docs_with_a_stamp(tmp_path, docs):
    columns, path = {"case": "", "angle": ".1f"}, tmp_path / "new" / "y.csv"
    study.write_table(path, columns, [("one", 51.04), ("two",)])
    assert table(path)[0] == {"case": "one", "angle": "51.04"}
    *lines, _, stamp = (docs / "generated" / "y.md").read_text().splitlines()
    assert lines[2:] == ["| one | 51.0 |", "| two | - |"]
    assert stamp.startswith("pgran ") and "PETSc 3." in stamp and " cores), 20" in stamp
    with pytest.raises(SolutionError, match="all runs failed"):
        study.write_table(tmp_path / "z.csv", columns, [("one",)])


def test_growth_rates_are_fitted_and_extrapolated():
    time = np.linspace(0.0, 0.03, 400)
    span = 1e-4 * np.exp(355.0 * time)
    bump = span + 2e-3 * np.exp(-((time - 0.001) / 5e-4)**2)  # as after loading
    for found, error in ((span, 1e-9), (span / np.hypot(1.0, span / 0.05), 1e-2), (bump, 1e-6)):
        assert growth.fitted(time, found) == pytest.approx(355.0, rel=error)
    assert growth.fitted(time, np.full_like(time, 1e-3)) is None
    assert growth.fitted(time[::40], span[::40], (3e-4, 6e-4)) is None
    rates = [np.array([400.0 - 3e4 * dt + 1e7 * dt**2, 5.0 + 2j]) for dt in specimen.STEPS]
    np.testing.assert_allclose(specimen.at_zero(specimen.STEPS, rates), [400.0, 5.0 + 2j],
                               rtol=1e-9)


def test_interpolation_to_a_finer_mesh_is_exact_for_quadratic_fields(tmp_path):
    def fields(x1, x2):
        q = 1.0 + x1 - x2 / 3.0 + (x1 * x2 - x1**2 * x2 + x1**2 * x2**2) / 50.0
        return {"coordinates": np.stack([x1 + 0.01 * x1 * x2, x2 - 0.02 * x2**2], axis=-1),
                "velocity": np.stack([q, x1 - x2**2], axis=-1), "fluidity": 200.0 + q,
                "pressure": 2.0 + x1 * x2 / 90.0 - x2, "deviator": np.stack([q, -q, q], axis=-1)}

    path = tmp_path / "coarse.h5"
    with h5py.File(path, "w") as file:
        file.attrs["options"] = parameters(width=8, height=16, element_size=2).text()
        group = file.create_group("snapshots/0000")
        group.attrs["time"] = 0.25
        for name, value in fields(*np.meshgrid(np.arange(5) * 2.0, np.arange(9) * 2.0)).items():
            group[name] = value
    form = discretised(width=8, height=16, element_size=1, imperfection=1)
    state, nodes, corners = transfer.interpolated(form, path, 0), form.grid.nodes, form.grid.corners
    expected = {**fields(*(nodes.index / 2.0)),
                "pressure": fields(*(1.0 * corners.index))["pressure"]}
    for name, found in zip(("coordinates", "velocity", "fluidity", "pressure"),
                           (state.x, *form.grid.split(state.local))):
        np.testing.assert_allclose(found.T, expected[name], rtol=1e-12, atol=1e-12)
    with pytest.raises(OptionError, match="2 x 4 elements are not divided by the 5 x 8"):
        transfer.interpolated(discretised(width=5, height=8, element_size=1), path, 0)


def test_the_cost_of_one_step_is_reported(tiny):
    found = json.loads(run_ranks(
        2, "-m", "studies.one_step", "-options_file", FILE, *SMALL, "-pgran_element_size", 1,
        "-from", tiny, "-dt", 1e-4).stdout)
    norms = [row["residual"] for row in found["newton"]]
    assert found["ranks"] == 2 and norms[-1] < min(1e-4, norms[0])
    for row in found["newton"]:
        assert row["iterations"] > 0 and 0.0 < row["jacobian"] + row["evaluation"] < row["seconds"]


def test_verify_fails_beyond_its_limits(tmp_path, monkeypatch):
    put(monkeypatch, reference, VERIFY={"base": (), "stiff": reference.VERIFY["stiff"]})
    reference.verify(tmp_path, options=TINY)
    base, stiff = table(tmp_path / "verify.csv")
    assert float(base["difference (%)"]) == 0.0 < float(stiff["difference (%)"]) < 3.0
    put(monkeypatch, reference, LIMITS={"stiff": 1e-9})
    with pytest.raises(SolutionError, match="beyond the limits: stiff"):
        reference.verify(tmp_path, options=TINY)


@nightly
def test_variations_of_the_reference_simulation(tmp_path, monkeypatch, docs):
    put(monkeypatch, reference, WIDTHS=(20,), NUMBERS=(1e-3, 1e-1), SENSITIVITY={
        "base": (), "Jop": ("-pgran_law", "jop"), "fails": ("-pgran_step_min", 5e-3)})
    reference.sensitivity(tmp_path, options=TINY)
    rows = table(tmp_path / "sensitivity.csv")
    assert [row["case"] for row in rows] == ["base", "base", "Jop", "Jop", "fails"]
    assert rows[4]["compression"] == "run failed" and int(rows[3]["steps"]) > 3
    reference.regime(tmp_path, options=SHORT)
    assert [float(row["I0"]) for row in table(tmp_path / "regime.csv")] == [1e-3, 1e-1]
    assert (docs / "figures" / "regime.png").stat().st_size > 10000


@nightly
def test_meshes_are_compared(tmp_path, monkeypatch):
    put(monkeypatch, section4, RESULTS=tmp_path)
    section4.meshes("2 1", "2", options=TINY)
    row, = table(tmp_path / "meshes.csv")
    assert (row["model"], row["from (d)"], row["to (d)"], row["order"]) == ("ngf", "2", "1", "")
    assert 0.0 < float(row["over L2 norm (%)"]) < 5.0
    section4.posed("2 1", "0.003", tmp_path, options=SMALL)
    rows = table(tmp_path / "posed.csv")
    assert [row["law"] for row in rows] == ["bingham"] * 2 + ["barker_gray"] * 2
    assert rows[2]["over L2 norm (%)"] == "" and float(rows[3]["over L2 norm (%)"]) > 0.0


def test_figures_of_section_4_have_tables(tmp_path, monkeypatch, docs):
    put(monkeypatch, section4, RESULTS=tmp_path)
    monkeypatch.setattr(study, "paper_figures", lambda names, results: None)
    section4.section4("fig7", "4 2", options=(
        *SMALL, "-pgran_compression", 0.005, "-pgran_snapshots", 0.005))
    assert len(table(tmp_path / "section4_fig7.csv")) == 2
    row, = table(tmp_path / "section4_fig7_meshes.csv")
    assert row["from (d)"] == "4" and float(row["over maximum (%)"]) > 0.0


@nightly
def test_steady_and_dynamic_ngf_are_compared(tmp_path, monkeypatch, docs):
    put(monkeypatch, primitive, SHARES=(None, 1e-4), GROWTH=0.01)  # too short for growth
    primitive.primitive("4", tmp_path, options=TINY)
    for row in table(tmp_path / "primitive_rates.csv"):
        assert float(row["linearised step"]) == pytest.approx(
            float(row["specimen, analytical"]), rel=0.05)
        assert row["nonlinear run"] == row["corrected for the current shape"] == ""
    rows = table(tmp_path / "primitive.csv")
    assert [row["t0/T"] for row in rows] == ["steady NGF"] * 2 + ["0.0001"] * 2
    assert float(rows[1]["difference (%)"]) == 0.0 < float(rows[3]["difference (%)"]) < 1.0
    assert (docs / "figures" / "primitive.png").stat().st_size > 10000


def test_growth_rates_of_theory_and_of_a_run_from_an_eigenvector_agree(tmp_path, monkeypatch):
    put(monkeypatch, specimen, LARGE=())
    rows = dict(specimen.steps_rows("-pgran_element_size", 4))
    assert rows["extrapolated to 0"] == pytest.approx(rows["analytical"], rel=5e-3)
    assert rows["column"] == pytest.approx(rows["analytical"], rel=0.12)
    assert specimen.later((), 0.02) == pytest.approx(0.96, abs=0.01)
    path = tmp_path / "mode.h5"
    rate, options = growth.eigenmode(path, 8)
    growth.grow(path, options, tmp_path / "growth.h5", 0.008, *growth.EXPONENTIAL)
    assert growth.fitted(*growth.history(tmp_path / "growth.h5")[1:]) == pytest.approx(rate, 0.02)
    monkeypatch.setattr(run_on_ranks, "python", lambda *_: pytest.fail("the mode exists"))
    assert growth.eigenmode(path, 8)[0] == rate > 0.0
    with pytest.raises(pytest.fail.Exception):
        growth.eigenmode(path, 8, "-pgran_law", "jop")


def test_computed_spectra_agree_with_theory():
    found = spectra.single("ngf", "1e-3", "0.10,0.03", "-pgran_cell_elements", 16)
    assert found["relative_error"] < 2e-4
    rates = spectra.specimen("1e-3", 20, 4, "-eps_nev", 4)
    assert rates[0] == pytest.approx(-6.952, rel=1e-3)


def test_flows_converge_to_their_profiles(tmp_path, monkeypatch, docs):
    put(monkeypatch, flows, LAWS=("jop",), FLOWS=(("inclined plane", "inclined_plane", (
        "-pgran_height", 5, "-pgran_slope", 24, "-pgran_grading", 2), (1, 0.5), ("ngf",)),))
    flows.flows(tmp_path)
    coarse, fine = table(tmp_path / "flows.csv")
    assert float(fine["velocity"]) < 0.2 * float(coarse["velocity"]) < 0.01
    assert (docs / "figures" / "flow_inclined_plane.png").stat().st_size > 20000


@nightly
def test_spectra_of_flows_and_stopping_heights(tmp_path, monkeypatch):
    put(monkeypatch, flow_spectra, NUMBERS=(1e-2,), SIZES=(2,), SQUARE=4, FLOWS=((
        "inclined plane", "inclined_plane", ("-pgran_height", 4,), "slope", (25,), (0.5, 0.25)),))
    flow_spectra.flow_spectra(tmp_path)
    coarse, fine = table(tmp_path / "flow_spectra_decay.csv")
    assert abs(float(coarse["difference (%)"])) < 1.0 and fine["nonlinear solver"] == ""
    assert len(table(tmp_path / "flow_spectra_growth.csv")) == 2
    put(monkeypatch, stopping, SLOPES=(28,), FLOWING=(1.01, 1.02), ELEMENTS=12, FOLLOWED=(28,),
        SHARES=(1.2,), END=300)
    stopping.stopping(tmp_path)
    row, = table(tmp_path / "stopping.csv")
    for name in "end of flow (d)", "zero of the eigenvalue (d)":
        assert float(row[name]) == pytest.approx(float(row["analytical (d)"]), rel=1e-3)
    for row in table(tmp_path / "stopping_followed.csv"):
        assert float(row["g at the end"]) == pytest.approx(float(row["g, analytical"]), rel=0.05)


def test_benchmarks_write_their_tables(tmp_path, monkeypatch, docs):
    put(monkeypatch, bench, BENCH=tmp_path)
    bench.bench("answer", "4", "4", options=TINY)
    assert float(table(tmp_path / "answer.csv")[0]["to strict (%)"]) != 0.0

    step = {"element_size": 2.0, "unknowns": 100, "memory": 100.0, "newton": [
        {"iterations": number, "seconds": 1.0, "jacobian": 0.1} for number in (14, 15)]}
    put(monkeypatch, bench, step=lambda ranks, *_, **__: {"ranks": int(ranks), **step})
    bench.bench("iterations", "2 1", "1 2")
    assert [row["before"] for row in table(tmp_path / "iterations.csv")] == ["14.5 (15)"] * 4
    bench.bench("size", "2 1 0.5", "1", "")
    assert len(table(tmp_path / "size.csv")) == 3
    assert (docs / "generated" / "bench_size.md").exists()
