r"""The first linear system of a time step, over sizes of the step: iterations.

    mpiexec -n 2 python -m studies.systems -options_file options/biaxial.opts \
        -pgran_inertia -ksp_rtol 1e-6 -from results/biaxial.h5 -snapshot 1 -dt 1e-8,1e-6,1e-4

The state of a snapshot is taken to this mesh as `studies.one_step` does. From there Newton's
method starts a step of each size, and its first system is solved. Rank 0 prints one line of JSON:
the iterations, or nothing (null) where the solver did not converge. PETSc's options hold.
"""

import json
import sys

from pgran.cli import command_option, start

from .one_step import SNAPSHOT

OPTIONS = (
    *SNAPSHOT,
    command_option("dt", "floats", "sizes of the step", (1e-3,), unit="1/gdot0", low=0.0, open_low=True))


def systems(parameters, comm, path, number, steps):
    """Solve one linear system for each size of a step; return its iterations. Collective.

    Parameters
    ----------
    parameters : pgran.options.Parameters
    comm : PETSc.Comm
    path, number
        File and snapshot, as for `studies.transfer.interpolated`.
    steps : sequence of float
        Sizes, 1/gdot0.

    Returns
    -------
    list of int or None
        None where the solver did not converge.
    """
    driver = start_of_steps(parameters, comm, path, number, steps)
    change, found = driver.grid.create_vector(), []
    for dt in steps:
        ksp, right = first_system(driver, dt)
        ksp.solve(right, change)
        found.append(ksp.getIterationNumber() if ksp.getConvergedReason() > 0 else None)
    return found


def start_of_steps(parameters, comm, path, number, steps):
    """Return the `pgran.solve.driver.Driver` that starts the ``steps`` of `systems`. Collective."""
    from pgran.solve.driver import Driver
    from pgran.space.weakform import discretise

    from .transfer import interpolated

    form = discretise(parameters.replace(step_first=min(steps), step_min=min(steps)), comm)
    return Driver(form, interpolated(form, path, number), lambda *_: None, targets=[])


def first_system(driver, dt):
    """Return the KSP and the right-hand side of the first system of a step. Collective."""
    form, state, increment = driver.form, driver.state, driver.time_step(dt).increment
    local, _ = state.extrapolated(dt)
    right = form.grid.create_vector()
    right.setArray(form.residual(local, (local - state.local) / dt, increment))
    driver.fill(local, 1.0 / dt, increment, driver.matrix, driver.matrix)
    ksp = driver.ts.getSNES().getKSP()
    ksp.setOperators(driver.matrix)
    return ksp, right


def action(parameters, asked, comm):
    """Answer the command line. Collective."""
    found = systems(parameters, comm, getattr(asked, "from"), asked.snapshot, asked.dt)
    if comm.rank == 0:
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    sys.exit(start(sys.argv, action, __doc__, OPTIONS))
