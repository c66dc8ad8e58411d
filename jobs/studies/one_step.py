r"""One time step from the state of a snapshot, on any mesh: what it costs, system by system.

    mpiexec -n 2 python -m studies.one_step -options_file options/biaxial.opts \
        -pgran_element_size 0.5 -from results/biaxial.h5 -snapshot 1 -dt 1e-3 [-name text]

The fields of the snapshot, which may stem from a coarser mesh whose elements this one divides, are
interpolated to this mesh, and one step is solved from there. Rank 0 prints one line of JSON: for
each Newton iteration the norm of the residual, the linear iterations, and the seconds of the whole,
of the Jacobian and of evaluating residuals; and the peak memory of the ranks. PETSc's options hold.
"""

import json
import resource
import sys
import time

from pgran.cli import command_option, start

#: The rows that name the state from which a step starts.
SNAPSHOT = (
    command_option("from", "str", "result file with the snapshot"),
    command_option("snapshot", "int", "which snapshot; a negative number counts from the end", -1))
OPTIONS = (
    *SNAPSHOT,
    command_option("dt", "float", "size of the step", 1e-3, unit="1/gdot0", low=0.0, open_low=True),
    command_option("name", "str", "what the line of JSON calls this step", ""))


def one_step(parameters, comm, path, number, dt):
    """Solve one step and return what it took, a dictionary. Collective.

    Parameters
    ----------
    parameters : pgran.options.Parameters
    comm : PETSc.Comm
    path, number
        File and snapshot, as for `studies.transfer.interpolated`.
    dt : float
        Size of the step, 1/gdot0.
    """
    from mpi4py import MPI

    from pgran.solve.driver import Driver
    from pgran.space.weakform import discretise

    from .transfer import interpolated

    begin, ranks = time.perf_counter(), comm.tompi4py()
    form = discretise(parameters.replace(step_first=dt, step_error=1e10), comm)
    state = interpolated(form, path, number)
    driver = Driver(form, state, lambda *_: None, targets=[state.time + dt])
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


def action(parameters, asked, comm):
    """Answer the command line. Collective."""
    found = one_step(parameters, comm, getattr(asked, "from"), asked.snapshot, asked.dt)
    if comm.rank == 0:
        print(json.dumps({"name": asked.name, **found}), flush=True)


def main(arguments):
    """Solve the step of the command line ``arguments``; return the exit code. Collective."""
    return start(arguments, action, __doc__, OPTIONS)


if __name__ == "__main__":
    sys.exit(main(sys.argv))
