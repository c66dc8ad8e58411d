"""Check the installation of pgran: python -m pgran -doctor

Each library is tried in a separate process, so that a crash is reported too.
"""

import json
import os
import shutil
import subprocess
import sys

from . import __version__

#: Time limit of a check, s.
LIMIT = 60
#: Tested versions of PETSc.
OLDEST, NEWEST = (3, 18), (3, 26)

PETSC = """
from petsc4py import PETSc
import numpy
facts = dict(version=PETSc.Sys.getVersion(), real=PETSc.ScalarType is numpy.float64,
             bits=8*numpy.dtype(PETSc.IntType).itemsize,
             mumps="present" if PETSc.Sys.hasExternalPackage("mumps") else "missing")
"""
SLEPC = "from slepc4py import SLEPc; facts = dict(version=SLEPc.Sys.getVersion())"
MPI = """
from mpi4py import MPI
facts = dict(library=MPI.Get_library_version().split(",")[0].strip().strip(chr(0)))
"""
HDF5 = "import h5py; facts = dict(version=h5py.__version__, hdf5=h5py.version.hdf5_version)"
TOGETHER = """
import os
from petsc4py import PETSc
from mpi4py import MPI
import h5py
facts = dict(mpi=sorted({os.path.realpath(line.split()[-1]) for line in open("/proc/self/maps")
                         if "/libmpi.so" in line or "/libmpich" in line}))
"""
VERSION = "import {0}; facts = dict(version={0}.__version__)"
#: Each rank writes its text in one call, so that texts do not mix.
RANKS = "import os; from mpi4py import MPI; os.write(1, b' %d ' % MPI.COMM_WORLD.size)"


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
    return (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]


def check():
    """Yield for each library whether it is good, a description, and a remedy."""
    yield sys.version_info >= (3, 9), f"Python {sys.version.split()[0]}", "install Python 3.9"
    petsc, slepc, mpi, hdf5, both = found = [*map(facts, (PETSC, SLEPC, MPI, HDF5, TOGETHER))]
    petsc_works, slepc_works, mpi_works, _, both_work = (isinstance(each, dict) for each in found)
    for name, each, text, remedy in (
            ("petsc4py", petsc, "petsc4py {version[0]}.{version[1]}.{version[2]}, {bits}-bit "
             "indices, MUMPS {mumps}", "on Debian: bash jobs/local.sh setup; elsewhere install "
             "PETSc with MUMPS, and petsc4py (pip or conda-forge)"),
            ("slepc4py", slepc, "slepc4py {version[0]}.{version[1]}.{version[2]}",
             "install slepc4py of the same version as petsc4py, for pgran-eigen and pgran-growth"),
            ("mpi4py", mpi, "mpi4py with {library}", "install mpi4py built with the MPI of PETSc"),
            ("h5py", hdf5, "h5py {version}, HDF5 {hdf5}", "install h5py"),
            ("scipy", facts(VERSION.format("scipy")), "scipy {version}",
             "install scipy; for Debian's petsc4py: pip install scipy 'numpy<2'"),
            ("petsc4py, mpi4py and h5py in one process", both, "one MPI library: {mpi}",
             "install all of them from the same source: Debian, one conda environment, or pip")):
        works = isinstance(each, dict)
        yield works, text.format(**each) if works else f"{name}: {each}", remedy
    if petsc_works and not petsc["real"]:
        yield False, "PETSc has complex numbers", (
            "install PETSc with real numbers (Debian: PETSC_ARCH ...-real; "
            "configure --with-scalar-type=real)")
    if petsc_works and not OLDEST <= tuple(petsc["version"][:2]) <= NEWEST:
        yield False, "untested version of PETSc", f"install PETSc from {OLDEST} to {NEWEST}"
    if petsc_works and petsc["mumps"] == "missing":
        yield False, "PETSc has no MUMPS, so that only multigrid can be used", (
            "configure PETSc with --download-mumps --download-scalapack")
    if both_work and len(both["mpi"]) != 1:
        yield False, f"{len(both['mpi'])} MPI libraries in one process", (
            "rebuild mpi4py and h5py with the MPI of PETSc: "
            "MPICC=mpicc pip install --no-binary :all: mpi4py")
    if petsc_works and slepc_works and petsc["version"][:2] != slepc["version"][:2]:
        yield False, "petsc4py and slepc4py have different versions", "use one source for both"
    if mpi_works and "Open MPI" in mpi["library"] and not (
            os.geteuid() or os.environ.get("OMPI_ALLOW_RUN_AS_ROOT")):
        yield False, "Open MPI refuses to start as root", (
            "export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1")
    yield _launcher()
    for name, use in (("matplotlib", "pictures"), ("pyvista", "3D grids and windows")):
        each = facts(VERSION.format(name))
        yield True, (f"{name} {each['version']}" if isinstance(each, dict) else f"{name}: not "
                     f"installed; required for {use} (pip install 'pgran[plot]')"), ""


def _launcher():
    """Check that mpiexec starts ranks of one MPI job; see `check`."""
    path = shutil.which("mpiexec")
    if not path:
        return False, "mpiexec: not on the path", (
            "install the MPI of mpi4py, or start ranks as described for your cluster (srun)")
    from .runs.run_on_ranks import python

    try:
        sizes = python(2, "-c", RANKS, check=False, timeout=LIMIT, text=True,
                       stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout.split()
    except subprocess.TimeoutExpired:
        sizes = []
    return sizes == ["2", "2"], f"{path} starts 2 ranks, which see {sizes or 'nothing'}", (
        "use the mpiexec of the MPI of mpi4py: two ranks that each see 1 are two separate runs")


def main():
    """Print the checks; return 0 if pgran can run, else 1."""
    print(f"pgran {__version__}, {sys.executable}")
    all_good = True
    for good, text, remedy in check():
        all_good = all_good and good
        print(f"  {'ok ' if good else 'BAD'} {text}" + ("" if good else f"\n      -> {remedy}"),
              flush=True)
    print("installation OK" if all_good else "installation has problems: see the arrows")
    return int(not all_good)
