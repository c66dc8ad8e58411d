"""What the tests share: discretisations, and runs under mpiexec with a time limit."""

import os
import subprocess
from pathlib import Path

import numpy as np
import petsc4py

# One machine: Open MPI need not look for networks each time that it starts.
os.environ.setdefault("OMPI_MCA_pml", "ob1")
os.environ.setdefault("OMPI_MCA_btl", "self,vader")
# Nor wait at each start for a munge that was installed and does not run.
os.environ.setdefault("PMIX_MCA_psec", "native")
petsc4py.init(["pgran-tests"])
from pgran.studies import launch  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
LIMIT = 240.0


def run_ranks(ranks, *arguments, limit=LIMIT, check=True):
    """Run ``python arguments`` on ranks, at most ``limit`` seconds; return the finished process."""
    done = launch.python(ranks, *arguments, timeout=limit, check=False, text=True, cwd=ROOT,
                         stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if check and done.returncode:
        raise AssertionError(f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done


def pgran(ranks, options_file, output, *arguments, **more):
    """Run ``python -m pgran`` with an options file and options."""
    return run_ranks(ranks, "-m", "pgran", "-options_file", ROOT / "options" / options_file,
                     "-pgran_output", output, *arguments, **more)


def refused(done, *messages):
    """Assert that a run ended with one error message that holds ``messages``."""
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stderr.count("error: ") == 1 and "Traceback" not in done.stderr, done.stderr
    for message in messages:
        assert message in done.stderr


def parameters(**options):
    """Return the resolved parameters of options given by their names without prefix."""
    from pgran import cases

    return cases.read({f"pgran_{name}": str(value) for name, value in options.items()})


def discretised(**options):
    """Return the `WeakForm` of options given by their names without prefix. Collective."""
    from petsc4py import PETSc

    from pgran.space.weakform import discretise

    return discretise(parameters(**options), PETSc.COMM_WORLD)


def at_rest(form, x, theta, time=0.0, stress=None):
    """Return the `Increment` on a mesh ``x``, with rates of zero and an old stress of zero."""
    return form.increment(x, form.no_stress() if stress is None else stress, theta, time)


def owned_elements(grid):
    """Return which of the local elements this rank owns, (n,) bool."""
    return np.isin(np.arange(grid.n_elements), grid.elements.owned)


def lattice_noise(lattice, seed):
    """Random numbers at the local points of a lattice that do not depend on the ranks."""
    nx, ny = lattice.shape
    table = np.random.default_rng(seed).standard_normal((ny, nx))
    return table[lattice.j % ny, lattice.i % nx]


def noise(grid, seed):
    """Random unknowns (n_local,) that do not depend on the ranks."""
    nodes = [lattice_noise(grid.nodes, seed + k) for k in range(3)]
    return grid.join(np.array(nodes[:2]), nodes[2], lattice_noise(grid.corners, seed + 3))


def newton(form, increment, local, tolerance=1e-11, most=30):
    """Solve the form's equations by Newton's method with a direct solver; return the unknowns."""
    from petsc4py import PETSc

    grid, matrix = form.grid, form.create_matrix()
    ksp = PETSc.KSP().create(comm=grid.comm)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    right, update = grid.create_vector(), grid.create_vector()
    zero = np.zeros(grid.n_local)
    for _ in range(most):
        right.setArray(form.residual(local, zero, increment))
        if right.norm() < tolerance:
            return local
        form.jacobian(local, 0.0, increment, matrix)
        ksp.setOperators(matrix)
        ksp.solve(right, update)
        local = local - grid.to_local(update)
    raise AssertionError(f"Newton's method stopped at a residual of {right.norm():.3e}")
