"""Run a case: mpiexec -n 2 python -m pgran -options_file options/biaxial.opts

Solves dense granular flow with the local inertial or the non-local granular
fluidity rheology, equations (2.2)-(2.9), on a structured Q2-Q1 grid. With
-ts_type beuler the flow is followed in time; with -ts_type pseudo the mesh is
frozen and the steady rigid-viscous flow is found. A good run ends with the name
of its result file; a failed one with the reason, and exit code 1.
"""

import resource
import sys
import time

from .cli import solver_options, start, steady


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    return start(arguments, run, __doc__)


def run(parameters, own, comm):
    """Solve the case of the parameters and write its results. Collective.

    Raises
    ------
    OptionError, ParameterError
        Before anything is computed, if the options do not fit together.
    SolutionError
        If the solution stops; the last state that was reached is written first.
    """
    from petsc4py import PETSc

    from .options import OptionError, ParameterError, SolutionError
    from .output.results import Writer
    from .output.terminal import Terminal
    from .solve import state
    from .solve.driver import Driver
    from .space.weakform import discretise

    begin, is_steady = time.monotonic(), steady()
    if parameters.restart and not is_steady:
        raise OptionError(f"-pgran_restart {parameters.restart}: allowed only with "
                          "-ts_type pseudo")
    if parameters.inertia and is_steady:
        raise ParameterError("inertia", "true", "steady flow is quasi-static; allowed with "
                             "-ts_type pseudo is false")
    form = discretise(parameters, comm)
    case, terminal = form.case, Terminal(comm, parameters.progress)
    if is_steady:
        first = state.steady_start(form)
    else:
        first = state.reference(form) if parameters.seed else state.rest(form)

    def observe(driver, landed, report):
        with PETSc.Log.Stage("Output"):
            writer.record(**report)
            if is_steady:
                residual, done = driver.steady_residual(), 0.0
                text = f"residual {residual:.2e}"
            else:
                now, end = driver.state.time, case.targets[-1]
                done = case.count(now) / case.count(end)
                text = f"{case.label(now):>20}"
            terminal.step(driver.ts.getStepNumber(), done, text, report)
            if landed:
                writer.snapshot(driver.state.time, driver.fields())

    driver = Driver(form, first, observe, is_steady)
    writer = Writer(parameters.output, form, {"solver_options": solver_options()})
    terminal.opening(form, driver.ts)
    if writer.kept:
        terminal.say(f"  an earlier {writer.path} is kept as {writer.kept}")
    try:
        driver.solve()
    except SolutionError:
        if driver.started:
            writer.snapshot(driver.state.time, driver.fields())
        raise
    complete = driver.controller.finished
    if is_steady or not complete:
        writer.snapshot(driver.state.time, driver.fields())
    memory = comm.tompi4py().allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
    cost = {**driver.cost(), "seconds": time.monotonic() - begin, "memory": memory,
            "ranks": comm.size}
    writer.flush(complete=complete, **cost)
    if is_steady:
        residual = driver.steady_residual()
        writer.flush(steady_residual=residual)
        terminal.say(f"  steady: the rigid-viscous equations (2.9)-(2.11) hold to a residual of "
                     f"{residual:.2e} {case.stress_unit} d")
    elif not complete:
        terminal.say(f"  stopped by PETSc's options at {case.label(driver.state.time)} of "
                     f"{case.label(case.targets[-1])}")
    terminal.closing(writer, cost)


if __name__ == "__main__":
    sys.exit(main(sys.argv))
