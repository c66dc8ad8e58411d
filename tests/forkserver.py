"""Runs ``python -m module arguments`` in forks of one process that has imported what they need.

A fork saves what a new process spends on imports. Each line of standard input is JSON: {"module",
"arguments", "folder", "environment", "output", "errors", "limit"}. The command runs in the folder,
with exactly these variables of the environment, and writes to these two files. The answer is a line
of JSON with its exit code, which is null if the command took longer than the limit in seconds and
was ended. The first line that the server writes says that it is ready.
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

#: What commands import. PETSc itself starts MPI, which must not happen before a fork.
MODULES = ("h5py", "numpy", "petsc4py", "slepc4py", "pgran.__main__", "pgran.eigen",
           "pgran.growth", "pgran.measure", "pgran.stability")
#: Shared libraries that commands load, as files of packages.
LIBRARIES = ("petsc4py", "PETSc"), ("slepc4py", "SLEPc")
#: Seconds that a command has to end itself after its limit.
GRACE = 10.0


def prepare():
    """Import the modules, and load PETSc's libraries without starting PETSc."""
    for name in MODULES:
        importlib.import_module(name)
    for package, library in LIBRARIES:
        folder = Path(sys.modules[package].__file__).parent / "lib"
        for path in folder.glob(f"**/{library}*.so"):
            ctypes.CDLL(str(path))


def run(request):
    """Run one command in this process, which is a fork. It ends as the command does."""
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    for number, name in enumerate((os.devnull, request["output"], request["errors"])):
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC if number else os.O_RDONLY
        os.dup2(os.open(name, flags), number)
    sys.path[0] = request["folder"]  # as python -m has it
    sys.argv[1:] = request["arguments"]
    # The module was imported already, and runs once more under the name of the program.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="runpy")
    runpy.run_module(request["module"], run_name="__main__", alter_sys=True)


def ended(child, seconds):
    """Return the exit code of a child that ends within some seconds, otherwise None."""
    end = time.monotonic() + seconds
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            return None
        time.sleep(0.005)


def serve():
    """Answer requests. In a fork, run the command."""
    print("ready", flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        child = os.fork()
        if not child:
            return run(request)
        code = ended(child, request["limit"])
        if code is None:
            os.kill(child, signal.SIGTERM)
            if ended(child, GRACE) is None:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
        print(json.dumps({"code": code}), flush=True)


if __name__ == "__main__":
    prepare()
    serve()
