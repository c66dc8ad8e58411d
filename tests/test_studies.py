"""Studies at tiny size: fits, transfer, tables, and which results count as done."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from conftest import ROOT, allowed, discretised, parameters, run_ranks

from pgran.options import OptionError, ParameterError, SolutionError
from pgran.output import section4 as figures
from pgran.runs import run_on_ranks
from pgran.runs.table import Table, result_file
from pgran.theory.specimen import growth_rate
from studies import (
    __main__,
    bench,
    flow_spectra,
    flows,
    growth,
    meshes,
    posed,
    primitive,
    regime,
    section4,
    sensitivity,
    specimen,
    spectra,
    stopping,
    verify,
)

FILE = "options/biaxial.opts"
SMALL = "-pgran_width", 8, "-pgran_height", 24
SHORT = "-pgran_compression", 0.001, "-pgran_snapshots", 0.0005
TINY = (*SMALL, *SHORT)
SCRIPTS = sorted(ROOT.glob("jobs/**/*.sh"))


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(run_on_ranks, "RANKS", 1)  # tiny runs are fastest so


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A result file of a tiny run."""
    path = tmp_path_factory.mktemp("studies") / "tiny.h5"
    run_ranks(0, "-m", "pgran.runs.run_on_ranks", path, FILE, *TINY)
    return path


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def written_result(path, *options, complete=True):
    """Write the root attributes of a run with options."""
    with h5py.File(path, "w") as file:
        file.attrs.update(options=run_on_ranks.asked(FILE, *options).text(), complete=complete)


# Which results are done


def test_a_second_options_file_counts(tiny):
    options = "-options_file", ROOT / "options" / "large.opts", "-pgran_width", 8
    found = run_on_ranks.combined_options(FILE, *options)
    assert found["pgran_coarse_correction"] == "true" and found["pgran_width"] == "8"
    assert "options_file" not in found and found["pc_type"] == "fieldsplit"
    assert not run_on_ranks.done(tiny, FILE, (*TINY, *options[:2]))


def test_a_result_is_done_only_with_the_options_asked_for(tiny):
    assert run_on_ranks.done(tiny, FILE, TINY)
    for more in (("-pgran_shear_modulus", 100), ("-pgran_law", "jop"), ("-pgran_inertia", "true"),
                 ("-pgran_imperfection_size", 4), ("-pgran_snapshots", 0.0007)):
        assert not run_on_ranks.done(tiny, FILE, (*TINY, *more)), more
    assert not run_on_ranks.done(tiny, "options/li.opts", TINY)
    assert not run_on_ranks.done(tiny, FILE, (*TINY, "-snes_atol", 1e-7))
    assert run_on_ranks.done(tiny, FILE, (*TINY, "-snes_atol", "5e-4"))


def test_options_that_a_run_adds_by_itself_are_not_compared(tmp_path):
    file, path = tmp_path / "few.opts", tmp_path / "few.h5"
    file.write_text("-ts_type pseudo\n-pgran_element_size 20\n-pgran_progress quiet\n")
    run_on_ranks.run(path, file, ranks=1)
    assert run_on_ranks.done(path, file)


def test_what_does_not_change_a_result_is_not_compared(tiny):
    assert run_on_ranks.done(tiny, FILE, (*TINY, *run_on_ranks.QUIET,
                             "-pgran_output", "elsewhere.h5"))
    assert run_on_ranks.done(tiny, FILE, (*TINY, "-pgran_width", "8.0", "-pgran_inertia", "no"))


def test_an_incomplete_a_missing_or_a_broken_result_is_not_done(tmp_path):
    path = tmp_path / "x.h5"
    assert not run_on_ranks.done(path, FILE)
    written_result(path, complete=False)
    assert not run_on_ranks.done(path, FILE)
    written_result(path)
    assert run_on_ranks.done(path, FILE)
    path.write_bytes(path.read_bytes()[:100])
    assert not run_on_ranks.done(path, FILE)


def test_a_result_older_than_what_it_was_made_from_is_not_done(tmp_path):
    options, mode, path = (tmp_path / name for name in ("a.opts", "mode.h5", "x.h5"))
    shutil.copy(FILE, options)
    mode.write_text("")
    given = "-pgran_mode_file", mode
    written_result(path, *given)
    assert run_on_ranks.done(path, options, given)
    for newer in (options, mode):
        os.utime(newer, (2e9, 2e9))
        assert not run_on_ranks.done(path, options, given)
        os.utime(newer, (1e9, 1e9))


def test_a_changed_list_of_cases_repeats_the_runs_it_changes(tmp_path, monkeypatch, capsys):
    made, output = [], {}

    def pretend(ranks, *arguments, **more):
        path, options = arguments[-1], arguments[4:-2]
        made.append(result_file("", Path(path).stem).stem)
        parameters = run_on_ranks.asked(FILE, *options)
        output[Path(path).stem] = parameters.shear_modulus
        with h5py.File(path, "w") as file:
            file.create_group("snapshots")
            file.attrs.update(options=parameters.text(), complete=True, steps=1,
                              steps_repeated=0, newton_iterations=2, linear_iterations=3,
                              seconds=4.0, memory=5.0)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(run_on_ranks, "python", pretend)
    monkeypatch.setattr(sensitivity.band, "measure", lambda path: [])
    monkeypatch.setattr(sensitivity, "CASES", {"soft": ("-pgran_shear_modulus", 100), "base": ()})
    sensitivity.main(tmp_path)
    assert made == ["soft", "base"] and output == {"soft": 100.0, "base": 1000.0}
    sensitivity.CASES["soft"] = "-pgran_shear_modulus", 200
    sensitivity.main(tmp_path)
    assert made[2:] == ["soft"] and output["soft"] == 200.0
    assert "base.h5 is in place" in capsys.readouterr().err


def test_options_files_are_read_as_petsc_reads_them(tmp_path):
    path = tmp_path / "a.opts"
    path.write_text("# don't read -pgran_width 5\n-pgran_width 20  # d\n-pgran_inertia\n"
                    "-snes_atol 1e-4\n-pgran_body_force -1e-3,-.5\n")
    found = run_on_ranks.asked(path, "-pgran_height", 40, "-pgran_width", 10, "-pgran_width", 8)
    assert (found.width, found.height, found.inertia) == (8.0, 40.0, True)
    assert found.body_force == (-1e-3, -0.5)
    with pytest.raises(OptionError, match="there is no such file"):
        run_on_ranks.asked(tmp_path / "b.opts")
    with pytest.raises(ParameterError, match="integer multiple"):
        run_on_ranks.asked(path, "-pgran_element_size", 3)


def test_a_failed_run_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(run_on_ranks, "python", lambda *_, **__: SimpleNamespace(returncode=1))
    with pytest.raises(SolutionError, match="x.h5: the run ended with exit code 1"):
        run_on_ranks.run(tmp_path / "x.h5", FILE)
    assert run_on_ranks.run(tmp_path / "x.h5", FILE, needed=False) is None


@pytest.mark.parametrize("launcher, ranks, expected", [
    (None, 3, ["mpiexec", "-n", "3"]), (None, 0, []), ("srun", 2, ["srun"]),
    ("srun --mpi=pmix", 1, ["srun", "--mpi=pmix", "-n", "1"])])
def test_the_environment_says_how_runs_start(monkeypatch, launcher, ranks, expected):
    monkeypatch.setattr(run_on_ranks, "RANKS", 2)
    monkeypatch.setenv("PGRAN_PYTHON", "python9")
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "1")
    monkeypatch.setenv("OMPI_MCA_mpi_yield_when_idle", "1")
    monkeypatch.setenv("OMPI_MCA_hwloc_base_binding_policy", "none")
    monkeypatch.delenv("PGRAN_LAUNCH", raising=False)
    if launcher:
        monkeypatch.setenv("PGRAN_LAUNCH", launcher)
    command, environment = run_on_ranks.command(ranks, "-m", "pgran", "-pgran_width", 8)
    assert command == [*expected, "python9", "-m", "pgran", "-pgran_width", "8"]
    assert ("OMPI_COMM_WORLD_RANK" in environment) == bool(launcher)
    assert environment["OMPI_MCA_mpi_yield_when_idle"] == "1"
    assert environment["OMPI_MCA_hwloc_base_binding_policy"] == "none"
    assert environment["PYTHONPATH"].split(os.pathsep)[0] == str(ROOT)


def test_a_run_beyond_its_time_leaves_no_ranks_behind(tmp_path):
    path = tmp_path / "pids"
    code = (f"import os, time; open({str(path)!r}, 'a').write(f'{{os.getpid()}}\\n'); "
            "time.sleep(600)")
    with pytest.raises(subprocess.TimeoutExpired):
        run_on_ranks.python(2, "-c", code, timeout=allowed(3), stderr=subprocess.DEVNULL)
    states = [Path(f"/proc/{pid}/stat") for pid in path.read_text().split()]
    assert len(states) == 2  # they are gone, or wait to be reaped
    assert all(not state.exists() or ") Z " in state.read_text() for state in states)


# How studies start


def test_studies_are_listed_and_unknown_ones_refused(capsys):
    assert __main__.main(["-help"]) == 0
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in __main__.STUDIES)
    assert __main__.main(["posed", "-help"]) == 0
    assert "well-posed" in capsys.readouterr().out
    for arguments, message in ((["nothing"], "no such study"), (["verify", "a", "b"], "too many"),
                               (["section4"], "figure"), (["section4", "fig9"], "fig3 ... fig7"),
                               (["verify", "-pgran_widht", "3"], "did you mean -pgran_width"),
                               (["bench", "speed"], "answer | iterations")):
        assert __main__.main(arguments) == 1
        assert message in capsys.readouterr().err


def test_a_study_itself_starts_no_mpi_and_draws_nothing_at_once():
    code = ("import sys; from studies import __main__\n"
            "for name in __main__.STUDIES: __main__.load(name)\n"
            "print([name for name in ('petsc4py.PETSc', 'mpi4py.MPI', 'matplotlib') "
            "if name in sys.modules])")
    assert run_ranks(0, "-c", code).stdout.strip() == "[]"


def test_a_table_is_written_row_by_row(tmp_path, capsys):
    rows = Table(tmp_path / "new" / "x.csv", {"case": "", "I": ".1e", "n": "d"})
    rows.row("base", 1.0 / 3.0, None)
    assert table(rows.path) == [{"case": "base", "I": repr(1.0 / 3.0), "n": ""}]
    rows.note("stiff", "did not come to its end")
    assert len(table(rows.path)) == 2
    assert "| base | 3.3e-01 | - |\n| stiff | did not come to its end | - |" in (
        capsys.readouterr().out)
    with pytest.raises(ValueError, match="2 values for 3 columns"):
        rows.row(1, 2)


# Fits and transfer


def test_the_fitted_rate_is_that_of_an_exponential():
    time = np.linspace(0.0, 0.03, 400)
    span = 1e-4 * np.exp(355.0 * time)
    assert growth.fitted(time, span) == pytest.approx(355.0, rel=1e-9)
    saturated = span / np.sqrt(1.0 + (span / 0.05)**2)
    assert growth.fitted(time, saturated) == pytest.approx(355.0, rel=1e-2)
    bump = span + 2e-3 * np.exp(-((time - 0.001) / 5e-4)**2)  # what loading leaves
    assert growth.fitted(time, bump) == pytest.approx(355.0, rel=1e-6)


def test_nothing_is_fitted_where_nothing_grows():
    time = np.linspace(0.0, 0.03, 400)
    assert growth.fitted(time, np.full_like(time, 1e-3)) is None
    assert growth.fitted(time[::40], 1e-4 * np.exp(355.0 * time[::40]), (3e-4, 6e-4)) is None


def test_rates_are_extrapolated_to_a_step_of_zero():
    steps = np.array(specimen.STEPS)
    rates = [np.array([400.0 - 3e4 * dt + 1e7 * dt**2, 5.0 + 2j]) for dt in steps]
    rates[1] = np.append(rates[1], 3.0)
    found = specimen.at_zero(steps, rates)
    np.testing.assert_allclose(found, [400.0, 5.0 + 2j], rtol=1e-9)


def test_exponents_of_cost_are_recovered():
    N = np.array([1e4, 4e4, 16e4])
    time, last, space, base = bench.exponents(N, 2e-6 * N**1.2, 100.0 + 1e-3 * N)
    assert (time, last, space, base) == pytest.approx((1.2, 1.2, 1.0, 100.0))


def test_transfer_to_a_finer_mesh_is_exact_for_quadratic_fields(tmp_path):
    from pgran.space.element import SHAPE
    from studies.transfer import interpolated

    def fields(x1, x2):
        quadratic = 1.0 + x1 - x2 / 3.0 + (x1 * x2 - x1**2 * x2 + x1**2 * x2**2) / 50.0
        return {"coordinates": np.stack([x1 + 0.01 * x1 * x2, x2 - 0.02 * x2**2], axis=-1),
                "velocity": np.stack([quadratic, x1 - x2**2], axis=-1),
                "fluidity": 200.0 + quadratic, "pressure": 2.0 + x1 * x2 / 90.0 - x2,
                "deviator": np.stack([quadratic, -quadratic, x1 * x2], axis=-1)}

    path = tmp_path / "coarse.h5"
    with h5py.File(path, "w") as file:
        file.attrs["options"] = parameters(width=8, height=16, element_size=2).text()
        group = file.create_group("snapshots/0000")
        group.attrs["time"] = 0.25
        for name, value in fields(*np.meshgrid(np.arange(5) * 2.0, np.arange(9) * 2.0)).items():
            group[name] = value
    form = discretised(width=8, height=16, element_size=1, imperfection=1)
    state, nodes, corners = interpolated(form, path, 0), form.grid.nodes, form.grid.corners
    velocity, fluidity, pressure = form.grid.split(state.local)
    expected = fields(nodes.i / 2.0, nodes.j / 2.0)
    for found, name in ((state.x, "coordinates"), (velocity, "velocity"), (fluidity, "fluidity")):
        np.testing.assert_allclose(found.T, expected[name], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(pressure, fields(1.0 * corners.i, 1.0 * corners.j)["pressure"],
                               rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state.stress, SHAPE @ expected["deviator"].T[
        :, form.grid.element_nodes], rtol=1e-11, atol=1e-11)
    assert state.time == 0.25
    with pytest.raises(OptionError, match="2 x 4 elements are not divided by the 5 x 8"):
        interpolated(discretised(width=5, height=8, element_size=1, imperfection=1), path, 0)
    for wrong in (None, tmp_path / "none.h5"):
        with pytest.raises(OptionError, match="-from"):
            interpolated(form, wrong, 0)


# Tables of tiny runs


def test_one_step_tells_what_it_costs(tiny):
    found = json.loads(run_ranks(
        2, "jobs/bench/one_step.py", "-options_file", FILE, *SMALL, "-pgran_element_size", 1,
        "-from", tiny, "-dt", 1e-4, "-name", "x").stdout)
    norms = [row["residual"] for row in found["newton"]]
    assert found["name"] == "x" and found["ranks"] == 2 and norms[-1] < min(1e-4, norms[0])
    for row in found["newton"]:
        assert row["iterations"] > 0 and 0.0 < row["jacobian"] + row["evaluation"] < row["seconds"]


@pytest.mark.nightly
def test_finer_elements_bring_the_schur_complement_of_li_nearer_to_zero_in_flow(
        tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "BENCH", tmp_path)
    monkeypatch.setattr(bench, "COARSE", 2)
    monkeypatch.setattr(bench, "LI", {"before yielding": 0.001, "in flow": 0.003})
    monkeypatch.setattr(bench, "LI_STEP", 2e-3)
    first = dict([next(iter(bench.ITERATIVE.items()))])
    monkeypatch.setattr(bench, "ITERATIVE", first)
    bench.main("li", "2 1", options=SMALL)
    counts = [int(row["in flow"]) for row in table(tmp_path / "li.csv")]
    assert counts[1] > counts[0] > 3
    spectrum = table(tmp_path / "li_spectrum.csv")
    nearest = [float(row["in flow"].split()[0]) for row in spectrum]
    assert nearest[1] < 0.6 * nearest[0]  # 0.20 and 0.41


@pytest.mark.nightly
def test_large_specimens_are_counted_with_both_coarse_grids(tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "BENCH", tmp_path)
    bench.main("large", "40", "2")
    row, = table(tmp_path / "large.csv")
    assert row["elements"] == "300" and 1e-6 < float(row["0.06 %, dt"]) < 1e-3
    for solver in "biaxial.opts", "large.opts":
        assert 10 < int(row[f"0.04 %, {solver}"]) < 30 and 10 < int(row[f"0.06 %, {solver}"]) < 30


@pytest.mark.nightly
def test_the_table_of_sensitivities_has_a_row_for_each_snapshot(tmp_path, monkeypatch):
    monkeypatch.setattr(sensitivity, "CASES", {"base": (), "Jop": ("-pgran_law", "jop"),
                                               "no": ("-pgran_step_min", 5e-3)})
    sensitivity.main(tmp_path, options=TINY)
    rows = table(tmp_path / "sensitivity.csv")
    assert [row["case"] for row in rows] == ["base", "base", "Jop", "Jop", "no"]
    assert [float(row["compression"]) for row in rows[:2]] == pytest.approx([0.0005, 0.001])
    assert all(int(row["steps"]) > 3 and float(row["I max"]) > 0.0 for row in rows[:4])
    assert rows[4]["compression"] == "did not come to its end"


def test_shares_of_the_step_error_are_those_of_its_default():
    from pgran import cases

    default = cases.read({}).step_error
    named = {name: given[1] for name, given in sensitivity.CASES.items() if "step error" in name}
    assert len(named) == 2
    for name, value in named.items():
        assert float(name.split()[0]) == pytest.approx(value / default)


def test_the_answer_is_held_to_limits(tmp_path, monkeypatch):
    monkeypatch.setattr(verify, "CASES", {name: verify.CASES[name] for name in ("base", "stiff")})
    verify.main(tmp_path, options=TINY)
    base, stiff = table(tmp_path / "verify.csv")
    assert float(base["difference (%)"]) == 0.0 < float(stiff["difference (%)"]) < 3.0
    monkeypatch.setattr(verify, "LIMITS", {"stiff": 1e-9})
    with pytest.raises(SolutionError, match="beyond the limits: stiff"):
        verify.main(tmp_path, options=TINY)


@pytest.mark.nightly
def test_meshes_are_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "RESULTS", tmp_path)
    meshes.main("2 1", "2", options=TINY)
    row, = table(tmp_path / "meshes.csv")
    assert (row["model"], row["from (d)"], row["to (d)"], row["order"]) == ("ngf", "2", "1", "")
    assert 0.0 < float(row["over L2 norm (%)"]) < 5.0 and int(row["steps"]) > 3


@pytest.mark.nightly
def test_well_posed_and_ill_posed_laws_are_compared(tmp_path):
    posed.main("2 1", "0.003", tmp_path, options=SMALL)
    rows = table(tmp_path / "posed.csv")
    assert [row["law"] for row in rows] == ["bingham"] * 2 + ["barker_gray"] * 2
    for first, second in (rows[:2], rows[2:]):
        assert first["over L2 norm (%)"] == "" and float(second["over L2 norm (%)"]) > 0.0
        assert float(second["I from"]) < float(second["I to"]) and second["bands"]


@pytest.mark.nightly
def test_forms_of_ngf_are_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(primitive, "SHARES", (None, 1e-4))
    monkeypatch.setattr(primitive, "GROWTH", 0.01)  # too short for anything to grow
    primitive.main("4", tmp_path, options=TINY)
    steady, relaxing = table(tmp_path / "rates.csv")
    for row in (steady, relaxing):
        assert float(row["linearised step"]) == pytest.approx(float(row["closed form"]), rel=0.05)
        assert row["nonlinear run"] == row["for the shape then"] == ""
    assert float(relaxing["t0 (1/gdot0)"]) * float(steady["closed form"]) == pytest.approx(
        1e-4, rel=1e-3)
    for rate in ("wave", "column", "closed form"):
        assert 0.0 < float(relaxing[rate]) < float(steady[rate])
    rows = table(tmp_path / "primitive.csv")
    assert [row["t0/T"] for row in rows] == ["steady form"] * 2 + ["0.0001"] * 2
    assert float(rows[1]["difference (%)"]) == 0.0 < float(rows[3]["difference (%)"]) < 1.0
    assert all(row["onset (%)"] == "" and float(row["calm I/I0"]) > 0.9 for row in rows)
    assert (tmp_path / "primitive.png").stat().st_size > 10000


@pytest.mark.nightly
def test_the_map_of_regimes_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(regime, "WIDTHS", (20,))
    monkeypatch.setattr(regime, "NUMBERS", (1e-3, 1e-1))
    regime.main(tmp_path, options=SHORT)
    rows = table(tmp_path / "regime.csv")
    assert [float(row["I0"]) for row in rows] == [1e-3, 1e-1]
    assert (tmp_path / "regime.png").stat().st_size > 10000


def test_lines_of_the_map_are_the_closed_form():
    from pgran.material.laws.bingham import Bingham

    expected = growth_rate(Bingham(0.3819, 0.9377), "ngf", inertial_number=0.003, width=30.0,
                           height=90.0)
    assert regime.rates([1e-3, 0.003], [30.0])[0, 1] == pytest.approx(expected)


def test_the_linearised_step_goes_to_the_closed_form(tmp_path, monkeypatch):
    monkeypatch.setattr(specimen, "LARGE", ())
    specimen.steps_table(tmp_path, "-pgran_element_size", 4)
    rows = {row["step"]: float(row["fastest growth rate"])
            for row in table(tmp_path / "steps.csv")}
    assert rows["extrapolated to 0"] == pytest.approx(rows["closed form"], rel=5e-3)
    assert rows["column that creeps"] == pytest.approx(rows["closed form"], rel=0.12)
    assert specimen.later((), 0.02) == pytest.approx(0.96, abs=0.01)
    assert specimen.closed_form(("-pgran_plates_slip", "false")) is None


def test_a_mode_is_computed_once(tmp_path, monkeypatch):
    path = tmp_path / "mode.h5"
    rate, settings = growth.eigenmode(path, 4)
    assert settings["pgran_cell_elements"] == "4" and rate > 0.0
    monkeypatch.setattr(run_on_ranks, "python", lambda *_: pytest.fail("it is there"))
    assert growth.eigenmode(path, 4)[0] == rate
    with pytest.raises(pytest.fail.Exception):
        growth.eigenmode(path, 4, "-pgran_law", "jop")


def test_spectra_are_those_of_theory():
    found = spectra.single("ngf", "1e-3", "0.10,0.03", "-pgran_cell_elements", 16)
    assert found["relative_error"] < 2e-4
    rates = spectra.specimen("1e-3", 20, 4, "-eps_nev", 4)
    assert rates[0] == pytest.approx(-6.952, rel=1e-3)


def test_benches_make_their_tables(tmp_path, monkeypatch, capsys):
    def pretend(ranks, name, *options):
        size = float(options[options.index("-pgran_element_size") + 1])
        newton = [{"iterations": 14 + n, "seconds": 1.0 / size**2, "jacobian": 0.1}
                  for n in range(2)]
        return {"ranks": int(ranks), "element_size": size, "newton": newton,
                "unknowns": int(64000 / size**2), "memory": 100.0 + 10.0 / size**2}

    monkeypatch.setattr(bench, "BENCH", tmp_path)
    monkeypatch.setattr(bench, "step", pretend)
    bench.main("iterations", "2 1", "1 2")
    assert [row["before"] for row in table(tmp_path / "iterations.csv")] == ["14.5 (15)"] * 4
    bench.main("size", "2 1 0.5", "1", "")
    assert len(table(tmp_path / "size.csv")) == 3
    text = capsys.readouterr().out
    assert "means from 14.5 to 14.5: ratio 1.00" in text
    assert "multigrid, 1 ranks: time of a Newton iteration ~ N^1.00" in text


def test_the_runs_of_a_figure_are_those_that_it_draws(monkeypatch):
    made = {}
    monkeypatch.setattr(section4.run_on_ranks, "run", lambda path, file, *options: made.update(
        {path.stem: run_on_ranks.asked(file, *options)}))
    for figure, panels in figures.RUNS.items():
        made.clear()
        section4.runs(figure, figures.MESHES, ("-pgran_compression", 0.5))
        for name, compression in panels:
            width, I0, size = re.match(r".*_L(.*)_I(.*)_h(.*)", name).groups()
            found = made[name]
            assert compression in found.snapshots and name.startswith(found.model)
            assert (found.width, found.inertial_number, found.element_size) == (
                float(width), float(I0), float(size))


# jobs/


def test_jobs_only_start_studies():
    for path in SCRIPTS:
        text = path.read_text()
        assert not re.search(r"python\S* +-(c\b| )|<<.*(EOF|PYTHON)", text), path
        for name in re.findall(r"pgran\.studies (\w+)", text):
            assert name in __main__.STUDIES, path
    assert {path.name for path in ROOT.glob("jobs/**/*.py")} == {
        "compiled.py", "eigenvalue.py", "one_step.py"}


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_valid(path):
    subprocess.run(["bash", "-n", path], check=True)
    if shutil.which("shellcheck"):
        subprocess.run(["shellcheck", "-x", "-P", "SCRIPTDIR", "-S", "warning", path], check=True)


def test_a_job_starts_its_study():
    made = subprocess.run(["bash", "jobs/regime.sh", "-help"], text=True, capture_output=True,
                          env={**os.environ, "PGRAN_PYTHON": sys.executable}, check=True)
    assert "At which I0 and L does flow localise" in made.stdout


def test_a_table_of_runs_that_all_failed_is_an_error(tmp_path):
    table = Table(tmp_path / "t.csv", {"case": "", "angle": ".1f"})
    table.note("one", "did not come to its end")
    with pytest.raises(SolutionError, match="no run came to its end"):
        table.close()
    table.row("two", 51.0)
    table.close()


def test_flows_are_held_against_their_profiles(tmp_path, monkeypatch):
    monkeypatch.setattr(flows, "FLOWS", (("slope", "inclined_plane", (
        "-pgran_height", 5, "-pgran_slope", 24, "-pgran_grading", 2), (1, 0.5), ("ngf",)),))
    monkeypatch.setattr(flows, "LAWS", ("jop",))
    flows.main(tmp_path)
    coarse, fine = table(tmp_path / "flows.csv")
    assert float(fine["velocity"]) < 0.2 * float(coarse["velocity"]) < 0.01
    assert float(fine["order"]) > 2.0
    assert (tmp_path / "flow_inclined_plane.png").stat().st_size > 20000


@pytest.mark.nightly
def test_rates_of_flows_are_those_of_the_nonlinear_solver(tmp_path, monkeypatch):
    monkeypatch.setattr(flow_spectra, "FLOWS", ((
        "slope", "inclined_plane", ("-pgran_height", 4,), "slope", (25,), (0.5, 0.25)),))
    for name, value in (("NUMBERS", (1e-2,)), ("SIZES", (2,)), ("SQUARE", 4)):
        monkeypatch.setattr(flow_spectra, name, value)
    flow_spectra.main(tmp_path)
    coarse, fine = table(tmp_path / "decay.csv")
    assert abs(float(coarse["apart (%)"])) < 1.0 and float(coarse["nonlinear"]) < 0.0
    assert float(fine["to the mesh before (%)"]) < 5.0 and fine["nonlinear"] == ""
    assert [row["found to grow"] for row in table(tmp_path / "growth.csv")] == ["0", "0"]


@pytest.mark.nightly
def test_stopping_heights_agree_three_ways(tmp_path, monkeypatch):
    for name, value in (("SLOPES", (28,)), ("FLOWING", (1.01, 1.02)), ("ELEMENTS", 12),
                        ("FOLLOWED", (28,)), ("SHARES", (1.2,)), ("END", 300)):
        monkeypatch.setattr(stopping, name, value)
    stopping.main(tmp_path)
    row, = table(tmp_path / "stopping.csv")
    heights = [float(row[name]) for name in ("closed form (d)", "end of flow (d)",
                                             "zero of the eigenvalue (d)")]
    np.testing.assert_allclose(heights, heights[0], rtol=1e-3)
    for row in table(tmp_path / "followed.csv"):
        assert float(row["g at the end"]) == pytest.approx(float(row["g of theory"]), rel=0.05)
