"""An installation has its commands, says whether it fits together, and what a run will take."""

import configparser
import importlib.util

from conftest import ROOT, run_ranks

from pgran import doctor, scripts


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
