"""Run a simulation: mpiexec -n 2 python -m pgran -options_file options/biaxial.opts

Solves dense granular flow with the local inertial or the non-local granular
fluidity rheology, equations (2.2)-(2.9), on a structured Q2-Q1 grid. With
-ts_type beuler the flow evolves in time; with -ts_type pseudo the mesh is
fixed and the steady rigid-viscous flow is computed. On success the exit code is
0 and the name of the result file is printed; on failure the exit code is 1 and
the reason is printed.

A run in time writes checkpoints. On SIGTERM, SIGINT, SIGUSR1 or SIGUSR2 it writes
a checkpoint and stops with exit code 75; resume it with -pgran_restart NAME.h5.
"""

import resource
import sys
import time
from functools import partial

from .signals import Signals

# Before the imports that take long.
STOP_REQUEST = Signals() if __name__ == "__main__" else None

from .cli.petsc import choose_solver, solver_options, start, steady  # noqa: E402
from .cli.report import all_ranks_arrive, report_unused  # noqa: E402


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    if "-doctor" in arguments:  # also works if PETSc does not
        from . import doctor

        return doctor.main()
    stop_request = STOP_REQUEST or Signals()
    return start(arguments, lambda parameters, args, comm: Run(
        parameters, comm, stop_request).do(), __doc__, complete=partial(complete, words=arguments))


def complete(texts, words=()):
    """Add the options of the run that is resumed, and a default solver; return {name: text}.

    A restart on the command line ``words`` ignores the output of an options file and continues in
    the file of the restart.
    """
    if texts.get("pgran_restart") and not steady():
        from .options import ParameterError
        from .output.reader import continued

        if "-pgran_restart" in words and "-pgran_output" not in words:
            texts = {name: text for name, text in texts.items() if name != "pgran_output"}
        if number := texts.get("pgran_restart_snapshot"):
            raise ParameterError("restart_snapshot", number, "requires @@ts_type pseudo; a run in "
                                 "time resumes from its newest checkpoint")
        texts = continued(texts)
    path, texts = choose_solver(texts)
    if path and texts.get("pgran_progress") != "quiet":
        from mpi4py import MPI

        if MPI.COMM_WORLD.rank == 0:
            print(f"pgran: no -pc_type is given; using the solver of options/{path.name}")
    return texts


class Run:
    """A run: its driver, result file, checkpoints and terminal output. Collective.

    ``stop_request()`` returns on each rank the reason to stop, a text, or None.
    """

    def __init__(self, parameters, comm, stop_request):
        from .options import ParameterError
        from .output.start import Source
        from .output.terminal import Terminal
        from .output.writer import BALANCE, HISTORY, Writer
        from .solve import state
        from .solve.driver import Driver
        from .space.weakform import discretise

        self.steady = steady()
        if parameters.inertia and self.steady and parameters.part("case").moving:
            raise ParameterError("inertia", "true", "steady flow on a moving mesh is quasi-static; "
                                 "with -ts_type pseudo it must be false")
        self.form = form = discretise(parameters, comm)
        self.began, self.case, self.parameters = time.monotonic(), form.case, form.case.parameters
        self.comm, self.last_checkpoint = form.grid.comm.tompi4py(), (self.began, 0)
        self.control_comm = self.comm.Dup()
        self.terminal = Terminal(form.grid.comm, self.parameters.progress)
        self.source, self.checkpoint_values = None, {}
        if self.steady:
            first = state.steady_start(form)
        elif self.parameters.restart:
            first, values, damaged = state.checkpoint_start(form)
            self.checkpoint_values = values
            self.source = Source(self.parameters.restart, values["run"], values["history"],
                                 values["snapshots"])
            for text in damaged:
                self.terminal.say(f"  skipped a damaged checkpoint, {text}")
        elif self.parameters.mode_file:
            first = state.seeded(form)
        else:
            first = state.rest(form)
        self.landed = self.source.snapshots if self.source else 0
        self.driver = Driver(form, first, self.observe, self.steady,
                             checkpoint=self.checkpoint_values or None,
                             stop_requested=stop_request)
        columns = tuple(name for name in HISTORY if not (self.steady and name in BALANCE))
        self.writer = Writer(self.parameters.output, form, columns=columns)

    def do(self):
        """Run to the end, or write the last accepted state and raise an error.

        The error is a `pgran.options.SolutionError`, or `pgran.options.Interrupted` on a signal.
        """
        from .options import Interrupted, ParameterError, SolutionError

        driver, now = self.driver, lambda: self.case.label(self.driver.state.time)
        try:
            self.terminal.opening(self.form, driver.ts)
            if self.case.why_at_rest:
                self.terminal.say(f"  {self.case.why_at_rest}")
            if self.source:
                self.terminal.say(f"  resumed at {now()}")
            try:
                driver.solve()
            except (SolutionError, Interrupted) as error:
                if not all_ranks_arrive(self.control_comm):
                    error.one_rank_only = True
                    raise
                self.stop(isinstance(error, Interrupted))
                if isinstance(error, SolutionError):
                    raise
                cure = ("there is nothing to resume from: start it again"
                        if self.steady and not driver.started else
                        f"resume with: <same command> @restart {self.writer.path}")
                raise Interrupted(f"stopped by {error} at {now()}; {cure}") from None
            if not driver.started and driver.state.time > (1.0 + 1e-9) * self.case.targets[-1]:
                raise ParameterError(
                    "restart", self.parameters.restart, f"its checkpoint, at {now()}, is later "
                    f"than the requested end of the run, {self.case.label(self.case.targets[-1])}")
            self.finish()
        finally:
            self.writer.close()

    def free(self):
        """Free the objects of PETSc and MPI."""
        self.driver.destroy()
        self.control_comm.Free()

    def begin(self, tried=True):
        """Create the result file; ``tried`` means that a step has used the options of PETSc."""
        if self.writer.run:
            return
        if tried:
            report_unused(self.form.grid.comm)
        self.writer.begin(self.source, solver_options=solver_options(),
                          begun=time.time() - self.seconds())
        if self.writer.kept:
            self.terminal.say(f"  the existing {self.writer.path} is kept as {self.writer.kept}")

    def observe(self, driver, landed, report):
        """Write and report an accepted step."""
        from petsc4py import PETSc

        from .output import live

        with PETSc.Log.Stage("Output"):
            self.begin()
            self.writer.record(**report)
            if self.steady:
                residual, done = driver.steady_residual(), 0.0
                text = f"residual {residual:.2e}"
            else:
                now, end = driver.state.time, self.case.targets[-1]
                done = self.case.progress(now) / self.case.progress(end)
                text = f"{self.case.label(now):>20}"
            self.terminal.step(driver.ts.getStepNumber(), done, text, report)
            if landed:
                self.landed += 1
                self.writer.snapshot(driver.state.time, driver.fields())
            if not self.steady and self.due():
                self.checkpoint()
            every = self.parameters.picture_every
            if every and driver.ts.getStepNumber() % every == 0:
                live.picture(self.writer, driver)

    def due(self):
        """Return whether it is time for a checkpoint. Rank 0 decides."""
        then, step = self.last_checkpoint
        if self.source and not step:
            return True  # the result file may have another name than the source
        if every := self.parameters.checkpoint_steps:
            return self.writer.steps - step >= every
        return self.comm.bcast(
            time.monotonic() - then >= 60.0 * self.parameters.checkpoint_minutes)

    def checkpoint(self, repeat=True):
        """Write the history and a checkpoint; `Driver.values` describes ``repeat``."""
        from .output import checkpoint

        writer, driver = self.writer, self.driver
        writer.flush()
        # The snapshot written on a stop is extra and is not counted.
        values = {**driver.values(repeat), "history": writer.steps, "snapshots": self.landed,
                  "seconds": self.seconds()}
        checkpoint.write(writer.path, self.form.grid, writer.run, writer.steps, values,
                         driver.state.arrays(self.form.grid))
        self.last_checkpoint = time.monotonic(), writer.steps

    def seconds(self):
        """Return the run time, s, including the time before a restart."""
        return float(self.checkpoint_values.get("seconds", 0.0)) + time.monotonic() - self.began

    def stop(self, interrupted):
        """Write the last accepted state of a run that failed or was interrupted, and its status."""
        from .output.writer import FAILED, STOPPED

        last = self.steady or not interrupted
        if last and not self.driver.started:
            return  # otherwise there is a checkpoint of the start
        self.store(last, repeat=interrupted)
        self.writer.flush(state=STOPPED if interrupted else FAILED)

    def store(self, snapshot, repeat=True):
        """Write a checkpoint and, if requested, a ``snapshot`` of the last accepted step."""
        self.begin(tried=self.driver.started)
        if snapshot and self.driver.started:
            self.writer.snapshot(self.driver.state.time, self.driver.fields())
        if not self.steady:
            self.checkpoint(repeat)

    def finish(self):
        """Write the last data of a run, and report its end."""
        from .output.writer import COMPLETE, STOPPED

        driver, terminal = self.driver, self.terminal
        complete = driver.controller.finished
        self.begin()
        self.store(self.steady or not complete)
        memory = self.comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
        cost = {**driver.cost(), "seconds": self.seconds(), "memory": memory / 1024,
                "ranks": self.comm.size}
        if self.steady:
            cost["steady_residual"] = driver.steady_residual()
        self.writer.flush(complete=complete, state=COMPLETE if complete else STOPPED, **cost)
        now = self.case.label(driver.state.time)
        if self.steady:
            terminal.say("  steady: residual of the rigid-viscous equations (2.9)-(2.11) "
                         f"{cost['steady_residual']:.2e} {self.case.stress_unit} d")
        elif driver.at_rest:
            terminal.say(f"  at rest at {now}")
        elif not complete:
            terminal.say(f"  stopped by PETSc's options at {now} of "
                         f"{self.case.label(self.case.targets[-1])}")
        fixed = self.steady or not self.case.moving
        terminal.closing(self.writer, cost,
                         "pgran.eigen -pgran_restart" if fixed else "pgran.measure")


if __name__ == "__main__":
    sys.exit(main(sys.argv))
