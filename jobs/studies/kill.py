"""Fault injection: kills, a disk quota, a read-only folder, a full disk: kill [moments] [dir]

A run is killed (SIGKILL to all its processes) at 20 random moments and resumed each time on another
number of ranks. Fields and history must equal those of an undisturbed run. Then a quota, a
read-only folder and a full disk end the run: each must give one error and leave the last checkpoint
intact, from which the run is resumed. The full disk is a small tmpfs, which only root can mount;
without root it is skipped.
"""

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

#: A specimen that yields and forms a band, in some fifty steps.
OPTIONS = ("-pgran_element_size", 4, "-pgran_compression", 0.02, "-pgran_snapshots",
           "0.005,0.01,0.015,0.02", "-pgran_checkpoint_steps", 2, *run_on_ranks.QUIET)
FILE = "options/direct.opts"
RANKS = 2, 1, 3, 2, 4, 1
#: Time, s, within which a run must make progress.
LIMIT = 120.0
#: Largest difference from the undisturbed run, over the maximum of a field.
TOLERANCE = 1e-7
#: A user who is not root.
NOBODY = 65534
#: Bytes of the small disk, and of a file under the quota.
SMALL, QUOTA = 2_300_000, 100_000
#: Fields that are differences of larger ones, and the field that scales their errors.
SCALE_OF = {"spin": "strain_rate_tensor", "volume_change": "strain_tensor"}


def steps(path):
    """Return how many steps the history of a result holds; 0 without a result."""
    if not Path(path).exists():
        return 0
    with h5py.File(path, "r") as file:
        return len(file["history/time"])


def difference(path, undisturbed):
    """Return the largest difference of two results, over the maximum of each field.

    Raises SolutionError where snapshots or histories do not correspond.
    """
    with h5py.File(path, "r") as mine, h5py.File(undisturbed, "r") as theirs:
        times = [file["history/time"][...] for file in (mine, theirs)]
        if times[0].shape != times[1].shape or np.any(np.diff(times[0]) <= 0.0):
            raise SolutionError(f"{path}: the history has {times[0].size} entries instead of "
                                f"{times[1].size}, or is not increasing")
        if list(mine["snapshots"]) != list(theirs["snapshots"]):
            raise SolutionError(f"{path}: unexpected snapshots {list(mine['snapshots'])}")
        far = [np.abs(times[0] - times[1]).max() / times[1][-1]]
        for name, group in theirs["snapshots"].items():
            far += [np.abs(mine["snapshots"][name][key][...] - data[...]).max()
                    / np.abs(group[SCALE_OF.get(key, key)][...]).max()
                    for key, data in group.items()]
    return max(far)


def checked(path, undisturbed):
    """Return the `difference` of two results. Raises SolutionError beyond the tolerance."""
    far = difference(path, undisturbed)
    if far > TOLERANCE:
        raise SolutionError(f"{path}: difference {far:.1e} exceeds {TOLERANCE:g}")
    return far


def remove(path):
    """Remove a result with its snapshots and checkpoints."""
    for old in (Path(path), *checkpoints_of(path), *path.parent.glob(f"{path.stem}.snapshot_*.h5")):
        old.unlink(missing_ok=True)


def killed(path, ranks, chance):
    """Resume the run on ``ranks`` and kill it at a random moment; return whether it had ended."""
    before = steps(path)
    again = ("-pgran_restart", path) if checkpoints_of(path) else ()
    if not again and Path(path).exists():
        remove(path)  # killed before its first checkpoint
    line, environment = run_on_ranks.command(
        ranks if ranks > 1 else 0, "-m", "pgran", "-options_file", FILE, *OPTIONS, "-pgran_output",
        path, *again)
    wanted, end = before + chance.randint(1, 6), time.monotonic() + LIMIT
    with subprocess.Popen(line, env=environment, start_new_session=True) as process:
        while process.poll() is None and steps(path) < wanted:
            if time.monotonic() > end:
                run_on_ranks.kill(process)
                raise SolutionError(f"{path}: no progress beyond {steps(path)} steps")
            time.sleep(0.01)
        time.sleep(0.2 * chance.random())
        ended = process.poll() is not None
        run_on_ranks.kill(process)
    return ended


def kills(moments, directory):
    """Kill a run at random moments; print the results."""
    undisturbed, path = directory / "undisturbed.h5", directory / "killed.h5"
    chance = random.Random(1)
    run_on_ranks.run(undisturbed, FILE, *OPTIONS, ranks=1)
    remove(path)
    ranks, count = itertools.cycle(RANKS), 0
    while count < moments:
        number = next(ranks)
        if killed(path, number, chance):  # the run was complete: start again
            print(f"  complete on {number} ranks, difference {checked(path, undisturbed):.1e}")
            remove(path)
            continue
        count += 1
        print(f"  kill {count:2d} on {number} ranks: {steps(path)} steps on the disk, "
              f"{len(checkpoints_of(path))} checkpoints", flush=True)
    if checkpoints_of(path):
        run_on_ranks.python(2, "-m", "pgran", "-options_file", FILE, *OPTIONS, "-pgran_output",
                            path, "-pgran_restart", path)
    else:
        run_on_ranks.run(path, FILE, *OPTIONS)
    print(f"  {moments} kills: {steps(path)} history entries, difference of the fields from an "
          f"undisturbed run {checked(path, undisturbed):.1e}")


def mount(*arguments):
    """Mount or unmount; raises subprocess.CalledProcessError where that fails."""
    subprocess.run(arguments, check=True, capture_output=True)


def fault(name, path, undisturbed, spoil, mend, before=()):
    """Break the disk of a run to ``path``, repair it, and resume; print the results.

    ``spoil(process)`` is called once there are two checkpoints, ``mend()`` before the restart, and
    ``before`` precedes the command.
    """
    more = ("-options_file", FILE, *OPTIONS, "-pgran_output", path)
    line, environment = run_on_ranks.command(2, "-m", "pgran", *more)
    with subprocess.Popen([*before, *line], env=environment, stderr=subprocess.PIPE,
                          text=True, start_new_session=True) as process:
        try:
            while len(checkpoints_of(path)) < KEPT and process.poll() is None:
                time.sleep(0.01)
            spoil(process)
            errors = process.communicate(timeout=LIMIT)[1]
        finally:
            run_on_ranks.kill(process)
    messages = [text for text in errors.splitlines() if "error: " in text]
    if process.returncode != 1 or len(messages) != 1:
        raise SolutionError(f"{name}: exit code {process.returncode}, {errors}")
    held = steps(path), len(checkpoints_of(path))
    mend()
    run_on_ranks.python(2, "-m", "pgran", *more, "-pgran_restart", path)
    print(f"  {name}: {messages[0]}\n    {held[0]} steps and {held[1]} checkpoints on disk; "
          f"difference after the restart {checked(path, undisturbed):.1e}", flush=True)


def restrict(number):
    """Limit the files of a process to `QUOTA` bytes."""
    resource.prlimit(number, resource.RLIMIT_FSIZE, (QUOTA, QUOTA))


def faults(directory):
    """Inject a quota, a read-only folder and a full disk."""
    undisturbed, root = directory / "undisturbed.h5", not os.geteuid()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        fault("quota", path, undisturbed,
              lambda process: run_on_ranks.for_processes(process, restrict), lambda: None)
    with tempfile.TemporaryDirectory() as folder:  # root ignores permissions
        os.chmod(folder, 0o777)
        user = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
        if root:
            os.chown(folder, NOBODY, NOBODY)
        fault("read-only folder", Path(folder) / "run.h5", undisturbed,
              lambda process: os.chmod(folder, 0o555),
              lambda: os.chmod(folder, 0o777), user if root else ())
    if not root:
        print("  full disk skipped: only root can mount a small one")
        return
    disk = (directory / "disk").resolve()
    disk.mkdir(exist_ok=True)
    mount("mount", "-t", "tmpfs", "-o", f"size={SMALL}", "tmpfs", str(disk))
    try:
        fault("full disk", disk / "run.h5", undisturbed, lambda process: None,
              lambda: mount("mount", "-o", f"remount,size={100 * SMALL}", str(disk)))
    finally:
        mount("umount", str(disk))


def main(moments="20", directory="results/kill"):
    """Kill a run ``moments`` times, and inject faults of its disk."""
    if not moments.isdecimal():
        raise ValueError(f"number of kills {moments}: must be an integer >= 0")
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    kills(int(moments), directory)
    faults(directory)
