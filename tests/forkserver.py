"""Runs ``python -m module arguments`` in forks of one process that has imported the modules.

Each line of standard input is JSON: {"module", "arguments", "folder", "environment", "output",
"errors", "limit"}. The server writes a line of JSON with the exit code, or null if the command was
ended after the limit in seconds. Its first line is "ready".
"""

import ctypes
import importlib
import json
import os
import runpy
import signal
import sys
import time
import warnings
from pathlib import Path

#: Modules that commands import. PETSc itself starts MPI, which must not happen before a fork.
MODULES = ("h5py", "numpy", "petsc4py", "slepc4py", "pgran.__main__", "pgran.eigen",
           "pgran.growth", "pgran.measure", "pgran.stability")
#: Packages, and the names of their shared libraries that commands load.
LIBRARIES = ("petsc4py", "PETSc"), ("slepc4py", "SLEPc")
#: Time for a command to end after its limit, s.
GRACE = 10.0


def prepare():
    """Import the modules, and load PETSc's libraries without starting PETSc."""
    for name in MODULES:
        importlib.import_module(name)
    for package, library in LIBRARIES:
        for path in (Path(sys.modules[package].__file__).parent / "lib").glob(f"**/{library}*.so"):
            ctypes.CDLL(str(path))


def run(request):
    """Run one command in this process, which is a fork."""
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    for number, name in enumerate((os.devnull, request["output"], request["errors"])):
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC if number else os.O_RDONLY
        os.dup2(os.open(name, flags), number)
    sys.path[0] = request["folder"]  # as with python -m
    sys.argv[1:] = request["arguments"]
    # The imported module runs once more under the name of the program.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="runpy")
    runpy.run_module(request["module"], run_name="__main__", alter_sys=True)


def exit_code(child, seconds):
    """Return the exit code of a child that ends within some seconds, otherwise None."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    return None


def serve():
    """Process requests. In a fork, run the command."""
    print("ready", flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        child = os.fork()
        if not child:
            return run(request)
        code = exit_code(child, request["limit"])
        if code is None:
            os.kill(child, signal.SIGTERM)
            if exit_code(child, GRACE) is None:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
        print(json.dumps({"code": code}), flush=True)


if __name__ == "__main__":
    prepare()
    serve()
