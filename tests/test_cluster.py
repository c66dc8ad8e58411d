"""Batch scripts: valid, with their budget, and a chain that goes on until it is finished."""

import os
import re
import subprocess
import sys

import pytest
from conftest import ROOT, allowed

from pgran.output.result import Result
from pgran.runs import run_on_ranks

#: A run of some two seconds.
SMALL = ("-pgran_width", "8", "-pgran_height", "24", "-pgran_element_size", "2",
         "-pgran_compression", "0.01", "-pgran_snapshots", "0.005,0.01", "-pgran_step_max", "4e-4")
KINDS = {"run": ["2", "options/biaxial.opts", "-pgran_element_size", "1"],
         "chain": ["2", "options/biaxial.opts", "-pgran_element_size", "1"],
         "sweep": ["1", "docs/examples/sweep.py", "4", "1", "2"], "scaling": ["8"],
         "job": ["8", "2", "12", "jobs/study.sh", "section4", "fig6", "2 1 0.5 0.25"]}


def made(folder, *arguments, check=True, **more):
    """Make a batch script in a folder; return the finished process."""
    return subprocess.run(
        ["bash", ROOT / "jobs" / "cluster.sh", *arguments], cwd=folder, text=True, check=check,
        capture_output=True, env={**os.environ, "PGRAN_PYTHON": sys.executable, **more})


@pytest.fixture
def folder(tmp_path):
    """A folder that looks like the repository."""
    for name in ("options", "jobs", "docs", "pgran"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


@pytest.mark.parametrize("system", ["slurm", "pbs"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_script_is_valid_and_has_its_budget(folder, system, kind):
    made(folder, system, kind, *KINDS[kind])
    name = {"scaling": "", "sweep": "-sweep", "job": "-study-section4_fig6"}.get(kind, "-biaxial")
    text = (folder / f"pgran-{kind}{name}.{system}").read_text()
    subprocess.run(["bash", "-n"], input=text, text=True, check=True)
    ranks = KINDS[kind][0]
    assert re.search(rf"# Budget: {ranks} ranks, \d+:00:00 hours, \d+ GB\.", text)
    directive = "#SBATCH" if system == "slurm" else "#PBS"
    wanted = {"chain": "--preserve-status --signal=USR1", "sweep": "0-3", "run": "launch results",
              "scaling": 'study.sh bench weak "1 2 4 8"',
              "job": r"jobs/study.sh section4 fig6 2\ 1\ 0.5\ 0.25"}
    assert directive in text and wanted[kind] in text
    assert ("qsub" if system == "pbs" else "scontrol requeue") in text or kind != "chain"


#: In place of timeout: its signal comes when the run has done some more steps, on any machine.
TIMEOUT = f"""#!{sys.executable}
import signal, subprocess, sys, time
from pgran.output.result import Result
assert sys.argv[1:4] == ["--preserve-status", "--signal=USR1", "3"], sys.argv

def steps():
    try:
        return len(Result("results/biaxial.h5").history["time"])
    except (OSError, KeyError, ValueError):
        return 0

before, run = steps(), subprocess.Popen(sys.argv[4:])
while run.poll() is None and steps() < before + 20:
    time.sleep(0.05)
run.send_signal(signal.SIGUSR1)
sys.exit(run.wait())
"""


def test_a_chain_goes_on_until_it_is_finished_with_the_answer_of_one_run(folder):
    """Without a batch system: qsub, as a script that tells, queues it again."""
    made(folder, "pbs", "chain", "1", "options/biaxial.opts", *SMALL, PGRAN_TIME="00:00:05",
         PGRAN_MARGIN="2")
    for name, text in (("qsub", "#!/bin/sh\necho again >> queued\n"), ("timeout", TIMEOUT)):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    environment = {**run_on_ranks.command(0)[1], "PGRAN_PYTHON": sys.executable,
                   "PBS_O_WORKDIR": str(folder), "PATH": f"{folder}:{os.environ['PATH']}"}
    for link in range(1, 20):
        done = subprocess.run(["bash", "pgran-chain-biaxial.pbs"], cwd=folder, env=environment,
                              check=False, timeout=allowed(60), capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        queued = (folder / "queued").read_text().count("again") if (folder / "queued").exists() \
            else 0
        if queued < link:
            break
    result = Result(folder / "results" / "biaxial.h5")
    assert result.complete and queued >= 1
    subprocess.run([sys.executable, "-m", "pgran", "-options_file", "options/biaxial.opts", *SMALL,
                    "-pgran_output", "whole.h5"], cwd=folder, env=environment, check=True,
                   timeout=allowed(120), capture_output=True)
    whole = Result(folder / "whole.h5")
    assert len(whole.history["time"]) == len(result.history["time"])
    for name in ("pressure", "fluidity"):
        assert result.snapshots[-1][name] == pytest.approx(whole.snapshots[-1][name], rel=1e-6)


@pytest.mark.parametrize("given, result", [
    ([], "results/biaxial.h5"), (["-pgran_output", "my/own run.h5"], "my/own\\ run.h5"),
    (["-options_file", "more.opts"], "of/file.h5")])
def test_a_script_writes_the_result_that_is_asked_for(folder, given, result):
    (folder / "more.opts").write_text("-pgran_output of/file.h5\n")
    file = made(folder, "pbs", "run", "1", "options/biaxial.opts", "-pgran_A", "0.5", *given)
    text = (folder / file.stdout.strip()).read_text()
    line = next(line for line in text.splitlines() if "launch" in line)
    assert f"launch {result} options/biaxial.opts -pgran_A 0.5" in line
    assert "-pgran_output" not in line


def test_two_chains_have_scripts_of_their_own(folder):
    def chain(output, check=True):
        return made(folder, "pbs", "chain", "1", "options/biaxial.opts", "-pgran_output", output,
                    check=check)

    names = [chain(output).stdout.strip() for output in ("a.h5", "b.h5", "a.h5")]
    assert names == ["pgran-chain-a.pbs", "pgran-chain-b.pbs", "pgran-chain-a.pbs"]
    assert all(f"qsub {name}" in (folder / name).read_text() for name in names)
    text = (folder / "pgran-chain-a.pbs").read_text()
    other = chain("other/a.h5", check=False)
    assert other.returncode == 1 and "writes another result" in other.stderr
    assert (folder / "pgran-chain-a.pbs").read_text() == text


@pytest.mark.parametrize("given, wanted", [
    (["lsf", "run", "2", "options/biaxial.opts"], "lsf: allowed is slurm | pbs"),
    (["slurm", "walk", "2"], "walk: allowed is run | chain"),
    (["slurm", "run", "0", "options/biaxial.opts"], "0: allowed is a number of ranks"),
    (["slurm", "run", "2"], "FILE.opts is missing"),
    (["slurm", "run", "2", "options/none.opts"], "there is no such file"),
    (["pbs", "sweep", "1", "x.py"], "SCRIPT.py POINTS HOURS MEMORY_GB are needed")])
def test_what_cannot_be_made_is_refused(folder, given, wanted):
    done = made(folder, *given, check=False)
    assert done.returncode == 1 and wanted in done.stderr
    assert not list(folder.glob("pgran-*"))
