"""Runs ``python -m module arguments`` in forks of one process that has imported the modules.

Each line of standard input is JSON: {"module", "arguments", "folder", "environment", "output",
"errors", "limit"}. SIGALRM ends the command after the limit in seconds. The server writes a line
with the exit code.
"""

import ctypes
import importlib
import json
import os
import runpy
import signal
import sys
import warnings
from pathlib import Path

#: Modules that commands import. PETSc itself starts MPI, which must not happen before a fork.
MODULES = ("h5py", "numpy", "petsc4py", "slepc4py", "pgran.__main__", "pgran.eigen",
           "pgran.growth", "pgran.measure", "pgran.stability")
#: Packages, and the names of their shared libraries that commands load.
LIBRARIES = ("petsc4py", "PETSc"), ("slepc4py", "SLEPc")


def run(request):
    """Run one command in this process, which is a fork."""
    signal.setitimer(signal.ITIMER_REAL, request["limit"])
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    for number, name in enumerate((os.devnull, request["output"], request["errors"])):
        os.dup2(os.open(name, os.O_WRONLY if number else os.O_RDONLY), number)
    sys.path[0] = request["folder"]  # as with python -m
    sys.argv[1:] = request["arguments"]
    # The imported module runs once more under the name of the program.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="runpy")
    runpy.run_module(request["module"], run_name="__main__", alter_sys=True)


def serve():
    """Import the modules, load PETSc's libraries without starting PETSc, and process requests."""
    for name in MODULES:
        importlib.import_module(name)
    for package, library in LIBRARIES:
        for path in (Path(sys.modules[package].__file__).parent / "lib").glob(f"**/{library}*.so"):
            ctypes.CDLL(str(path))
    for line in sys.stdin:
        child = os.fork()
        if not child:
            return run(json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    serve()
