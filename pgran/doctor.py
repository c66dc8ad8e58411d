"""Check the installation of pgran: python -m pgran -doctor

Each library is tried in a separate process, so that a crash is reported too.
"""

import json
import os
import shutil
import subprocess
import sys
from typing import NamedTuple

from . import __version__

#: Time limit of a check, s.
LIMIT = 60
#: Start of MPI that counts as slow, s.
SLOW = 2.0
#: Tested versions of PETSc.
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
VERSION = "import {0}; facts = dict(version={0}.__version__)"
#: Known reasons for a slow start of Open MPI.
SLOW_START = (" (slow; on one machine export PMIX_MCA_psec=native, which avoids a timeout of "
              "munge, and OMPI_MCA_btl=self,vader)")
#: Variables that allow root to use mpiexec of Open MPI.
ALLOW_ROOT = "OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"
#: Each rank writes its text in one call, so that texts do not mix.
RANKS = "import os; from mpi4py import MPI; os.write(1, b' %d ' % MPI.COMM_WORLD.size)"


class Finding(NamedTuple):
    """The result of a check, and a remedy if it is bad."""

    good: bool
    text: str
    cure: str = ""


def facts(code):
    """Return the ``facts`` of a piece of Python, run in a separate process, or an error message."""
    code += "\nimport json; print(json.dumps(facts))"
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                              timeout=LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return f"not finished after {LIMIT} s"
    if done.returncode == 0:
        return json.loads(done.stdout.splitlines()[-1])
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"exit code {done.returncode}"


def _library(name, found, text, cure):
    """The `Finding` of a library; ``found`` are its `facts`, and ``text`` describes them."""
    if isinstance(found, str):
        return Finding(False, f"{name}: {found}", cure)
    return Finding(True, text.format(**found), cure)


def check():
    """Yield a `Finding` for each library and for their compatibility."""
    version = ".".join(map(str, sys.version_info[:3]))
    yield Finding(sys.version_info >= (3, 9), f"Python {version}", "install Python 3.9 or later")
    petsc, slepc, mpi, hdf5 = map(facts, (PETSC, SLEPC, MPI, HDF5))
    yield _petsc(petsc)
    if isinstance(slepc, str) or isinstance(petsc, str) \
            or slepc["version"][:2] == petsc["version"][:2]:
        yield _library("slepc4py", slepc, "slepc4py {version[0]}.{version[1]}.{version[2]}",
                       "install slepc4py of the same version as petsc4py; only pgran-eigen and "
                       "pgran-growth require it")
    else:
        yield Finding(False, "slepc4py " + _dotted(slepc["version"]), "petsc4py has another "
                      "version: install both from the same source")
    slow = SLOW_START if not isinstance(mpi, str) and mpi["seconds"] > SLOW else ""
    yield _library("mpi4py", mpi, "mpi4py with {library}, starts in {seconds:.1f} s" + slow,
                   "install mpi4py built with the MPI of PETSc")
    yield _library("h5py", hdf5, "h5py {version}, HDF5 {hdf5}, MPI support: {mpi} (not required)",
                   "install h5py")
    both = facts(TOGETHER)
    if isinstance(both, str):
        yield Finding(False, f"petsc4py, mpi4py and h5py in one process: {both}",
                      "install all of them from the same source: Debian's packages, one conda "
                      "environment, or pip with one MPI")
    else:
        yield Finding(len(both["mpi"]) == 1, "one MPI library in the process: "
                      + (", ".join(both["mpi"]) or "not found"), "rebuild mpi4py and h5py with the "
                      "MPI of PETSc: MPICC=mpicc pip install --no-binary :all: mpi4py")
    yield _launcher(mpi)
    yield _library("scipy", facts(VERSION.format("scipy")), "scipy {version}", "install scipy; "
                   "for Debian's petsc4py: pip install scipy 'numpy<2'")
    for name, use in (("matplotlib", "pictures"), ("pyvista", "3D grids and windows")):
        found = _library(name, facts(VERSION.format(name)), name + " {version}", "")
        yield found if found.good else Finding(
            True, f"{name}: not installed; required for {use} (pip install 'pgran[plot]')")


def _dotted(version):
    return ".".join(map(str, version))


def _petsc(found):
    if isinstance(found, str):
        return Finding(False, f"petsc4py: {found}", "on Debian: bash jobs/local.sh setup; "
                       "elsewhere install PETSc with MUMPS, and petsc4py (pip install petsc "
                       "petsc4py, or conda install -c conda-forge petsc4py)")
    text = (f"petsc4py {_dotted(found['version'])}, {'real' if found['real'] else 'complex'} "
            f"numbers, {found['bits']}-bit indices, MUMPS "
            + {True: "present", False: "missing", None: "unknown"}[found["mumps"]])
    if not found["real"]:
        return Finding(False, text, "install PETSc with real numbers (Debian: PETSC_ARCH "
                       "...-real; configure --with-scalar-type=real)")
    if not OLDEST <= tuple(found["version"][:2]) <= NEWEST:
        return Finding(False, text, f"pgran is tested on {_dotted(OLDEST)} to {_dotted(NEWEST)}")
    return Finding(found["mumps"] is not False, text, "configure PETSc with --download-mumps "
                   "--download-scalapack; without MUMPS only multigrid can be used")


def refuses_root(mpi):
    """Return whether mpiexec would refuse this user; ``mpi`` holds the facts of `MPI`."""
    return (not isinstance(mpi, str) and "Open MPI" in mpi["library"] and os.geteuid() == 0
            and not all(os.environ.get(name) for name in ALLOW_ROOT))


def _launcher(mpi):
    """Check that mpiexec starts ranks of one MPI job."""
    path = shutil.which("mpiexec")
    if not path:
        return Finding(False, "mpiexec: not on the path", "install the MPI with which mpi4py was "
                       "built, or start ranks as described for your cluster (srun)")
    from .runs.run_on_ranks import command

    line, environment = command(2, "-c", RANKS)
    try:
        done = subprocess.run(line, env=environment, capture_output=True, text=True,
                              timeout=LIMIT, check=False)
        sizes = done.stdout.split()
    except subprocess.TimeoutExpired:
        sizes = [f"(not finished after {LIMIT} s)"]
    if refuses_root(mpi):
        return Finding(False, f"{path}: Open MPI refuses to start as root", "export "
                       + " ".join(f"{name}=1" for name in ALLOW_ROOT) + ", or use another account")
    return Finding(sizes == ["2", "2"], f"{path} starts 2 ranks; number of ranks that each sees: "
                   f"{', '.join(sizes) or 'no output'}", "use the mpiexec of the MPI of mpi4py: "
                   "two ranks that each see 1 are two separate runs")


def main():
    """Print the findings; return 0 if pgran can run, else 1."""
    print(f"pgran {__version__}, {sys.executable}")
    good = True
    for finding in check():
        good = good and finding.good
        print(f"  {'ok ' if finding.good else 'BAD'} {finding.text}"
              + ("" if finding.good else f"\n      -> {finding.cure}"), flush=True)
    print("installation OK" if good else "installation has problems: see the arrows")
    return int(not good)
