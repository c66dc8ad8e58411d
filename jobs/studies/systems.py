r"""Iterations for the first linear system of time steps of several sizes.

    mpiexec -n 2 python -m studies.systems -options_file options/biaxial.opts \
        -pgran_inertia -ksp_rtol 1e-6 -from results/biaxial.h5 -snapshot 1 -dt 1e-8,1e-6,1e-4

The state of a snapshot is interpolated to this mesh. For each size of a step the first system of
Newton's method is solved. Rank 0 prints one line of JSON: the iterations, or null if the solver did
not converge.
"""

import sys
from dataclasses import replace

from .transfer import STEP, interpolated, main

STEPS = replace(STEP, kind="floats", meaning="time steps", default=(1e-3,))


def iterations(parameters, comm, path, number, steps):
    """Return the iterations for each step, or None if the solver diverges. Collective."""
    from pgran.solve.driver import Driver
    from pgran.space.weakform import discretise

    form = discretise(parameters.replace(step_first=min(steps), step_min=min(steps)), comm)
    state = interpolated(form, path, number)
    driver = Driver(form, state, lambda *_: None, targets=[])
    ksp = driver.ts.getSNES().getKSP()
    change, right, found = form.grid.create_vector(), form.grid.create_vector(), []
    for dt in steps:
        increment, (local, _) = driver.time_step(dt).increment, state.extrapolated(dt)
        right.setArray(form.residual(local, (local - state.local) / dt, increment))
        driver.fill(local, 1.0 / dt, increment, driver.matrix, driver.matrix)
        ksp.setOperators(driver.matrix)
        ksp.solve(right, change)
        found.append(ksp.getIterationNumber() if ksp.getConvergedReason() > 0 else None)
    return found


if __name__ == "__main__":
    sys.exit(main(iterations, __doc__, STEPS))
