"""Runs commands of pgran in forks of one process that has imported what they need.

Each line of standard input is JSON: {"module", "arguments", "folder", "environment", "output",
"errors"}. The command runs in the folder, with these variables of the environment besides and with
its output in these files, as if it had been started there; the answer is a line of JSON with its
exit code and its seconds. A command that takes longer than LIMIT is killed and has the exit code
None.
"""

import importlib
import json
import os
import signal
import sys
import time

LIMIT = 30.0
#: Commands whose arguments begin with the name of the program.
NAMED = "pgran.__main__", "pgran.eigen", "pgran.growth"


def run(request):
    """Run one command in this process, which is a fork; return its exit code."""
    os.chdir(request["folder"])
    os.environ.update(request["environment"])
    for name, number in (("output", 1), ("errors", 2)):
        file = os.open(request[name], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, number)
    module = importlib.import_module(request["module"])
    arguments = request["arguments"]
    if request["module"] in NAMED:
        arguments = [request["module"], *arguments]
    return module.main(arguments)


def serve():
    """Answer requests; in a fork, return the exit code of its command."""
    for line in sys.stdin:
        child, begin = os.fork(), time.monotonic()
        if not child:
            return run(json.loads(line))
        code = None
        while time.monotonic() - begin < LIMIT:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                code = os.waitstatus_to_exitcode(status)
                break
            time.sleep(0.005)
        else:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        print(json.dumps({"code": code, "seconds": time.monotonic() - begin}), flush=True)
    return 0


if __name__ == "__main__":
    import h5py  # noqa: F401  # imported once, for all forks
    import numpy  # noqa: F401

    import pgran.__main__
    import pgran.eigen
    import pgran.growth
    import pgran.measure
    import pgran.stability  # noqa: F401

    sys.exit(serve())
