"""Batch scripts: valid shell, time and memory in the header, and chains of runs."""

import os
import subprocess
import sys

import pytest
from conftest import ROOT

from pgran.output.result import Result
from pgran.runs import run_on_ranks

FILE = "options/biaxial.opts"
#: A run of about four seconds. Its file is also written at the first snapshot.
SMALL = ("-pgran_width 8 -pgran_height 24 -pgran_compression 0.01 -pgran_snapshots 0.005,0.01 "
         "-pgran_step_max 2e-4").split()


def written(folder, *arguments, check=True, **environment):
    """Write a batch script in a folder; return the finished process."""
    return subprocess.run(
        ["bash", ROOT / "jobs" / "cluster.sh", *arguments], cwd=folder, text=True, check=check,
        capture_output=True, env={**os.environ, "PGRAN_PYTHON": sys.executable, **environment})


@pytest.fixture
def folder(tmp_path):
    """A folder that looks like the repository."""
    for name in ("options", "jobs", "docs", "pgran"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


@pytest.mark.parametrize("system, directive, again", [
    ("slurm", "#SBATCH", "scontrol requeue"), ("pbs", "#PBS", "qsub")])
@pytest.mark.parametrize("arguments, name, header, command", [
    (["run", "2", FILE], "run-biaxial", "2 ranks, 24:00:00 hours, 1 GB", "ranks results/bi"),
    (["chain", "2", FILE, "-pgran_element_size", "0.25"], "chain-biaxial",
     "2 ranks, 24:00:00 hours, 3 GB", "--preserve-status --signal=USR1"),
    (["sweep", "1", "docs/examples/sweep.py", "4", "1", "2"], "sweep-sweep",
     "1 ranks, 01:00:00 hours, 2 GB", "0-3"),
    (["job", "8", "2", "12", "jobs/any.sh", "2 1 0.5"], "job-any",
     "8 ranks, 02:00:00 hours, 12 GB", r"jobs/any.sh 2\ 1\ 0.5")])
def test_a_script_is_valid_and_has_time_and_memory(folder, system, directive, again, arguments,
                                                   name, header, command):
    written(folder, system, *arguments)
    text = (folder / f"pgran-{name}.{system}").read_text()
    subprocess.run(["bash", "-n"], input=text, text=True, check=True)
    assert f"# Budget: {header}." in text and command in text
    assert directive in text and (again in text or "chain" not in name)


#: Replaces timeout: the signal is sent after some more steps, on any machine.
TIMEOUT = f"""#!{sys.executable}
import signal, subprocess, sys, time
from studies.kill import steps
assert sys.argv[1:4] == ["--preserve-status", "--signal=USR1", "3"], sys.argv
path = "results/biaxial.h5"
before, run = steps(path), subprocess.Popen(sys.argv[4:])
while run.poll() is None and steps(path) < before + 10:
    time.sleep(0.05)
run.send_signal(signal.SIGUSR1)
sys.exit(run.wait())
"""


def test_a_chain_is_queued_until_it_is_complete(folder):
    written(folder, "pbs", "chain", "1", FILE, *SMALL, PGRAN_TIME="00:00:05", PGRAN_MARGIN="2")
    for name, text in (("qsub", "#!/bin/sh\necho again >> queued\n"), ("timeout", TIMEOUT)):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    queue = folder / "queued"
    queue.touch()
    environment = {**run_on_ranks.command(0)[1], "PGRAN_PYTHON": sys.executable,
                   "PBS_O_WORKDIR": str(folder), "PATH": f"{folder}:{os.environ['PATH']}"}
    for link in range(1, 20):
        subprocess.run(["bash", "pgran-chain-biaxial.pbs"], cwd=folder, env=environment, check=True)
        if queue.read_text().count("again") < link:
            break
    assert Result(folder / "results" / "biaxial.h5").complete and link > 1


@pytest.mark.parametrize("options, result", [
    (["-pgran_output", "my/own run.h5"], "my/own\\ run.h5"),
    (["-options_file", "more.opts"], "of/file.h5")])
def test_result_time_and_memory_can_be_chosen(folder, options, result):
    (folder / "more.opts").write_text("-pgran_output of/file.h5\n")
    file = written(folder, "pbs", "run", "1", FILE, "-pgran_A", "0.5", *options,
                   PGRAN_TIME="03:30:00", PGRAN_MEMORY="7")
    text = (folder / file.stdout.strip()).read_text()
    assert f"run_on_ranks {result} {FILE} -pgran_A 0.5" in text
    assert "-pgran_output" not in text
    assert "mem=7gb\n" in text and "walltime=03:30:00\n" in text


def test_scripts_of_two_results_do_not_overwrite_each_other(folder):
    def chain(output, check=True):
        return written(folder, "pbs", "chain", "1", FILE, "-pgran_output", output, check=check)

    for name in ("a", "b", "a"):
        script = f"pgran-chain-{name}.pbs"
        assert chain(f"{name}.h5").stdout.strip() == script
        assert f"qsub {script}" in (folder / script).read_text()
    text = (folder / "pgran-chain-a.pbs").read_text()
    other = chain("other/a.h5", check=False)
    assert other.returncode == 1 and "writes another result" in other.stderr
    assert (folder / "pgran-chain-a.pbs").read_text() == text


@pytest.mark.parametrize("arguments, message", [
    (["lsf", "run", "2", FILE], "lsf: expected slurm or pbs"),
    (["slurm", "run", "0", FILE], "0: RANKS must be an integer > 0"),
    (["slurm", "run", "2", "options/none.opts"], "there is no such file"),
    (["pbs", "sweep", "1", "x.py"], "SCRIPT.py POINTS HOURS MEMORY_GB are required")])
def test_invalid_arguments_are_refused(folder, arguments, message):
    done = written(folder, *arguments, check=False)
    assert done.returncode == 1 and message in done.stderr
    assert not list(folder.glob("pgran-*"))
