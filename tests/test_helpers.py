"""The helpers of the tests: commands in forks, time limits, and shared runs."""

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


def test_a_command_in_a_fork_is_equivalent_to_a_new_process(tmp_path, monkeypatch):
    (tmp_path / "command.py").write_text(COMMAND)
    monkeypatch.setenv("WORD", "one two")
    line, environment = run_on_ranks.command(0, "-m", "command", "a b", 4)
    new = subprocess.run(line, env=environment, cwd=tmp_path, stdin=subprocess.DEVNULL,
                         capture_output=True, text=True, check=False)
    fork = fork_server().run("command", "a b", 4, folder=tmp_path)
    assert "__main__" in fork.stdout and "['a b', '4'] one two" in fork.stdout
    for name in ("returncode", "stdout", "stderr"):
        assert getattr(fork, name) == getattr(new, name)


def test_a_command_that_exceeds_its_time_limit_is_ended_and_the_next_one_runs(tmp_path):
    (tmp_path / "sleeper.py").write_text(
        "import time\nprint('here', flush=True)\ntime.sleep(600)\n")
    with pytest.raises(subprocess.TimeoutExpired) as error:
        fork_server().run("sleeper", folder=tmp_path, limit=0.5)
    assert error.value.output == "here\n"
    assert "wave_vector" in run_ranks(0, "-m", "pgran.stability", "-help").stdout


def test_time_limits_increase_on_a_slow_machine(monkeypatch):
    monkeypatch.setattr(conftest, "START", 1e-3)
    server = ForkServer()
    server.process.communicate()
    assert server.slowness > 20.0
    monkeypatch.setattr(conftest, "fork_server", lambda: server)
    assert allowed(60.0) == 60.0 * server.slowness


def test_a_shared_run_is_executed_once(shared_run, monkeypatch):
    made = []

    def pretend(ranks, options_file, path, *arguments):
        made.append((ranks, options_file, arguments))
        path.write_text("result")
        return SimpleNamespace(stdout="words")

    monkeypatch.setattr(conftest, "pgran", pretend)
    with ThreadPoolExecutor(4) as pool:
        found = {*pool.map(lambda _: shared_run("test of once", 2, "a.opts", "-x"), range(8))}
    assert made == [(2, "a.opts", ("-x",))]
    (path, text), = found
    assert path.read_text() == "result" and text == "words"
