"""Does a run survive what clusters do to it? kill [moments] [directory]

A run is killed (SIGKILL to all its processes) at 20 random moments, and goes on each time on
another number of ranks. Its fields and its history must be those of a run that was left alone.
Then its files meet a quota, its folder becomes read-only, and its disk full. Each ends in one
error, with the last checkpoint intact, from which the run goes on to the same end. The full disk is
a small tmpfs, which only root can mount; without root that part is left out, and the study says so.
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
#: Seconds within which a run must get further than the last one.
LIMIT = 120.0
#: How far fields may be from those of a run that was left alone, over their largest value.
TOLERANCE = 1e-7
#: A user who is not root.
NOBODY = 65534
#: Bytes of the small disk, and those that a file may have under the quota.
SMALL, QUOTA = 2_300_000, 100_000
#: Fields that are differences of larger ones, and the field whose size their errors have.
SCALE_OF = {"spin": "strain_rate_tensor", "volume_change": "strain_tensor"}


def steps(path):
    """Return how many steps the history of a result holds; 0 without a result."""
    if not Path(path).exists():
        return 0
    with h5py.File(path, "r") as file:
        return len(file["history/time"])


def apart(path, whole):
    """Return how far the fields of two results are apart, over their largest value.

    Raises SolutionError where snapshots or histories are not the same ones.
    """
    with h5py.File(path, "r") as mine, h5py.File(whole, "r") as theirs:
        times = [file["history/time"][...] for file in (mine, theirs)]
        if times[0].shape != times[1].shape or np.any(np.diff(times[0]) <= 0.0):
            raise SolutionError(f"{path}: its history has {times[0].size} entries, and "
                                f"{times[1].size} are expected, each later than the one before")
        if list(mine["snapshots"]) != list(theirs["snapshots"]):
            raise SolutionError(f"{path}: its snapshots are {list(mine['snapshots'])}")
        far = [np.abs(times[0] - times[1]).max() / times[1][-1]]
        for name, group in theirs["snapshots"].items():
            far += [np.abs(mine["snapshots"][name][key][...] - data[...]).max()
                    / np.abs(group[SCALE_OF.get(key, key)][...]).max()
                    for key, data in group.items()]
    return max(far)


def remove(path):
    """Remove a result with its snapshots and checkpoints, if there is one."""
    for old in (Path(path), *checkpoints_of(path), *path.parent.glob(f"{path.stem}.snapshot_*.h5")):
        old.unlink(missing_ok=True)


def killed(path, ranks, chance):
    """Go on with the run on ``ranks`` and kill it at a random moment; return whether it ended."""
    before = steps(path)
    again = ("-pgran_restart", path) if checkpoints_of(path) else ()
    if not again and Path(path).exists():
        remove(path)  # killed before its first checkpoint
    line, environment = run_on_ranks.command(ranks if ranks > 1 else 0, "-m", "pgran", "-options_file",
                                       FILE, *OPTIONS, "-pgran_output", path, *again)
    wanted, end = before + chance.randint(1, 6), time.monotonic() + LIMIT
    with subprocess.Popen(line, env=environment, start_new_session=True) as process:
        while process.poll() is None and steps(path) < wanted:
            if time.monotonic() > end:
                run_on_ranks.kill(process)
                raise SolutionError(f"{path}: it gets no further than {steps(path)} steps")
            time.sleep(0.01)
        time.sleep(0.2 * chance.random())
        ended = process.poll() is not None
        run_on_ranks.kill(process)
    return ended


def kills(moments, directory):
    """Kill a run at random moments; print what came of it."""
    whole, path, chance = directory / "whole.h5", directory / "killed.h5", random.Random(1)
    run_on_ranks.run(whole, FILE, *OPTIONS, ranks=1)
    remove(path)
    ranks, count = itertools.cycle(RANKS), 0
    while count < moments:
        number = next(ranks)
        if killed(path, number, chance):
            # It was at its end: begin anew.
            print(f"  ended on {number} ranks, {apart(path, whole):.1e} apart")
            if apart(path, whole) > TOLERANCE:
                raise SolutionError(f"{path}: more than {TOLERANCE:g} apart")
            remove(path)
            continue
        count += 1
        print(f"  kill {count:2d} on {number} ranks: {steps(path)} steps on the disk, "
              f"{len(checkpoints_of(path))} checkpoints", flush=True)
    if checkpoints_of(path):
        run_on_ranks.python(2, "-m", "pgran", "-options_file", FILE, *OPTIONS, "-pgran_output", path,
                      "-pgran_restart", path)
    else:
        run_on_ranks.run(path, FILE, *OPTIONS)
    far = apart(path, whole)
    print(f"  {moments} kills: the history has {steps(path)} entries, as that of a run left alone; "
          f"fields are {far:.1e} apart")
    if far > TOLERANCE:
        raise SolutionError(f"{path}: more than {TOLERANCE:g} apart")


def mount(*arguments):
    """Mount or unmount; raises subprocess.CalledProcessError where that fails."""
    subprocess.run(arguments, check=True, capture_output=True)


def fault(name, path, whole, spoil, mend, before=()):
    """Spoil the disk under a run to ``path``, mend it, and go on; print what came of it.

    ``spoil(process)`` is called once there are two checkpoints, and ``before`` are words in front
    of the command.
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
    told = [text for text in errors.splitlines() if "error: " in text]
    if process.returncode != 1 or len(told) != 1:
        raise SolutionError(f"{name}: exit code {process.returncode}, {errors}")
    held = steps(path), len(checkpoints_of(path))
    mend()
    run_on_ranks.python(2, "-m", "pgran", *more, "-pgran_restart", path)
    far = apart(path, whole)
    print(f"  {name}: {told[0]}\n    {held[0]} steps and {held[1]} checkpoints are there; gone on "
          f"from them, fields are {far:.1e} apart", flush=True)
    if far > TOLERANCE:
        raise SolutionError(f"{name}: more than {TOLERANCE:g} apart")


def restrict(number):
    """Let no file of a process grow beyond `QUOTA`, as a quota does."""
    resource.prlimit(number, resource.RLIMIT_FSIZE, (QUOTA, QUOTA))


def faults(directory):
    """Let the folder become read-only under a run, its files meet a limit, its disk get full."""
    whole, root = directory / "whole.h5", not os.geteuid()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        fault("quota", path, whole, lambda process: run_on_ranks.for_processes(process, restrict),
              lambda: None)
    with tempfile.TemporaryDirectory() as folder:  # of a user who is not root, who may write always
        os.chmod(folder, 0o777)
        user = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
        if root:
            os.chown(folder, NOBODY, NOBODY)
        fault("read-only folder", Path(folder) / "run.h5", whole,
              lambda process: os.chmod(folder, 0o555),
              lambda: os.chmod(folder, 0o777), user if root else ())
    if not root:
        print("  a full disk is left out: only root can mount a small one")
        return
    disk = (directory / "disk").resolve()
    disk.mkdir(exist_ok=True)
    mount("mount", "-t", "tmpfs", "-o", f"size={SMALL}", "tmpfs", str(disk))
    try:
        fault("full disk", disk / "run.h5", whole, lambda process: None,
              lambda: mount("mount", "-o", f"remount,size={100 * SMALL}", str(disk)))
    finally:
        mount("umount", str(disk))


def main(moments="20", directory="results/kill"):
    """Kill a run ``moments`` times, and let its disk fail."""
    if not moments.isdecimal():
        raise ValueError(f"{moments}: allowed is a number of kills, an integer >= 0")
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    kills(int(moments), directory)
    faults(directory)
