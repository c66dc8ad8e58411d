"""Tell what pgran runs on, whether it fits together, and what to do: python -m pgran -doctor

Each library is tried in a process of its own, so that one which crashes is told too.
"""

import json
import os
import shutil
import subprocess
import sys
from typing import NamedTuple

#: Seconds that one look may take.
LIMIT = 60
#: Seconds that MPI may take to start before it is told what may hold it up.
SLOW = 2.0
#: Generations of PETSc that pgran runs on.
OLDEST, NEWEST = (3, 18), (3, 26)

PETSC = """
from petsc4py import PETSc
import numpy
facts = dict(version=PETSc.Sys.getVersion(), real=PETSc.ScalarType is numpy.float64,
             bits=8*numpy.dtype(PETSc.IntType).itemsize)
try:
    facts["mumps"] = bool(PETSc.Sys.hasExternalPackage("mumps"))
except Exception:
    facts["mumps"] = None
"""
SLEPC = """
from slepc4py import SLEPc
facts = dict(version=SLEPc.Sys.getVersion())
"""
MPI = """
import time
start = time.perf_counter()
from mpi4py import MPI
facts = dict(library=MPI.Get_library_version().split(",")[0].strip().strip(chr(0)),
             seconds=time.perf_counter() - start)
"""
HDF5 = """
import h5py
facts = dict(version=h5py.__version__, hdf5=h5py.version.hdf5_version, mpi=h5py.get_config().mpi)
"""
TOGETHER = """
import os
from petsc4py import PETSc
from mpi4py import MPI
import h5py
facts = dict(mpi=sorted({os.path.realpath(line.split()[-1]) for line in open("/proc/self/maps")
                         if "/libmpi.so" in line or "/libmpich" in line}))
"""
#: What is known to hold Open MPI up.
HELD_UP = (" (slow; on one machine export PMIX_MCA_psec=native, so that it does not wait for a "
           "munge that does not run, and OMPI_MCA_btl=self,vader)")
#: Variables without which Open MPI's mpiexec refuses root.
ALLOW_ROOT = "OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"
#: Each rank writes at once, so that answers do not mix.
RANKS = "import os; from mpi4py import MPI; os.write(1, b' %d ' % MPI.COMM_WORLD.size)"


class Finding(NamedTuple):
    """What was found: whether it is good, what it is, and what to do where it is not."""

    good: bool
    text: str
    cure: str = ""


def facts(code):
    """Return the ``facts`` that a piece of Python finds in a process of its own, or what failed."""
    code += "\nimport json; print(json.dumps(facts))"
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                              timeout=LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return f"no answer in {LIMIT} s"
    if done.returncode == 0:
        return json.loads(done.stdout.splitlines()[-1])
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"it ended with code {done.returncode}"


def examined():
    """Yield the findings, one `Finding` for each library and for how they fit together."""
    version = ".".join(map(str, sys.version_info[:3]))
    yield Finding(sys.version_info >= (3, 9), f"Python {version}", "take Python 3.9 or later")
    petsc = facts(PETSC)
    yield _petsc(petsc)
    slepc = facts(SLEPC)
    if isinstance(slepc, str):
        yield Finding(False, f"slepc4py: {slepc}", "install slepc4py of the same version as "
                      "petsc4py; only pgran-eigen and pgran-growth need it")
    else:
        same = isinstance(petsc, str) or slepc["version"][:2] == petsc["version"][:2]
        yield Finding(same, "slepc4py " + _dotted(slepc["version"]),
                      "its version must be that of petsc4py: install both from one source")
    mpi = facts(MPI)
    yield Finding(not isinstance(mpi, str), f"mpi4py: {mpi}" if isinstance(mpi, str) else
                  f"mpi4py with {mpi['library']}, starts in {mpi['seconds']:.1f} s"
                  + (HELD_UP if mpi["seconds"] > SLOW else ""),
                  "install mpi4py built with the MPI of PETSc")
    hdf5 = facts(HDF5)
    yield Finding(not isinstance(hdf5, str), f"h5py: {hdf5}" if isinstance(hdf5, str) else
                  f"h5py {hdf5['version']}, HDF5 {hdf5['hdf5']}, "
                  f"{'with' if hdf5['mpi'] else 'without'} MPI (either will do)", "install h5py")
    both = facts(TOGETHER)
    if isinstance(both, str):
        yield Finding(False, f"petsc4py, mpi4py and h5py in one process: {both}",
                      "install all of them from one source: Debian's packages, one conda "
                      "environment, or pip with one MPI")
    else:
        yield Finding(len(both["mpi"]) == 1, "one MPI library in the process: "
                      + (", ".join(both["mpi"]) or "none"), "rebuild mpi4py and h5py with the MPI "
                      "of PETSc: MPICC=mpicc pip install --no-binary :all: mpi4py")
    yield _launcher(mpi)
    scipy = facts("import scipy; facts = dict(version=scipy.__version__)")
    yield Finding(not isinstance(scipy, str), f"scipy: {scipy}" if isinstance(scipy, str) else
                  f"scipy {scipy['version']}", "install scipy, with Debian's petsc4py by pip "
                  "install scipy 'numpy<2'")
    for name, use in (("matplotlib", "pictures"), ("pyvista", "3D grids and windows")):
        found = facts(f"import {name}; facts = dict(version={name}.__version__)")
        yield Finding(True, f"{name}: not there; {use} need it (pip install 'pgran[plot]')"
                      if isinstance(found, str) else f"{name} {found['version']}")


def _dotted(version):
    return ".".join(map(str, version))


def _petsc(found):
    if isinstance(found, str):
        return Finding(False, f"petsc4py: {found}", "on Debian: bash jobs/local.sh setup; "
                       "elsewhere install petsc4py beside a PETSc with MUMPS (pip install petsc "
                       "petsc4py, or conda install -c conda-forge petsc4py)")
    text = (f"petsc4py {_dotted(found['version'])}, {'real' if found['real'] else 'complex'} "
            f"numbers, {found['bits']}-bit indices, MUMPS "
            + {True: "present", False: "missing", None: "unknown"}[found["mumps"]])
    if not found["real"]:
        return Finding(False, text, "take a PETSc with real numbers (Debian: PETSC_ARCH "
                       "...-real; configure --with-scalar-type=real)")
    if not OLDEST <= tuple(found["version"][:2]) <= NEWEST:
        return Finding(False, text, f"pgran is tested on {_dotted(OLDEST)} to {_dotted(NEWEST)}")
    return Finding(found["mumps"] is not False, text, "configure PETSc with --download-mumps "
                   "--download-scalapack; without MUMPS only multigrid solves")


def refuses_root(mpi):
    """Return whether mpiexec would refuse this user; ``mpi`` holds the facts of `MPI`."""
    return (not isinstance(mpi, str) and "Open MPI" in mpi["library"] and os.geteuid() == 0
            and not all(os.environ.get(name) for name in ALLOW_ROOT))


def _launcher(mpi):
    """Whether mpiexec starts ranks that know of each other."""
    path = shutil.which("mpiexec")
    if not path:
        return Finding(False, "mpiexec: not on the path", "install the MPI that mpi4py was built "
                       "with, or start ranks as your cluster says (srun)")
    from .runs.run_on_ranks import command

    line, environment = command(2, "-c", RANKS)
    try:
        done = subprocess.run(line, env=environment, capture_output=True, text=True,
                              timeout=LIMIT, check=False)
        sizes = done.stdout.split()
    except subprocess.TimeoutExpired:
        sizes = ["no answer"]
    if refuses_root(mpi):
        return Finding(False, f"{path}: Open MPI refuses to start as root", "export "
                       + " ".join(f"{name}=1" for name in ALLOW_ROOT) + ", or use another account")
    return Finding(sizes == ["2", "2"], f"{path} starts 2 ranks that see "
                   f"{' and '.join(sizes) or 'nothing'}", "mpiexec must belong to the MPI of "
                   "mpi4py: two ranks that each see 1 are two runs")


def main():
    """Print the findings; return 0 where pgran can run, else 1."""
    from . import __version__

    print(f"pgran {__version__}, {sys.executable}")
    good = True
    for finding in examined():
        good = good and finding.good
        print(f"  {'ok ' if finding.good else 'BAD'} {finding.text}"
              + ("" if finding.good else f"\n      -> {finding.cure}"), flush=True)
    print("all fits together" if good else "not all fits together: see the arrows")
    return int(not good)
