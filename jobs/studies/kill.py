"""Fault injection: kills, a quota, a read-only directory and a full disk."""

import itertools
import os
import random
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from pgran.options import SolutionError
from pgran.output.checkpoint import KEPT, checkpoints_of
from pgran.runs import run_on_ranks

from .study import QUIET

#: A specimen that yields and forms a band in some fifty steps.
OPTIONS = ("-pgran_element_size", 4, "-pgran_compression", 0.02, "-pgran_snapshots",
           "0.005,0.01,0.015,0.02", "-pgran_checkpoint_steps", 2, *QUIET)
FILE = "options/direct.opts"
RANKS = 2, 1, 3, 2, 4, 1
#: Time limit for further steps, s.
LIMIT = 120.0
#: Largest difference of fields from an undisturbed run, over their maximum.
TOLERANCE = 1e-7
#: A user other than root, bytes of the small disk, and bytes of a file under the quota.
NOBODY, SMALL, QUOTA = 65534, 2_300_000, 100_000
#: Fields that are differences of larger fields, and the fields that scale their errors.
SCALE_OF = {"spin": "strain_rate_tensor", "volume_change": "strain_tensor"}


def steps(path):
    """Return the number of steps in the history of a result; 0 without a result."""
    if not Path(path).exists():
        return 0
    with h5py.File(path, "r") as file:
        return len(file["history/time"])


def difference(path, reference):
    """Return the largest difference of fields of two results, over the maximum of each field."""
    with h5py.File(path, "r") as mine, h5py.File(reference, "r") as theirs:
        times = [file["history/time"][...] for file in (mine, theirs)]
        if times[0].shape != times[1].shape or np.any(np.diff(times[0]) <= 0.0):
            raise SolutionError(f"{path}: {times[0].size} entries in the history instead of "
                                f"{times[1].size}, or not in order")
        if list(mine["snapshots"]) != list(theirs["snapshots"]):
            raise SolutionError(f"{path}: different snapshots: {list(mine['snapshots'])}")
        found = [np.abs(times[0] - times[1]).max() / times[1][-1]]
        for name, group in theirs["snapshots"].items():
            found += [np.abs(mine["snapshots"][name][key][...] - data[...]).max()
                      / np.abs(group[SCALE_OF.get(key, key)][...]).max()
                      for key, data in group.items()]
    if max(found) > TOLERANCE:
        raise SolutionError(f"{path}: fields differ by {max(found):.1e}")
    return max(found)


def remove(path):
    """Remove a result with its snapshots and checkpoints."""
    for old in (Path(path), *checkpoints_of(path), *path.parent.glob(f"{path.stem}.snapshot_*.h5")):
        old.unlink(missing_ok=True)


def arguments(path, *more):
    """Return the command line of the run after ``python``."""
    return ("-m", "pgran", "-options_file", FILE, *OPTIONS, "-pgran_output", path, *more)


def killed(path, ranks, generator):
    """Resume the run on ``ranks`` and kill it at a random time; return whether it had ended."""
    restart = ("-pgran_restart", path) if checkpoints_of(path) else ()
    if not restart:
        remove(path)  # killed before its first checkpoint
    line, environment = run_on_ranks.command(ranks if ranks > 1 else 0, *arguments(path, *restart))
    last, end = steps(path) + generator.randint(1, 6), time.monotonic() + LIMIT
    with subprocess.Popen(line, env=environment, start_new_session=True) as process:
        while process.poll() is None and steps(path) < last:
            if time.monotonic() > end:
                run_on_ranks.kill(process)
                raise SolutionError(f"{path}: no progress after {steps(path)} steps")
            time.sleep(0.01)
        time.sleep(0.2 * generator.random())
        ended = process.poll() is not None
        run_on_ranks.kill(process)
    return ended


def kills(count, directory):
    """Kill a run at random times and print the difference of its result."""
    reference, path = directory / "whole.h5", directory / "killed.h5"
    run_on_ranks.run(reference, FILE, *OPTIONS, ranks=1)
    remove(path)
    ranks, generator, done = itertools.cycle(RANKS), random.Random(1), 0
    while done < count:
        number = next(ranks)
        if killed(path, number, generator):
            print(f"  ended on {number} ranks, difference {difference(path, reference):.1e}")
            remove(path)
            continue
        done += 1
        print(f"  kill {done:2d} on {number} ranks: {steps(path)} steps and "
              f"{len(checkpoints_of(path))} checkpoints are stored", flush=True)
    run_on_ranks.run(path, FILE, *OPTIONS)
    print(f"  {count} kills: difference {difference(path, reference):.1e}")


def fault(name, path, reference, inject, repair, prefix=()):
    """Inject a fault into a run to ``path``, repair it, and resume; print the difference."""
    line, environment = run_on_ranks.command(2, *arguments(path))
    with subprocess.Popen([*prefix, *line], env=environment, stderr=subprocess.PIPE, text=True,
                          start_new_session=True) as process:
        try:
            while len(checkpoints_of(path)) < KEPT and process.poll() is None:
                time.sleep(0.01)
            inject(process)
            output = process.communicate(timeout=LIMIT)[1]
        finally:
            run_on_ranks.kill(process)
    errors = [text for text in output.splitlines() if "error: " in text]
    if process.returncode != 1 or len(errors) != 1:
        raise SolutionError(f"{name}: exit code {process.returncode}, {output}")
    stored = steps(path), len(checkpoints_of(path))
    repair()
    run_on_ranks.python(2, *arguments(path, "-pgran_restart", path))
    print(f"  {name}: {errors[0]}\n    {stored[0]} steps and {stored[1]} checkpoints are stored; "
          f"difference after the restart {difference(path, reference):.1e}", flush=True)


def faults(directory):
    """Let a run exceed a quota, lose write access to its directory, and fill its disk."""
    reference, root = directory / "whole.h5", not os.geteuid()
    with tempfile.TemporaryDirectory() as folder:
        fault("quota", Path(folder) / "run.h5", reference,
              lambda process: run_on_ranks.for_processes(process, lambda number: resource.prlimit(
                  number, resource.RLIMIT_FSIZE, (QUOTA, QUOTA))), lambda: None)
    with tempfile.TemporaryDirectory() as folder:  # of another user, because root can always write
        os.chmod(folder, 0o777)
        user = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
        if root:
            os.chown(folder, NOBODY, NOBODY)
        fault("read-only directory", Path(folder) / "run.h5", reference,
              lambda process: os.chmod(folder, 0o555), lambda: os.chmod(folder, 0o777),
              user if root else ())
    if not root:
        print("  full disk skipped: only root can mount a small disk")
        return
    disk = (directory / "disk").resolve()
    disk.mkdir(exist_ok=True)

    def mount(*words):
        subprocess.run(words, check=True, capture_output=True)

    mount("mount", "-t", "tmpfs", "-o", f"size={SMALL}", "tmpfs", str(disk))
    try:
        fault("full disk", disk / "run.h5", reference, lambda process: None,
              lambda: mount("mount", "-o", f"remount,size={100 * SMALL}", str(disk)))
    finally:
        mount("umount", str(disk))


def kill(count="20", directory="results/kill"):
    """Fault injection: kill [number of kills] [directory]

    A run is killed (SIGKILL to all processes) at random times and resumed on other numbers of
    ranks. Then its files meet a quota, its directory becomes read-only, and its disk (a small
    tmpfs, which needs root) is full: each fault must give one error, with the last checkpoint
    intact. All results must equal the results of an undisturbed run. Four minutes on two cores.
    """
    if not count.isdecimal():
        raise ValueError(f"number of kills {count}: must be an integer >= 0")
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    kills(int(count), directory)
    faults(directory)
