"""Shared helpers of the tests: discretisations, and commands with a time limit."""

import fcntl
import functools
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import petsc4py
import pytest

# One machine: Open MPI does not search for networks, and does not wait for a munge daemon. Several
# runs share the cores: ranks are not bound to cores, and waiting ranks yield.
for variable, setting in (
        ("pml", "ob1"), ("btl", "self,vader"), ("hwloc_base_binding_policy", "none"),
        ("mpi_yield_when_idle", "1")):
    os.environ.setdefault(f"OMPI_MCA_{variable}", setting)
os.environ.setdefault("PMIX_MCA_psec", "native")
ROOT = Path(__file__).resolve().parent.parent
# The studies are not installed.
sys.path.insert(0, str(ROOT / "jobs"))
os.environ["PYTHONPATH"] = os.pathsep.join(
    filter(None, (str(ROOT / "jobs"), os.environ.get("PYTHONPATH"))))
petsc4py.init(["pgran-tests"])
from pgran.runs import run_on_ranks  # noqa: E402

# A signal, as from timeout, ends the tests. Forwarded to the present run, it would give a failure
# with exit code 75.
run_on_ranks.SIGNALS = ()
signal.signal(signal.SIGTERM, signal.default_int_handler)

#: Seconds after which a command counts as hanging.
LIMIT = 600.0
#: The slowest files. They begin first, so that the workers end at about the same time.
LONGEST = ("test_multigrid.py", "test_runs.py", "test_restart.py", "test_flows.py",
           "test_studies.py", "test_eigen.py", "test_growth.py")


def pytest_collection_modifyitems(items):
    order = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))


def pytest_sessionfinish():
    if fork_server.cache_info().currsize:
        fork_server().communicate()


def start(ranks, *arguments, **more):
    """Start ``python arguments`` on ranks in the background; return the process."""
    line, environment = run_on_ranks.command(ranks, *arguments)
    return subprocess.Popen(line, **{"env": environment, "cwd": ROOT, "text": True,
                                     "stderr": subprocess.PIPE, **more})


@functools.cache
def fork_server():
    """Return the process of ``forkserver.py``, started by the first call."""
    return start(0, ROOT / "tests" / "forkserver.py", stdin=subprocess.PIPE, stderr=None,
                 stdout=subprocess.PIPE)


def run_in_fork(module, *arguments, folder=ROOT, limit=LIMIT):
    """Run ``python -m module`` in a fork of the `fork_server`; return the finished process."""
    server = fork_server()
    with tempfile.NamedTemporaryFile("r") as output, tempfile.NamedTemporaryFile("r") as errors:
        server.stdin.write(json.dumps({
            "module": module, "arguments": list(map(str, arguments)), "folder": str(folder),
            "environment": run_on_ranks.command(0)[1], "output": output.name,
            "errors": errors.name, "limit": limit}) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        done = subprocess.CompletedProcess([module, *arguments], code, output.read(), errors.read())
    assert code != -signal.SIGALRM, f"{done} did not end within {limit:.0f} s"
    return done


def run_ranks(ranks, *arguments, limit=LIMIT, check=True):
    """Run ``python arguments`` on ranks; on 0 ranks, run ``-m module`` in a fork."""
    if not ranks and arguments[0] == "-m":
        done = run_in_fork(*arguments[1:], limit=limit)
    else:
        done = run_on_ranks.python(ranks, *arguments, timeout=limit, check=False,
                                   text=True, cwd=ROOT, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE)
    if check and done.returncode:
        raise AssertionError(f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done


def pgran(ranks, options_file, output, *arguments, patch="", limit=LIMIT, check=True, **options):
    """Run ``python -m pgran`` with an options file and options, after the statements ``patch``.

    Strings are split at blanks, and ``name=value`` is the option ``-pgran_name value``.
    """
    words = [word for argument in arguments for word in (
        argument.split() if isinstance(argument, str) else [argument])]
    words += [word for name, value in options.items() for word in (f"-pgran_{name}", value)]
    program = "-m", "pgran"
    if patch:
        program = "-c", ("import os, sys, petsc4py\npetsc4py.init()\n"
                         f"{patch}\nfrom pgran.__main__ import main\nsys.exit(main(sys.argv))")
    return run_ranks(ranks, *program, "-options_file", ROOT / "options" / options_file,
                     "-pgran_output", output, *words, limit=limit, check=check)


@pytest.fixture
def path(tmp_path):
    """Return the path of a result that a test writes."""
    return tmp_path / "run.h5"


@pytest.fixture(scope="session")
def small_specimen(tmp_path_factory):
    """Return a result of a specimen of 8 d x 24 d with two snapshots, which tests do not change.

    The first worker makes the run, and the others wait for it.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # the folder of all workers
    path = folder / "small" / "small.h5"
    path.parent.mkdir(exist_ok=True)
    with open(path.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            pgran(2, "biaxial.opts", path, width=8, height=24, compression=0.002,
                  snapshots="0.001,0.002")
    return path


def refused(done, *messages):
    """Assert that a run ended with one error message that contains ``messages``."""
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stderr.count("error: ") == 1, done.stderr
    assert "Traceback" not in done.stderr and "PETSC ERROR" not in done.stderr, done.stderr
    for message in messages:
        assert message in done.stderr


def read_vtk(path):
    """Yield the pyvista grids of a result, one for each step, as VTK reads them."""
    import pyvista
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        yield pyvista.wrap(reader.GetOutput()).copy()


def parameters(**options):
    """Return the resolved parameters of options without prefix."""
    from pgran import cases

    return cases.read({f"pgran_{name}": str(value) for name, value in options.items()})


def discretised(**options):
    """Return the `WeakForm` of options without prefix. Collective."""
    from petsc4py import PETSc

    from pgran.space.weakform import discretise

    return discretise(parameters(**options), PETSc.COMM_WORLD)


def at_rest(form, x, theta, time=0.0, stress=None):
    """Return the `Increment` on a mesh ``x``, with zero rates and by default zero stress."""
    return form.increment(x, form.no_stress() if stress is None else stress, theta, time)


def noise(grid, seed):
    """Return random unknowns (n_local,), independent of the ranks."""
    def values(lattice, number):
        nx, ny = lattice.shape
        i, j = lattice.index
        table = np.random.default_rng(seed + number).standard_normal((ny, nx))
        return table[j % ny, i % nx]

    v1, v2, fluidity = (values(grid.nodes, number) for number in range(3))
    return grid.join(np.array([v1, v2]), fluidity, values(grid.corners, 3))


def newton(form, increment, local, tolerance=1e-11, max_iterations=30):
    """Solve the equations by Newton's method with a direct solver; return the unknowns."""
    from petsc4py import PETSc

    grid, matrix = form.grid, form.create_matrix()
    ksp = PETSc.KSP().create(comm=grid.comm)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    right, update = grid.create_vector(), grid.create_vector()
    zero = np.zeros(grid.n_local)
    for _ in range(max_iterations):
        right.setArray(form.residual(local, zero, increment))
        if right.norm() < tolerance:
            return local
        form.jacobian(local, 0.0, increment, matrix)
        ksp.setOperators(matrix)
        ksp.solve(right, update)
        local = local - grid.to_local(update)
    raise AssertionError(f"Newton's method stopped at a residual of {right.norm():.3e}")
