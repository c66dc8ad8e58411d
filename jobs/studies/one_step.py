r"""One time step from the state of a snapshot, on any mesh: iterations, times and memory.

    mpiexec -n 2 python -m studies.one_step -options_file options/biaxial.opts \
        -pgran_element_size 0.5 -from results/biaxial.h5 -snapshot 1 -dt 1e-3 [-name text]

The fields of the snapshot, on the same or a coarser mesh whose elements this one divides, are
interpolated to this mesh. With -measure step, the default, one step is solved from there: for each
Newton iteration the norm of the residual, the linear iterations, and the seconds of the iteration,
of the Jacobian and of the residual; and the peak memory of the ranks. With -measure system only the
first linear system of a step is solved, for each of several -dt: its iterations, or null where the
solver did not converge. Rank 0 prints one line of JSON. PETSc's options apply.
"""

import json
import resource
import sys
import time

from pgran.cli import command_option, start

MEASURES = "step", "system"
OPTIONS = (
    command_option("from", "str", "result file with the snapshot"),
    command_option("snapshot", "int", "which snapshot; a negative number counts from the end", -1),
    command_option("dt", "floats", "sizes of the step", (1e-3,), unit="1/gdot0", low=0.0,
                   open_low=True),
    command_option("measure", "str", "what is measured", "step", choices=MEASURES),
    command_option("name", "str", "name of this step in the output", ""))


def driver_of(parameters, comm, path, number, steps, end=False, **more):
    """Return the `pgran.solve.driver.Driver` of steps from a snapshot. Collective."""
    from pgran.solve.driver import Driver
    from pgran.space.weakform import discretise

    from .transfer import interpolated

    form = discretise(parameters.replace(step_first=min(steps), **more), comm)
    state = interpolated(form, path, number)
    return Driver(form, state, lambda *_: None, targets=[state.time + steps[0]] if end else [])


def one_step(parameters, comm, path, number, dt):
    """Solve one step of the size ``dt``, 1/gdot0; return a dictionary of its cost. Collective.

    ``path`` and ``number`` are arguments of `studies.transfer.interpolated`.
    """
    from mpi4py import MPI

    begin, ranks = time.perf_counter(), comm.tompi4py()
    driver = driver_of(parameters, comm, path, number, (dt,), end=True, step_error=1e10)
    rows, spent = [], {"jacobian": 0.0, "evaluation": 0.0}

    def timed(name, method):
        def call(*arguments):
            started = time.perf_counter()
            method(*arguments)
            spent[name] += time.perf_counter() - started
        return call

    vector, (residual, _, _) = driver.ts.getIFunction()
    driver.ts.setIFunction(timed("evaluation", residual), vector)
    matrix, _, (jacobian, _, _) = driver.ts.getIJacobian()
    driver.ts.setIJacobian(timed("jacobian", jacobian), matrix, matrix)

    def monitor(snes, iteration, norm):
        rows.append({"residual": norm, "seconds": time.perf_counter(), **spent,
                     "iterations": snes.getKSP().getIterationNumber() if iteration else 0})

    driver.ts.getSNES().setMonitor(monitor)
    ready = time.perf_counter()
    driver.solve()
    for before, after in reversed(list(zip(rows, rows[1:]))):
        for key in ("seconds", *spent):
            after[key] -= before[key]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"unknowns": matrix.getSize()[0], "ranks": comm.size,
            "element_size": parameters.element_size, "newton": rows[1:], "set_up": ready - begin,
            "memory": ranks.allreduce(memory, MPI.MAX), "memory_sum": ranks.allreduce(memory)}


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


def systems(parameters, comm, path, number, steps):
    """Solve the first linear system for each step size; return the iterations. Collective.

    None where the solver did not converge.
    """
    driver = driver_of(parameters, comm, path, number, steps, step_min=min(steps))
    change, found = driver.grid.create_vector(), []
    for dt in steps:
        ksp, right = first_system(driver, dt)
        ksp.solve(right, change)
        found.append(ksp.getIterationNumber() if ksp.getConvergedReason() > 0 else None)
    return found


def action(parameters, args, comm):
    """Run the command line. Collective."""
    snapshot = parameters, comm, getattr(args, "from"), args.snapshot
    if args.measure == "step":
        found = {"name": args.name, **one_step(*snapshot, args.dt[0])}
    else:
        found = systems(*snapshot, args.dt)
    if comm.rank == 0:
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    sys.exit(start(sys.argv, action, __doc__, OPTIONS))
