"""Invalid input is reported in one message, and existing files are left unchanged."""

import os

import h5py
import numpy as np
import pytest
from conftest import ROOT, refused, run_in_fork

DIRECT = "-options_file", str(ROOT / "options" / "direct.opts")
COARSE = "-pgran_element_size", "8"


def assert_refused(folder, command, arguments, message):
    """Assert that a command ends with one message and leaves the files unchanged."""
    before = sorted(folder.iterdir()), (folder / "keep.h5").read_bytes()
    refused(run_in_fork(f"pgran.{command}", *arguments, folder=folder), message)
    assert before == (sorted(folder.iterdir()), (folder / "keep.h5").read_bytes())


def result(path, x=(5, 5, 2), I=(5, 5), dtype="f8", **attributes):
    """Make a file that resembles a result."""
    with h5py.File(path, "w") as file:
        file.attrs.update(attributes)
        group = file.create_group("snapshots/0000")
        group.attrs["label"] = "now"
        if x:
            group["coordinates"] = np.stack(np.indices(x[:2], float)[::-1][:x[2]], axis=-1)
        group.create_dataset("inertial_number", data=np.ones(I, dtype=dtype))


#: Files of invalid input.
TEXTS = {"text.h5": "no HDF5\n", "empty.h5": "", "self.opts": "-options_file self.opts\n",
         "two.opts": "-pgran_width 40\n", "bare.opts": "pgran_width 40\n",
         "quote.opts": '-pgran_width "40\n',
         "home/.petscrc": "-pgran_width 40\nneither this nor that\n",
         "misspelt.opts": "-pgran_widht 40\n",
         "law.py": "raise RuntimeError('this law is not ready')\n",
         "shape.py": "from pgran.cases import Case\nclass A(Case):\n    shape = 2, -1\n"
                     "    def coordinates(self, i, j):\n        return i, j\n"
                     "class Lacking(Case):\n    pass\nclass Old(A):\n    rows = ()\n"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with an earlier result and with many kinds of invalid files."""
    folder = tmp_path_factory.mktemp("input")
    (folder / "home").mkdir()
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    result(folder / "keep.h5", run="one", options="-pgran_width 8\n-pgran_element_size 8\n"
           "-pgran_height 24\n")
    complete = (folder / "keep.h5").read_bytes()
    (folder / "truncated.h5").write_bytes(complete[:len(complete) // 2])
    with h5py.File(folder / "other.h5", "w") as file:
        file["data"] = np.arange(3)
    with h5py.File(folder / "nothing.h5", "w") as file:
        file.create_group("snapshots")
        file.attrs["options"] = ""
    small = {"options": "-pgran_width 8\n"}
    for name, more in {"flat": {"x": (5, 5, 1), **small}, "lost": {"x": None, **small},
                       "odd": {"I": (4, 5), **small}, "words": {"dtype": "S3", **small},
                       "untold": {}, "strange": {"options": "-pgran_mu_s many\n-pgran_nosuch 1\n"},
                       "mute": {"options": "neither this nor that\nx\n"}}.items():
        result(folder / f"{name}.h5", **more)
    os.mkfifo(folder / "pipe.h5")
    (folder / "folder.h5").mkdir()
    return folder


#: Arguments of `python -m pgran` in a line, and what the message must contain.
RUNS = {
    # words of the command line
    "nosuch": "nosuch: neither an option nor a value",
    "--pgran_width 40": "--pgran_width: options begin with one dash",
    "-prgan_mu_s 0.4": "did you mean -pgran_mu_s?",
    "-pgran_width -pgran_height 80": "-pgran_width",
    "-options_file=two.opts": "a blank separates name and value, as in -options_file two.opts",
    # options files
    "-options_file nosuch.opts": "nosuch.opts: there is no such file",
    "-options_file": "the file name is missing",
    "-options_file folder.h5": "cannot be read as text",
    "-options_file self.opts": "the file includes itself",
    "-options_file bare.opts": "bare.opts, line 1",
    "-options_file quote.opts": "quote.opts, line 1: no closing quotation",
    "-options_file misspelt.opts": "did you mean -pgran_width",
    # combinations
    "-pgran_element_size 7": "-pgran_width 40: ",
    "-pgran_inertia true -ts_type pseudo": "-pgran_inertia true",
    "-pgran_model ig": "-pgran_model ig: ", "-pgran_law barker_gray": "-pgran_law barker_gray has",
    "-pgran_shear_modulus 1e9": "-pgran_step_min 1e-08: ",
    "-pgran_snapshots 0.05,0.0500000001": "two times",
    "-pgran_element_size 1e-3": "more than the indices", "-pgran_element_size 0.01": "GB",
    "-pgran_A 1e300": "floating-point error",
    # components
    "-pgran_case nosuch.py:A": "there is no such file",
    "-pgran_case shape.py:B": "has no class B; it has A, Lacking, Old",
    "-pgran_case shape.py:Lacking": "shape.py:Lacking: Lacking lacks coordinates, shape",
    "-pgran_case shape.py:Old": "rows of Old", "-pgran_law law.py:Law": "this law is not ready",
    "-pgran_law shape.py:A": "is not a subclass", "-pgran_case shape.py:A": "its shape is",
    # output
    "-pgran_output /dev/null": "a file name that ends in .h5",
    "-pgran_output pipe.h5": "not a regular file",
    "-pgran_output keep.h5/x.h5": "-pgran_output keep.h5/x.h5: ",
    "-pgran_output keep.checkpoint_000049.h5": "name of a checkpoint of keep.h5",
    # restart and mode files
    **{f"-pgran_restart {kind}.h5": f"-pgran_restart {kind}.h5: " for kind in (
        "nosuch", "folder", "truncated", "pipe", "other", "strange", "untold", "mute", "keep")},
    "-pgran_restart keep.h5 -pgran_width 16 -pgran_mu_s 0.4":
        "cannot change -pgran_mu_s (here 0.4, there 0.3819), -pgran_width (here 16, there 8.0)",
    "-pgran_restart keep.h5 -pgran_restart_snapshot 0":
        "-pgran_restart_snapshot 0: requires -ts_type pseudo",
    **{f"-ts_type pseudo -pgran_restart {kind}.h5": f"-pgran_restart {kind}.h5: " for kind in (
        "text", "nothing", "lost", "keep")},
    "-ts_type pseudo -pgran_restart keep.h5 -pgran_restart_snapshot 7": "1 snapshot",
    "-pgran_mode_file keep.h5": "-pgran_mode_file keep.h5: ",
    # PETSc
    "-ts_type euler": "-ts_type euler: expected one of: beuler | pseudo",
    "-ts_max_steps 0": "-ts_max_steps 0: ", "-ts_init_time 0.001": "-ts_init_time 0.001: ",
    "-ts_dt 1e-4": "-ts_dt 1e-4: not allowed",
    "-ts_adapt_scale_solve_failed 1": "-ts_adapt_scale_solve_failed 1: ",
    "-snes_max_it -1": "-snes_max_it -1: ", "-snes_rtol nan": "-snes_rtol nan: must be a number",
    "-snes_error_if_not_converged": "-snes_error_if_not_converged 1: ",
    "-dm_mat_type nest -pc_type lu": "-dm_mat_type nest: requires -pc_type fieldsplit",
    "-pc_type nosuch": "-pc_type nosuch: Unknown type",
    "-fieldsplit_pressure_pc_python_type pgran.space.schur.BothEnds":
        "must be a class, such as pgran.space.schur.CahouetChabard",
    f"{' '.join(DIRECT)} -pgran_output keep.h5 -pc_factor_mat_solver_type nosuch":
        "-pc_factor_mat_solver_type nosuch",
    "-pc_type fieldsplit -pc_fieldsplit_0_fields 7 -ksp_type fgmres": "fields of this model are",
}


@pytest.mark.parametrize("line", RUNS)
def test_a_run_with_invalid_input_is_refused(folder, line):
    coarse = () if "-pgran_element_size" in line or "-pgran_case" in line else COARSE
    assert_refused(folder, "__main__", ["-pgran_output", "keep.h5", *coarse, *line.split()],
                   RUNS[line])


#: Other commands with their arguments, and what the message must contain.
COMMANDS = {
    "eigen -eps_nev 0": "-eps_nev 0: ", "eigen -target nan": "-target nan: must be",
    "eigen -st_type nosuch": "-st_type nosuch: Unknown type", "eigen -eps_tol abc": "-eps_tol abc",
    "eigen -wave_vector 1": "-wave_vector 1: must be 2 numbers",
    "eigen -wave_vector 1e8,1e8": "no eigenvalue converged",
    "eigen -pgran_output pipe.h5 -pgran_cell_elements 2": "not a regular file",
    "stability -cutoff -pgran_A 1e300": "floating-point error",
    "growth -dt inf": "-dt inf: must be",
    "growth -pgran_element_size 8 -mode /proc/m.h5": "-mode /proc/m.h5: ",
    "growth -dt 1e3 -pgran_element_size 8": "(-dt)", "growth -dt 1e-3,1e-3": "-dt 0.001,0.001: ",
    "measure nosuch.h5": "nosuch.h5",
    **{f"measure {kind}.h5": f"{kind}.h5: " for kind in (
        "truncated", "other", "nothing", "flat", "odd", "words", "lost", "pipe")},
    "measure -meshes keep.h5 other.h5": "other.h5: ",
    "measure -nosuch keep.h5": "unknown option -nosuch", "plot words.h5": "words.h5: ",
    "figures fig0": "unknown figure fig0", "figures fig6 -results nosuch": "nosuch",
    "stability -wave_vector": "-wave_vector: the value is missing",
    "stability bare": "bare"}


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_with_invalid_input_is_refused(folder, line):
    command, *arguments = line.split()
    case = ("-pgran_case", "periodic") if command == "eigen" else ()
    assert_refused(folder, command, [*case, *arguments], COMMANDS[line])


@pytest.mark.parametrize("name, value, message", [
    ("PETSC_OPTIONS", "-pgran_width 40 80", "80: neither an option nor a value"),
    ("PETSC_OPTIONS", "-pgran_width '40", "PETSC_OPTIONS: no closing quotation"),
    ("HOME", "home", ".petscrc, line 2")])
def test_all_sources_of_petsc_options_are_checked(folder, monkeypatch, name, value, message):
    monkeypatch.setenv(name, value)
    assert_refused(folder, "__main__", ["-pgran_output", "keep.h5", *COARSE], message)
