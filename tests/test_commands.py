"""Commands run what their command line asks for, or print how they are used."""

import pytest
from conftest import ROOT, run_ranks

import pgran

COMMANDS = ("pgran", *(f"pgran.{name}" for name in (
    "eigen", "growth", "stability", "measure", "plot", "watch", "figures")))
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


def test_a_restart_continues_in_its_own_file_unless_the_command_line_names_another(tmp_path):
    (tmp_path / "file.opts").write_text("".join(
        f"{name} {value}\n" for name, value in zip(SHORT[2::2], SHORT[3::2]))
        + f"-options_file {SHORT[1]}\n-pgran_output {tmp_path}/of_file.h5\n")
    mine, other = tmp_path / "mine.h5", tmp_path / "other.h5"
    run = "-m", "pgran", "-options_file", tmp_path / "file.opts"
    run_ranks(0, *run, "-pgran_output", mine, "-ts_max_steps", 1, limit=60)
    steps = len(pgran.open(mine).history["time"])
    run_ranks(0, *run, "-pgran_restart", mine, "-ts_max_steps", 2, limit=60)
    assert len(pgran.open(mine).history["time"]) == steps + 1
    assert not (tmp_path / "of_file.h5").exists()
    run_ranks(0, *run, "-pgran_restart", mine, "-pgran_output", other, limit=60)
    assert pgran.open(other).complete and not pgran.open(mine).complete


def test_a_steady_run_from_a_snapshot_writes_the_output_of_its_options_file(tmp_path):
    (tmp_path / "steady.opts").write_text(
        f"-options_file {ROOT}/options/steady.opts\n-pgran_output {tmp_path}/steady.h5\n")
    run_ranks(0, "-m", "pgran", *SHORT, "-pgran_output", tmp_path / "time.h5", limit=60)
    before = (tmp_path / "time.h5").read_bytes()
    run_ranks(0, "-m", "pgran", "-options_file", tmp_path / "steady.opts", "-pgran_element_size",
              20, "-pgran_restart", tmp_path / "time.h5", limit=60)
    assert pgran.open(tmp_path / "steady.h5").complete
    assert (tmp_path / "time.h5").read_bytes() == before


def test_launch_refuses_another_result_file_than_its_own(tmp_path):
    done = run_ranks(0, "-m", "pgran.runs.run_on_ranks", tmp_path / "a.h5", SHORT[1],
                     "-pgran_output", tmp_path / "b.h5", limit=60, check=False)
    assert done.returncode == 1 and not list(tmp_path.iterdir())
    assert f"-pgran_output {tmp_path}/b.h5: the result file of this run is {tmp_path}/a.h5" in (
        done.stderr)


@pytest.mark.parametrize("command, given, message", [
    ("pgran", [*SHORT, "-ts_dt", "1e-4"], "-ts_dt 1e-4: not allowed; use "
     "-pgran_step_first"),
    ("pgran.growth", ["-pgran_restart", "x.h5"], "-pgran_restart x.h5: the reference flow"),
    ("pgran.stability", ["-cutoff", "-parity", "barrel"], "-parity: allowed only with -specimen"),
    ("pgran.stability", ["-posedness", "-base_flow", "simple_shear"], "-base_flow: allowed only"),
    ("pgran.stability", ["-wave_vector", "0.1,0.1", "-end", "2"], "-end 2: allowed only with")])
def test_an_option_that_would_be_ignored_is_refused(command, given, message, tmp_path):
    output = ("-pgran_output", tmp_path / "x.h5") if command == "pgran" else ()
    done = run_ranks(0, "-m", command, *given, *output, limit=60, check=False)
    assert done.returncode == 1 and message in done.stderr, done.stderr
    assert not list(tmp_path.iterdir())


def test_an_options_file_of_multigrid_after_one_of_mumps_gives_no_note(tmp_path):
    done = run_ranks(0, "-m", "pgran", "-options_file", ROOT / "options" / "planar_shear.opts",
                     "-options_file", ROOT / "options" / "flows_mg.opts", "-pgran_height", 4,
                     "-pgran_output", tmp_path / "x.h5", limit=60)
    assert "nothing has read" not in done.stderr
