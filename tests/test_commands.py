"""Commands: installation, help, the choice of output and solver, options that have no effect."""

import configparser
import importlib.util

import pytest
from conftest import ROOT, pgran as run_pgran, run_ranks

import pgran
from pgran import doctor, scripts
from pgran.cli import HELP, VERSION

SETUP = configparser.ConfigParser()
SETUP.read(ROOT / "setup.cfg")
COMMANDS = ("pgran", *(f"pgran.{name}" for name in (
    "eigen", "growth", "stability", "measure", "plot", "watch", "figures")))
#: A run of three steps.
SHORT = "-pgran_element_size", "20", "-pgran_compression", "0.0001"


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
    options, mine, other = (tmp_path / name for name in ("file.opts", "mine.h5", "other.h5"))
    options.write_text(f"-options_file {ROOT}/options/direct.opts\n-pgran_output {tmp_path}/x.h5\n")
    run = "-m", "pgran", "-options_file", options, *SHORT
    run_ranks(0, *run, "-pgran_output", mine, "-ts_max_steps", 1)
    steps = len(pgran.open(mine).history["time"])
    run_ranks(0, *run, "-pgran_restart", mine, "-ts_max_steps", 2)
    assert len(pgran.open(mine).history["time"]) == steps + 1
    assert not (tmp_path / "x.h5").exists()
    run_ranks(0, *run, "-pgran_restart", mine, "-pgran_output", other)
    assert pgran.open(other).complete and not pgran.open(mine).complete


def test_a_steady_run_from_a_snapshot_writes_the_output_of_its_options_file(tmp_path, path):
    options, steady = tmp_path / "steady.opts", tmp_path / "steady.h5"
    options.write_text(f"-options_file {ROOT}/options/steady.opts\n-pgran_output {steady}\n")
    run_pgran(0, "direct.opts", path, *SHORT)
    before = path.read_bytes()
    run_ranks(0, "-m", "pgran", "-options_file", options, *SHORT[:2], "-pgran_restart", path)
    assert pgran.open(steady).complete and path.read_bytes() == before


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
    ("pgran.runs.run_on_ranks", ["{}/a.h5", "options/direct.opts", "-pgran_output", "{}/b.h5"],
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
    done = run_pgran(0, "direct.opts", path, *SHORT, "-snes_rtoll", 1, "-log_viwe", "-log_view",
                     "-ts_view", "-ts_converged_reason", "-vec_nosuch", "x", "-options_file",
                     ROOT / "options" / "solver_mg_fixed.opts")
    assert "TS Object" in done.stdout
    assert done.stderr == (
        "pgran: warning: unused PETSc option(s): -log_viwe (did you mean -log_view?), "
        "-snes_rtoll 1 (did you mean -snes_rtol?), -vec_nosuch x\n")


def test_every_entry_point_starts_a_module_of_the_package():
    for line in filter(None, SETUP["options.entry_points"]["console_scripts"].split("\n")):
        command, _, target = line.partition(" = ")
        module, _, name = target.partition(":")
        started = getattr(scripts, name).args[0]
        assert module == "pgran.scripts" and importlib.util.find_spec(started)
        assert command == started.replace(".", "-")


def test_a_run_needs_neither_pyvista_nor_matplotlib(path):
    needed = SETUP["options"]["install_requires"]
    assert "pyvista" not in needed and "matplotlib" not in needed
    missing = "import sys; sys.modules.update(matplotlib=None, pyvista=None)"
    run_pgran(0, "direct.opts", path, *SHORT, patch=missing)
    code = f"{missing}\nfrom pgran.plot import main; sys.exit(main(sys.argv[1:]))"
    done = run_ranks(0, "-c", code, path, check=False)
    assert done.returncode == 1 and "pip install 'pgran[plot]'" in done.stderr


def test_the_doctor_accepts_this_installation():
    text = run_ranks(0, "-m", "pgran", "-doctor").stdout
    assert text.splitlines()[-1] == "installation OK"
    for name in ("petsc4py 3.", "slepc4py 3.", "mpi4py with", "h5py", "scipy", "one MPI library"):
        assert f"ok  {name}" in text


def test_the_doctor_reports_problems_and_remedies(monkeypatch, capsys):
    found = {doctor.PETSC: {"version": [3, 17, 0], "real": False, "bits": 32, "mumps": "missing"},
             doctor.SLEPC: {"version": [3, 18, 0]}, doctor.HDF5: "No module named 'h5py'",
             doctor.MPI: {"library": "x"},
             doctor.TOGETHER: {"mpi": ["/a/libmpi.so", "/b/libmpi"]}}
    monkeypatch.setattr(doctor, "facts", lambda code: found.get(code, "not found"))
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    assert doctor.main() == 1
    text = capsys.readouterr().out
    for remedy in ("install PETSc with real numbers", "have different versions",
                   "-> install h5py", "-> install scipy", "rebuild mpi4py and h5py",
                   "install the MPI of mpi4py"):
        assert remedy in text
    assert text.count("BAD") == 8
