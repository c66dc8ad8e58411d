"""An installation has its commands, says whether it fits together, and what a run will take."""

import configparser
import importlib.util
import json

import pytest
from conftest import ROOT, run_ranks

from pgran import budget, doctor, scripts


def setup_cfg():
    parser = configparser.ConfigParser()
    parser.read(ROOT / "setup.cfg")
    return parser


def test_every_entry_point_starts_a_module_of_the_package():
    lines = setup_cfg()["options.entry_points"]["console_scripts"].split("\n")
    for line in filter(None, lines):
        command, _, target = line.partition(" = ")
        module, _, name = target.partition(":")
        started = getattr(scripts, name).args[0]
        assert module == "pgran.scripts" and importlib.util.find_spec(started)
        assert command == ("pgran" if started == "pgran" else started.replace(".", "-"))


def test_a_batch_node_needs_neither_pyvista_nor_matplotlib(tmp_path):
    needed = setup_cfg()["options"]["install_requires"]
    assert "pyvista" not in needed and "matplotlib" not in needed
    code = ("import sys; sys.modules.update(matplotlib=None, pyvista=None)\n"
            "from pgran.__main__ import main\n"
            "sys.exit(main(['pgran', '-pgran_width', '4', '-pgran_height', '8', "
            "'-pgran_element_size', '2', '-ts_max_steps', '1', '-pgran_output', sys.argv[1]]))")
    run_ranks(0, "-c", code, tmp_path / "run.h5")
    code = ("import sys; sys.modules.update(matplotlib=None, pyvista=None)\n"
            "from pgran.plot import main; sys.exit(main(sys.argv[1:]))")
    done = run_ranks(0, "-c", code, tmp_path / "run.h5", check=False)
    assert done.returncode == 1 and "pip install 'pgran[plot]'" in done.stderr


def test_the_doctor_finds_this_installation_good():
    text = run_ranks(0, "-m", "pgran", "-doctor").stdout
    assert text.splitlines()[-1] == "all fits together"
    for name in ("petsc4py 3.", "slepc4py 3.", "mpi4py with", "h5py", "scipy", "one MPI library"):
        assert f"ok  {name}" in text


def test_the_doctor_says_what_to_do(monkeypatch, capsys):
    found = {doctor.PETSC: {"version": [3, 17, 0], "real": False, "bits": 32, "mumps": False},
             doctor.SLEPC: {"version": [3, 18, 0]}, doctor.HDF5: "No module named 'h5py'",
             doctor.MPI: {"library": "x", "seconds": 3.0},
             doctor.TOGETHER: {"mpi": ["/a/libmpi.so", "/b/libmpi"]}}
    monkeypatch.setattr(doctor, "facts", lambda code: found.get(code, "none"))
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    assert doctor.main() == 1
    text = capsys.readouterr().out
    for cure in ("take a PETSc with real numbers", "its version must be that of petsc4py",
                 "-> install h5py", "-> install scipy", "rebuild mpi4py and h5py",
                 "install the MPI that mpi4py", "export PMIX_MCA_psec=native"):
        assert cure in text
    assert text.count("BAD") == 6


#: Element size, options file, seconds on two ranks of two machines, and MB (docs/performance.md,
#: docs/reproduction.md).
RUNS = [(2, "biaxial", 5.6, 7.3, 251), (1, "biaxial", 21.3, 22.4, 370),
        (0.5, "biaxial", 67.1, 67.1, 779), (0.25, "biaxial", 296.7, 296.7, 2370),
        (2, "li", 10, 10, 256), (1, "li", 79, 79, 407), (0.5, "li", 357, 357, 1064),
        (0.25, "li", 2413, 2413, 4082)]


@pytest.mark.parametrize("size, name, fast, slow, memory", RUNS)
def test_budgets_are_right_within_a_factor_of_two(size, name, fast, slow, memory, capsys):
    assert budget.main(["-options_file", str(ROOT / "options" / f"{name}.opts"), "-json",
                        "-pgran_element_size", str(size)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert slow / 2.0 < found["seconds"] < fast * 2.0
    assert memory / 2.0 < found["memory"] / 2**20 < memory * 2.0


def test_budgets_of_other_cases_need_the_iterations(capsys):
    given = ["-options_file", str(ROOT / "options" / "vertical_chute.opts")]
    assert budget.main(given) == 1
    assert "-newton: how many Newton iterations a run of vertical_chute" in capsys.readouterr().err
    assert budget.main([*given, "-newton", "40", "-ranks", "4"]) == 0
    assert "# Budget: 4 ranks, 1 hours" in capsys.readouterr().out


@pytest.mark.parametrize("user, allowed, library, refuses", [
    (0, False, "Open MPI v4.1.4", True), (0, True, "Open MPI v4.1.4", False),
    (1000, False, "Open MPI v4.1.4", False), (0, False, "MPICH Version: 4.0", False)])
def test_the_doctor_says_where_open_mpi_refuses_root(monkeypatch, user, allowed, library, refuses):
    monkeypatch.setattr(doctor.os, "geteuid", lambda: user)
    for name in doctor.ALLOW_ROOT:
        monkeypatch.setenv(name, "1") if allowed else monkeypatch.delenv(name, raising=False)
    mpi = {"library": library, "seconds": 0.1}
    assert doctor.refuses_root(mpi) == refuses
    if refuses:
        finding = doctor._launcher(mpi)
        assert not finding.good and "export OMPI_ALLOW_RUN_AS_ROOT=1" in finding.cure
