r"""Cost of one time step from the state of a snapshot, for each linear system.

    mpiexec -n 2 python -m studies.one_step -options_file options/biaxial.opts \
        -pgran_element_size 0.5 -from results/biaxial.h5 -snapshot 1 -dt 1e-3

The fields of the snapshot are interpolated to this mesh, whose elements must divide the elements of
the snapshot. Rank 0 prints one line of JSON: for each Newton iteration the norm of the residual,
the linear iterations, and the seconds of the iteration, the Jacobian and the residuals; and the
peak memory of the ranks.
"""

import resource
import sys
import time

from .transfer import interpolated, main


def one_step(parameters, comm, path, number, dt):
    """Solve one step of size ``dt``, 1/gdot0, and return its cost, a dictionary. Collective."""
    from mpi4py import MPI
    from petsc4py import PETSc

    from pgran.solve.driver import Driver
    from pgran.space.weakform import discretise

    begin, ranks, rows = time.perf_counter(), comm.tompi4py(), []
    form = discretise(parameters.replace(step_first=dt, step_error=1e10), comm)
    state = interpolated(form, path, number)
    driver = Driver(form, state, lambda *_: None, targets=[state.time + dt])
    events = {"jacobian": PETSc.Log.Event("TSJacobianEval"),
              "evaluation": PETSc.Log.Event("TSFunctionEval")}
    PETSc.Log.begin()

    def monitor(snes, iteration, norm):
        spent = {name: event.getPerfInfo()["time"] for name, event in events.items()}
        rows.append({"residual": norm, "seconds": time.perf_counter(), **spent,
                     "iterations": snes.getKSP().getIterationNumber() if iteration else 0})

    driver.ts.getSNES().setMonitor(monitor)
    ready = time.perf_counter()
    driver.solve()
    for previous, row in reversed(list(zip(rows, rows[1:]))):
        for key in ("seconds", *events):
            row[key] -= previous[key]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"unknowns": driver.matrix.getSize()[0], "ranks": comm.size,
            "element_size": parameters.element_size, "newton": rows[1:], "set_up": ready - begin,
            "memory": ranks.allreduce(memory, MPI.MAX), "memory_sum": ranks.allreduce(memory)}


if __name__ == "__main__":
    sys.exit(main(one_step, __doc__))
