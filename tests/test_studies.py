"""Studies at tiny size, their tables, and which results are reused."""

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
from pgran.output import figures
from pgran.runs import run_on_ranks
from pgran.runs.table import Table
from studies import (
    __main__,
    bench,
    flow_spectra,
    flows,
    growth,
    meshes,
    primitive,
    regime,
    section4,
    sensitivity,
    specimen,
    spectra,
    stopping,
    study,
)

FILE = "options/biaxial.opts"
SMALL = "-pgran_width", 8, "-pgran_height", 24
SHORT = "-pgran_compression", 0.001, "-pgran_snapshots", 0.0005
TINY = (*SMALL, *SHORT)
SCRIPTS = sorted(ROOT.glob("jobs/**/*.sh"))


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(run_on_ranks, "RANKS", 1)  # fastest for tiny runs
    monkeypatch.delenv("PGRAN_DOCS", raising=False)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Return the path of the result of a tiny run."""
    path = tmp_path_factory.mktemp("studies") / "tiny.h5"
    run_ranks(0, "-m", "pgran.runs.run_on_ranks", path, FILE, *TINY)
    return path


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def written_result(path, *options, complete=True):
    """Write the root attributes of a run with options."""
    with h5py.File(path, "w") as file:
        file.attrs.update(options=run_on_ranks.requested_parameters(FILE, *options).text(), complete=complete)


# Runs


def test_a_result_is_reused_only_with_equal_options(tiny):
    large = "-options_file", ROOT / "options" / "large.opts"
    same = ((), ("-snes_atol", "5e-4"), (*run_on_ranks.QUIET, "-pgran_output", "elsewhere.h5"),
            ("-pgran_width", "8.0", "-pgran_inertia", "no"))
    other = (large, ("-pgran_shear_modulus", 100), ("-pgran_law", "jop"), ("-snes_atol", 1e-7),
             ("-pgran_inertia", "true"), ("-pgran_imperfection_size", 4),
             ("-pgran_snapshots", 0.0007))
    for more in same:
        assert run_on_ranks.done(tiny, FILE, (*TINY, *more)), more
    for more in other:
        assert not run_on_ranks.done(tiny, FILE, (*TINY, *more)), more
    assert not run_on_ranks.done(tiny, "options/li.opts", TINY)
    found = run_on_ranks.combined_options(FILE, *large, "-pgran_width", 8)
    assert found["pgran_coarse_correction"] == "true" and found["pgran_width"] == "8"


def test_options_that_a_run_adds_by_itself_are_not_compared(tmp_path):
    file, path = tmp_path / "few.opts", tmp_path / "few.h5"
    file.write_text("-ts_type pseudo\n-pgran_element_size 20\n-pgran_progress quiet\n")
    run_on_ranks.run(path, file, ranks=1)
    assert run_on_ranks.done(path, file)


def test_a_missing_incomplete_truncated_or_outdated_result_is_not_reused(tmp_path):
    options, mode, path = (tmp_path / name for name in ("a.opts", "mode.h5", "x.h5"))
    assert not run_on_ranks.done(path, FILE)
    written_result(path, complete=False)
    assert not run_on_ranks.done(path, FILE)
    written_result(path)
    assert run_on_ranks.done(path, FILE)
    path.write_bytes(path.read_bytes()[:100])
    assert not run_on_ranks.done(path, FILE)
    shutil.copy(FILE, options)
    mode.write_text("")
    start = "-pgran_mode_file", mode
    written_result(path, *start)
    assert run_on_ranks.done(path, options, start)
    for newer in (options, mode):
        os.utime(newer, (2e9, 2e9))
        assert not run_on_ranks.done(path, options, start)
        os.utime(newer, (1e9, 1e9))


def test_options_files_are_read_as_petsc_reads_them(tmp_path):
    path = tmp_path / "a.opts"
    path.write_text("# don't read -pgran_width 5\n-pgran_width 20  # d\n-pgran_inertia\n"
                    "-snes_atol 1e-4\n-pgran_body_force -1e-3,-.5\n")
    found = run_on_ranks.requested_parameters(path, "-pgran_height", 40, "-pgran_width", 10, "-pgran_width", 8)
    assert (found.width, found.height, found.inertia) == (8.0, 40.0, True)
    assert found.body_force == (-1e-3, -0.5)
    with pytest.raises(OptionError):
        run_on_ranks.requested_parameters(tmp_path / "b.opts")
    with pytest.raises(ParameterError):
        run_on_ranks.requested_parameters(path, "-pgran_element_size", 3)


def test_a_failed_run_is_an_error_or_a_note(tmp_path, monkeypatch):
    monkeypatch.setattr(run_on_ranks, "python", lambda *_, **__: SimpleNamespace(returncode=1))
    with pytest.raises(SolutionError, match="x.h5: the run ended with exit code 1"):
        run_on_ranks.run(tmp_path / "x.h5", FILE)
    rows = Table(tmp_path / "t.csv", {"case": "", "angle": ".1f"})
    assert study.attempt(rows, ("one",), tmp_path / "x.h5", "biaxial") is None
    with pytest.raises(SolutionError):
        rows.close()


@pytest.mark.parametrize("launcher, ranks, expected", [
    (None, 3, ["mpiexec", "-n", "3"]), (None, 0, []), ("srun", 2, ["srun"]),
    ("srun --mpi=pmix", 1, ["srun", "--mpi=pmix", "-n", "1"])])
def test_the_environment_determines_how_runs_start(monkeypatch, launcher, ranks, expected):
    monkeypatch.setattr(run_on_ranks, "RANKS", 2)
    for name, value in (("PGRAN_PYTHON", "python9"), ("OMPI_COMM_WORLD_RANK", "1"),
                        ("OMPI_MCA_mpi_yield_when_idle", "1")):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("PGRAN_LAUNCH", raising=False)
    if launcher:
        monkeypatch.setenv("PGRAN_LAUNCH", launcher)
    command, environment = run_on_ranks.command(ranks, "-m", "pgran", "-pgran_width", 8)
    assert command == [*expected, "python9", "-m", "pgran", "-pgran_width", "8"]
    assert ("OMPI_COMM_WORLD_RANK" in environment) == bool(launcher)
    assert environment["OMPI_MCA_mpi_yield_when_idle"] == "1"
    assert environment["PYTHONPATH"].split(os.pathsep)[0] == str(ROOT)


def test_a_run_beyond_its_time_limit_leaves_no_ranks_behind(tmp_path):
    path = tmp_path / "pids"
    code = (f"import os, time; open({str(path)!r}, 'a').write(f'{{os.getpid()}}\\n'); "
            "time.sleep(600)")
    with pytest.raises(subprocess.TimeoutExpired):
        run_on_ranks.python(2, "-c", code, timeout=allowed(3), stderr=subprocess.DEVNULL)
    states = [Path(f"/proc/{pid}/stat") for pid in path.read_text().split()]
    assert len(states) == 2  # they have ended, or are zombies
    assert all(not state.exists() or ") Z " in state.read_text() for state in states)


# Command and tables


def test_studies_are_listed_and_wrong_arguments_refused(capsys):
    assert __main__.main(["-help"]) == 0
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in __main__.STUDIES)
    assert __main__.main(["meshes", "-help"]) == 0
    assert "well-posed" in capsys.readouterr().out
    for arguments, message in ((["nothing"], "unknown study"), (["regime", "a", "b"], "too many"),
                               (["section4"], "figure"), (["section4", "fig9"], "fig3, fig4"),
                               (["regime", "-pgran_widht", "3"], "did you mean -pgran_width"),
                               (["bench", "speed"], "answer, iterations"),
                               (["kill", "abc"], "must be an integer >= 0")):
        assert __main__.main(arguments) == 1
        assert message in capsys.readouterr().err


def test_a_study_starts_no_mpi_and_imports_no_matplotlib():
    code = ("import sys; from studies import __main__\n"
            "for name in __main__.STUDIES: __main__.load(name)\n"
            "print([name for name in ('petsc4py.PETSc', 'mpi4py.MPI', 'matplotlib') "
            "if name in sys.modules])")
    assert run_ranks(0, "-c", code).stdout.strip() == "[]"


def test_a_report_is_written_row_by_row_with_its_release(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PGRAN_DOCS", str(tmp_path / "docs"))
    rows = study.Report(tmp_path / "new" / "x.csv", {"case": "", "I": ".1e", "n": "d"}, "page")
    rows.row("base", 1.0 / 3.0, None)
    assert table(rows.path) == [{"case": "base", "I": repr(1.0 / 3.0), "n": ""}]
    rows.note("stiff", study.FAILED)
    page = (tmp_path / "docs" / "generated" / "page.md").read_text()
    assert "| base | 3.3e-01 | - |\n| stiff | failed | - |\n\npgran 0." in page
    assert "| base | 3.3e-01 | - |" in capsys.readouterr().out
    with pytest.raises(ValueError, match="2 values for 3 columns"):
        rows.row(1, 2)


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_valid(path):
    subprocess.run(["bash", "-n", path], check=True)
    if shutil.which("shellcheck"):
        subprocess.run(["shellcheck", "-x", "-P", "SCRIPTDIR", "-S", "warning", path], check=True)


def test_the_script_starts_a_study():
    made = subprocess.run(["bash", "jobs/study.sh", "regime", "-help"], text=True,
                          capture_output=True, env={**os.environ, "PGRAN_PYTHON": sys.executable},
                          check=True)
    assert "Map of localisation" in made.stdout


# Measurements


def test_the_growth_rate_of_an_exponential_is_recovered():
    time = np.linspace(0.0, 0.03, 400)
    span = 1e-4 * np.exp(355.0 * time)
    bump = span + 2e-3 * np.exp(-((time - 0.001) / 5e-4)**2)  # remains of the loading
    for values, error in ((span, 1e-9), (bump, 1e-6),
                          (span / np.sqrt(1.0 + (span / 0.05)**2), 1e-2)):
        assert growth.fitted(time, values) == pytest.approx(355.0, rel=error)
    assert growth.fitted(time, np.full_like(time, 1e-3)) is None
    assert growth.fitted(time[::40], span[::40], (3e-4, 6e-4)) is None
    steps = np.array(specimen.STEPS)
    rates = [np.array([400.0 - 3e4 * dt + 1e7 * dt**2, 5.0 + 2j]) for dt in steps]
    rates[1] = np.append(rates[1], 3.0)
    np.testing.assert_allclose(specimen.at_zero(steps, rates), [400.0, 5.0 + 2j], rtol=1e-9)
    N = np.array([1e4, 4e4, 16e4])
    assert bench.exponents(N, 2e-6 * N**1.2, 100.0 + 1e-3 * N) == pytest.approx((1.2, 1.0, 100.0))


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
    for wrong in (None, tmp_path / "none.h5"):
        with pytest.raises(OptionError, match="-from"):
            interpolated(form, wrong, 0)


def test_one_step_reports_its_cost(tiny):
    found = json.loads(run_ranks(
        2, "-m", "studies.one_step", "-options_file", FILE, *SMALL, "-pgran_element_size", 1,
        "-from", tiny, "-dt", 1e-4, "-name", "x").stdout)
    norms = [row["residual"] for row in found["newton"]]
    assert found["name"] == "x" and found["ranks"] == 2 and norms[-1] < min(1e-4, norms[0])
    for row in found["newton"]:
        assert row["iterations"] > 0 and 0.0 < row["jacobian"] + row["evaluation"] < row["seconds"]


# Tiny studies


def test_a_difference_beyond_its_limit_fails_the_study(tmp_path, monkeypatch):
    cases = {name: sensitivity.CASES[name] for name in ("base", "G = 1e4")}
    monkeypatch.setattr(sensitivity, "CASES", {**cases, "no": ("-pgran_step_min", 5e-3)})
    sensitivity.main(tmp_path, options=TINY)
    rows = table(tmp_path / "sensitivity.csv")
    assert [row["case"] for row in rows] == ["base"] * 2 + ["G = 1e4"] * 2 + ["no"]
    assert [float(row["compression"]) for row in rows[:2]] == pytest.approx([0.0005, 0.001])
    assert float(rows[1]["difference (%)"]) == 0.0 < float(rows[3]["difference (%)"]) < 3.0
    monkeypatch.setattr(sensitivity, "LIMITS", {"G = 1e4": 1e-9})
    with pytest.raises(SolutionError, match="limit: G = 1e4"):
        sensitivity.main(tmp_path, options=TINY)


def test_the_linearised_step_tends_to_the_analytical_growth_rate(tmp_path, monkeypatch):
    monkeypatch.setattr(specimen, "LARGE", ())
    specimen.steps_table(tmp_path, "-pgran_element_size", 4)
    rows = {row["step"]: float(row["fastest growth rate"])
            for row in table(tmp_path / "steps.csv")}
    assert rows["extrapolated to 0"] == pytest.approx(rows["analytical"], rel=5e-3)
    assert rows["column"] == pytest.approx(rows["analytical"], rel=0.12)
    assert specimen.later((), 0.02) == pytest.approx(0.96, abs=0.01)
    assert specimen.analytical(("-pgran_plates_slip", "false")) is None
    assert regime.rates([0.001], [40.0])[0, 0] == pytest.approx(413.17, rel=1e-4)


def test_a_mode_is_computed_once_and_spectra_agree_with_theory(tmp_path, monkeypatch):
    path = tmp_path / "mode.h5"
    rate, options = growth.eigenmode(path, 4)
    assert options["pgran_cell_elements"] == "4" and rate > 0.0
    found = spectra.single("ngf", "1e-3", "0.10,0.03", "-pgran_cell_elements", 16)
    assert found["relative_error"] < 2e-4
    rates = spectra.specimen("1e-3", 20, 4, "-eps_nev", 4)
    assert rates[0] == pytest.approx(-6.952, rel=1e-3)
    monkeypatch.setattr(run_on_ranks, "python", lambda *_: pytest.fail("the mode exists"))
    assert growth.eigenmode(path, 4)[0] == rate
    with pytest.raises(pytest.fail.Exception):
        growth.eigenmode(path, 4, "-pgran_law", "jop")


def test_the_runs_of_a_figure_are_the_runs_that_it_draws(monkeypatch):
    made = {}
    monkeypatch.setattr(section4.run_on_ranks, "run", lambda path, file, *options: made.update(
        {path.stem: run_on_ranks.requested_parameters(file, *options)}))
    for figure, panels in figures.RUNS.items():
        made.clear()
        section4.runs(figure, figures.MESHES, ("-pgran_compression", 0.5))
        for name, compression in panels:
            width, I0, size = re.match(r".*_L(.*)_I(.*)_h(.*)", name).groups()
            found = made[name]
            assert compression in found.snapshots and name.startswith(found.model)
            assert (found.width, found.inertial_number, found.element_size) == (
                float(width), float(I0), float(size))


def test_flows_converge_to_their_profiles(tmp_path, monkeypatch):
    monkeypatch.setattr(flows, "FLOWS", (("slope", "inclined_plane", (
        "-pgran_height", 5, "-pgran_slope", 24, "-pgran_grading", 2), (1, 0.5), ("ngf",)),))
    monkeypatch.setattr(flows, "LAWS", ("jop",))
    flows.main(tmp_path)
    coarse, fine = table(tmp_path / "flows.csv")
    assert float(fine["velocity"]) < 0.2 * float(coarse["velocity"]) < 0.01
    assert float(fine["order"]) > 2.0
    assert (tmp_path / "flow_inclined_plane.png").stat().st_size > 20000


@pytest.mark.nightly
@pytest.mark.parametrize("module, constants, arguments, pages", [
    (meshes, {"RESULTS": None}, ("2 1", "2", "0.003"), ["meshes"]),
    (primitive, {"SHARES": (None, 1e-4), "GROWTH": 0.01}, ("4", None), ["rates", "primitive"]),
    (regime, {"WIDTHS": (20,), "NUMBERS": (1e-3, 1e-1)}, (None,), ["regime"]),
    (bench, {"BENCH": None}, ("large", "40", "2"), ["large"]),
    (flow_spectra, {"FLOWS": (("slope", "inclined_plane", ("-pgran_height", 4,), "slope", (25,),
                               (0.5, 0.25)),), "NUMBERS": (1e-2,), "SIZES": (2,), "SQUARE": 4},
     (None,), ["decay", "growth"]),
    (stopping, {"SLOPES": (28,), "FLOWING": (1.01, 1.02), "ELEMENTS": 12, "FOLLOWED": (28,),
                "SHARES": (1.2,), "END": 300}, (None,), ["stopping", "followed"])],
    ids=lambda value: getattr(value, "__name__", None))
def test_a_study_completes_at_tiny_size(tmp_path, monkeypatch, module, constants, arguments, pages):
    for name, value in constants.items():
        monkeypatch.setattr(module, name, tmp_path if value is None else value)
    small = {meshes: SMALL, primitive: TINY, regime: SHORT}.get(module, ())
    module.main(*(tmp_path if text is None else text for text in arguments), options=small)
    rows = {page: table(tmp_path / f"{page}.csv") for page in pages}
    assert all(rows.values()) and study.FAILED not in str(rows)
    if module is stopping:
        row, = rows["stopping"]
        heights = [float(row[name]) for name in ("analytical (d)", "end of flow (d)",
                                                 "zero of the eigenvalue (d)")]
        np.testing.assert_allclose(heights, heights[0], rtol=1e-3)
    if module is flow_spectra:
        assert abs(float(rows["decay"][0]["difference (%)"])) < 1.0
