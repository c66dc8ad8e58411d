"""Entry points, optional packages, and the check of an installation."""

import configparser
import importlib.util

from conftest import ROOT, run_ranks

from pgran import doctor, scripts

SETUP = configparser.ConfigParser()
SETUP.read(ROOT / "setup.cfg")


def test_every_entry_point_starts_a_module_of_the_package():
    for line in filter(None, SETUP["options.entry_points"]["console_scripts"].split("\n")):
        command, _, target = line.partition(" = ")
        module, _, name = target.partition(":")
        started = getattr(scripts, name).args[0]
        assert module == "pgran.scripts" and importlib.util.find_spec(started)
        assert command == started.replace(".", "-")


def test_a_run_needs_neither_pyvista_nor_matplotlib(tmp_path):
    needed = SETUP["options"]["install_requires"]
    assert "pyvista" not in needed and "matplotlib" not in needed
    code = ("import sys; sys.modules.update(matplotlib=None, pyvista=None)\n"
            "from pgran.{} import main; sys.exit(main(sys.argv[{}:]))")
    run_ranks(0, "-c", code.format("__main__", 0), "-pgran_width", 4, "-pgran_height", 8,
              "-pgran_element_size", 2, "-ts_max_steps", 1, "-pgran_output", tmp_path / "run.h5")
    done = run_ranks(0, "-c", code.format("plot", 1), tmp_path / "run.h5", check=False)
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
