"""Commands run what their command line asks for, or print how they are used."""

import pytest
from conftest import ROOT, run_ranks

import pgran

COMMANDS = ("pgran", *(f"pgran.{name}" for name in (
    "eigen", "growth", "stability", "measure", "plot", "watch", "figures", "budget", "studies")))
#: A run of three steps.
SHORT = ("-options_file", str(ROOT / "options" / "direct.opts"), "-pgran_element_size", "20",
         "-pgran_compression", "0.0001")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_without_arguments_prints_its_usage_and_one_with_version_the_version(command,
                                                                                       tmp_path):
    code = ("import os, runpy, sys; os.chdir(sys.argv.pop(1)); module = sys.argv.pop(1); "
            "runpy.run_module(module, run_name='__main__', alter_sys=True)")
    bare = run_ranks(0, "-c", code, tmp_path, command, limit=60, check=False)
    assert bare.returncode == 1 and "python -m" in bare.stdout and not bare.stderr
    for flag in ("-version", "--version"):
        done = run_ranks(0, "-c", code, tmp_path, command, flag, limit=60)
        assert done.stdout == f"pgran {pgran.__version__}\n" and not done.stderr
    assert not list(tmp_path.iterdir())


def test_usage_and_version_are_printed_once_on_ranks():
    assert run_ranks(2, "-m", "pgran", "-version", limit=60).stdout == (
        f"pgran {pgran.__version__}\n")
    bare = run_ranks(2, "-m", "pgran", limit=60, check=False)
    assert bare.returncode == 1 and bare.stdout.count("Options of a run:") == 1


@pytest.mark.parametrize("name, wanted", [("-doctr", "-doctor"), ("-verson", "-version")])
def test_a_misspelt_request_does_not_start_a_run(name, wanted, tmp_path):
    done = run_ranks(0, "-m", "pgran", name, "-pgran_output", tmp_path / "x.h5", limit=60,
                     check=False)
    assert done.returncode == 1 and f"did you mean {wanted}?" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_command_in_a_process_that_has_petsc_obeys_its_command_line(tmp_path):
    """Its options hold, those of the process do not, and these are there again afterwards."""
    code = ("import sys, petsc4py; petsc4py.init(['other', '-pgran_width', '48'])\n"
            "from petsc4py import PETSc\n"
            "from pgran.__main__ import main\n"
            "code = main(['pgran', *sys.argv[1:]])\n"
            "assert PETSc.Options().getAll() == {'pgran_width': '48'}, PETSc.Options().getAll()\n"
            "sys.exit(code)")
    path = tmp_path / "x.h5"
    run_ranks(0, "-c", code, *SHORT, "-pgran_output", path, limit=60)
    found = pgran.open(path).options
    assert (found["element_size"], found["width"], found["compression"]) == (20.0, 40.0, 1e-4)
    late = run_ranks(0, "-c", code, *SHORT, "-pgran_output", path, "-log_view", limit=60,
                     check=False)
    assert late.returncode == 1 and "-log_view: PETSc reads this option only when it starts" in (
        late.stderr)


def test_a_budget_reads_options_that_follow_a_flag_of_petsc():
    plain = run_ranks(0, "-m", "pgran.budget", "-pgran_element_size", "1", limit=60).stdout
    assert run_ranks(0, "-m", "pgran.budget", "-snes_monitor", "-pgran_element_size", "1",
                     limit=60).stdout == plain
