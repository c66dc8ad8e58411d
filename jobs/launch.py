"""Start Python on ranks, from anywhere; whether a run came to its end."""

import os
import subprocess
import sys
from pathlib import Path

import h5py

ROOT = Path(__file__).resolve().parent.parent
#: Ranks of a run of the jobs.
RANKS = int(os.environ.get("PGRAN_RANKS", 2))


def python(ranks, *arguments, **more):
    """Run ``python arguments`` on ranks in the repository; return the finished process.

    ``ranks`` 0 runs without mpiexec; ``more`` goes to `subprocess.run`, which checks the exit
    code unless told otherwise.
    """
    command = [sys.executable, *map(str, arguments)]
    if ranks:
        command = ["mpiexec", "-n", str(ranks), *command]
    # What an MPI that runs already has left behind would confuse another one.
    environment = {key: value for key, value in os.environ.items()
                   if not key.startswith(("OMPI_", "PMIX_", "PRTE_"))}
    environment.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                       OMPI_MCA_rmaps_base_oversubscribe="1", OMP_NUM_THREADS="1",
                       PYTHONPATH=str(ROOT))
    return subprocess.run(command, cwd=ROOT, env=environment, **{"check": True, **more})


def complete(path):
    """Whether the result file ``path`` is that of a run which came to its end."""
    if not Path(path).exists():
        return False
    with h5py.File(path) as file:
        return bool(file.attrs.get("complete", False))
