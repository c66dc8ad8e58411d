"""The helpers of the tests: commands in forks, time limits, and runs that files share."""

import subprocess
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import conftest
import pytest
from conftest import ForkServer, allowed, fork_server, run_ranks

from pgran.runs import run_on_ranks

COMMAND = """
import os, sys
print(__name__, os.getcwd(), sys.argv[1:], os.environ.get("WORD"), sys.stdin.read())
print("complaint", file=sys.stderr)
sys.exit(3)
"""


def test_a_command_in_a_fork_does_what_it_does_in_a_new_process(tmp_path, monkeypatch):
    (tmp_path / "command.py").write_text(COMMAND)
    monkeypatch.setenv("WORD", "one two")
    line, environment = run_on_ranks.command(0, "-m", "command", "a b", 4)
    new = subprocess.run(line, env=environment, cwd=tmp_path, stdin=subprocess.DEVNULL,
                         capture_output=True, text=True, check=False)
    fork = fork_server().run("command", "a b", 4, folder=tmp_path)
    assert "__main__" in fork.stdout and "['a b', '4'] one two" in fork.stdout
    for name in ("returncode", "stdout", "stderr"):
        assert getattr(fork, name) == getattr(new, name)
    monkeypatch.delenv("WORD")
    assert " None " in fork_server().run("command", folder=tmp_path).stdout


def test_a_command_that_takes_too_long_is_ended_and_the_next_one_runs(tmp_path):
    (tmp_path / "sleeper.py").write_text(
        "import time\nprint('here', flush=True)\ntime.sleep(600)\n")
    with pytest.raises(subprocess.TimeoutExpired) as error:
        fork_server().run("sleeper", folder=tmp_path, limit=0.5)
    assert error.value.output == "here\n"
    assert "wave_vector" in run_ranks(0, "-m", "pgran.stability", "-help").stdout


def test_only_modules_with_the_same_python_run_in_forks(monkeypatch):
    assert fork_server().serves(["-m", "pgran"])
    assert not fork_server().serves(["-c", "print()"])
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    assert not fork_server().serves(["-m", "pgran"])
    monkeypatch.delenv("PYTHONWARNINGS")
    monkeypatch.setenv("PGRAN_PYTHON", "/usr/bin/python9")
    assert not fork_server().serves(["-m", "pgran"])


def test_time_limits_grow_with_the_time_that_this_machine_takes(monkeypatch):
    assert allowed(60.0) == 60.0 * fork_server().slowness >= 60.0
    monkeypatch.setattr(conftest, "START", 1e-3)  # as if the machine were very slow
    server = ForkServer()
    server.process.communicate()
    assert server.slowness > 20.0
    monkeypatch.setattr(conftest, "fork_server", lambda: server)
    assert allowed(60.0) == 60.0 * server.slowness


def test_a_shared_run_is_made_once(shared_run, monkeypatch):
    made = []

    def pretend(ranks, options_file, path, *arguments):
        made.append((ranks, options_file, arguments))
        path.write_text("result")
        return SimpleNamespace(stdout="words")

    monkeypatch.setattr(conftest, "pgran", pretend)
    with ThreadPoolExecutor(4) as pool:
        answers = {*pool.map(lambda _: shared_run("test of once", 2, "a.opts", "-x"), range(8))}
    assert made == [(2, "a.opts", ("-x",))]
    (path, text), = answers
    assert path.read_text() == "result" and text == "words"
