"""Commands: help, version, the choice of output and solver, and options that have no effect."""

import pytest
from conftest import ROOT, run_ranks

import pgran
from pgran.cli import HELP, VERSION

COMMANDS = ("pgran", *(f"pgran.{name}" for name in (
    "eigen", "growth", "stability", "measure", "plot", "watch", "figures")))
#: A run of three steps.
SHORT = ("-options_file", str(ROOT / "options" / "direct.opts"), "-pgran_element_size", "20",
         "-pgran_compression", "0.0001")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_prints_its_help_and_its_version(command):
    bare = run_ranks(0, "-m", command, check=False)
    assert bare.returncode == 1 and "python -m" in bare.stdout and not bare.stderr
    assert run_ranks(0, "-m", command, HELP[0]).stdout == bare.stdout
    done = run_ranks(0, "-m", command, VERSION[0])
    assert done.stdout == f"pgran {pgran.__version__}\n" and not done.stderr


def test_help_is_printed_once_on_ranks():
    text = run_ranks(2, "-m", "pgran", check=False).stdout
    assert text.count("Options of a run:") == 1 and 15 <= len(text.splitlines()) <= 25
    for word in ("-options_file", "-help all", "-doctor", "biaxial", "ngf"):
        assert word in text


def test_a_command_in_a_process_with_petsc_uses_only_its_own_options(path):
    code = """
import sys, petsc4py
petsc4py.init(["other", "-pgran_width", "48"])
from petsc4py import PETSc
from pgran.__main__ import main
code = main(["pgran", *sys.argv[1:]])
assert PETSc.Options().getAll() == {"pgran_width": "48"}
sys.exit(code)
"""
    run_ranks(0, "-c", code, *SHORT, "-pgran_output", path)
    found = pgran.open(path).options
    assert (found["element_size"], found["width"], found["compression"]) == (20.0, 40.0, 1e-4)


def test_a_restart_continues_in_its_own_file_unless_the_command_line_names_another(tmp_path):
    (tmp_path / "file.opts").write_text(
        f"-options_file {SHORT[1]}\n-pgran_output {tmp_path}/of_file.h5\n")
    mine, other = tmp_path / "mine.h5", tmp_path / "other.h5"
    run = "-m", "pgran", *SHORT, "-options_file", tmp_path / "file.opts"
    run_ranks(0, *run, "-pgran_output", mine, "-ts_max_steps", 1)
    steps = len(pgran.open(mine).history["time"])
    run_ranks(0, *run, "-pgran_restart", mine, "-ts_max_steps", 2)
    assert len(pgran.open(mine).history["time"]) == steps + 1
    assert not (tmp_path / "of_file.h5").exists()
    run_ranks(0, *run, "-pgran_restart", mine, "-pgran_output", other)
    assert pgran.open(other).complete and not pgran.open(mine).complete


def test_a_steady_run_from_a_snapshot_writes_the_output_of_its_options_file(tmp_path, path):
    (tmp_path / "steady.opts").write_text(
        f"-options_file {ROOT}/options/steady.opts\n-pgran_output {tmp_path}/steady.h5\n")
    run_ranks(0, "-m", "pgran", *SHORT, "-pgran_output", path)
    before = path.read_bytes()
    run_ranks(0, "-m", "pgran", "-options_file", tmp_path / "steady.opts", "-pgran_element_size",
              20, "-pgran_restart", path)
    assert pgran.open(tmp_path / "steady.h5").complete and path.read_bytes() == before


@pytest.mark.parametrize("given, kind", [
    ({"element_size": 20, "model": "li", "shear_modulus": 200, "compression": 1e-4}, ()),
    ({"element_size": 2, "case": "planar_shear", "height": 4}, ("-ts_type", "pseudo"))], ids=str)
def test_python_and_the_command_line_choose_the_same_solver(tmp_path, path, given, kind):
    given = {**given, "step_first": 1e-3}
    words = [word for name, value in given.items() for word in (f"-pgran_{name}", value)]
    done = run_ranks(0, "-m", "pgran", *words, *kind, "-pgran_output", path)
    assert "no -pc_type is given; using the solver of options/" in done.stdout
    solvers = [set(found.attributes["solver_options"].split("\n")) - {"-ts_type beuler"}
               for found in (pgran.run(tmp_path / "python.h5", **given), pgran.open(path))]
    assert solvers[0] == solvers[1]


@pytest.mark.parametrize("command, given, message", [
    ("pgran.runs.run_on_ranks", ["{}/a.h5", SHORT[1], "-pgran_output", "{}/b.h5"],
     "b.h5: the result file of this run is "),
    ("pgran.growth", ["-pgran_restart", "x.h5"], "-pgran_restart x.h5: not allowed"),
    ("pgran.stability", ["-posedness", "-base_flow", "simple_shear"], "-base_flow: "),
    ("pgran.stability", ["-wave_vector", "0.1,0.1", "-end", "2"], "-end: ")])
def test_an_option_that_would_have_no_effect_is_refused(command, given, message, tmp_path):
    given = [text.format(tmp_path) for text in given]
    done = run_ranks(0, "-m", command, *given, check=False)
    assert done.returncode == 1 and message in done.stderr, done.stderr
    assert not list(tmp_path.iterdir())


def test_unused_options_of_petsc_are_reported_with_a_suggestion(path):
    done = run_ranks(0, "-m", "pgran", *SHORT, "-pgran_output", path, "-snes_rtoll", 1, "-log_viwe",
                     "-log_view", "-ts_view", "-ts_converged_reason", "-vec_nosuch", "x",
                     "-options_file", ROOT / "options" / "solver_mg_fixed.opts")
    assert "TS Object" in done.stdout
    assert done.stderr == (
        "pgran: warning: unused PETSc option(s): -log_viwe (did you mean -log_view?), "
        "-snes_rtoll 1 (did you mean -snes_rtol?), -vec_nosuch x\n")
