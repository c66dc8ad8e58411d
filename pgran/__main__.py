"""Run a case: mpiexec -n 2 python -m pgran -options_file options/biaxial.opts

Solves dense granular flow with the local inertial or the non-local granular
fluidity rheology, equations (2.2)-(2.9), on a structured Q2-Q1 grid. With
-ts_type beuler the flow is followed in time; with -ts_type pseudo the mesh is
frozen and the steady rigid-viscous flow is found. A good run ends with the name
of its result file and exit code 0, a failed one with the reason and exit code 1.

A run in time writes checkpoints. SIGTERM, SIGINT, SIGUSR1 or SIGUSR2 make it write
one and stop with exit code 75; -pgran_restart NAME.h5 goes on from there.
"""

import resource
import sys
import time
from functools import partial

from .signals import Signals

ASKED = Signals() if __name__ == "__main__" else None  # before all that takes longer to import

from .cli import (  # noqa: E402
    all_ranks_arrive,
    choose_solver,
    report_unread,
    solver_options,
    start,
    steady,
)


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    if "-doctor" in arguments:  # which must work where PETSc does not
        from . import doctor

        return doctor.main()
    asked = ASKED or Signals()
    return start(arguments, lambda parameters, own, comm: run(parameters, comm, asked), __doc__,
                 complete=partial(complete, words=arguments))


def complete(texts, words=()):
    """Add the options of the run that a restart in time goes on from, {name: text}.

    ``words`` is the command line. A restart that it names goes on in the file that it starts from,
    unless the command line names another one; the output of an options file does not hold then.
    """
    if not texts.get("pgran_restart") or steady():
        return texts
    if "-pgran_restart" in words and "-pgran_output" not in words:
        texts = {name: text for name, text in texts.items() if name != "pgran_output"}
    from .options import ParameterError
    from .output.reader import continued

    if number := texts.get("pgran_restart_snapshot"):
        raise ParameterError("restart_snapshot", number, "allowed only with @@ts_type pseudo; a "
                             "run in time goes on from its newest checkpoint")

    return continued(texts)


def run(parameters, comm, asked):
    """Solve the case of the parameters and write its results. Collective.

    ``asked()`` says on each rank whether the run shall stop, as a text, or None.

    Raises
    ------
    OptionError, ParameterError
        Before anything is written, if the options do not fit together.
    SolutionError
        If the solution stops; the last state that was reached is written first.
    Interrupted
        If a signal stops it; a checkpoint is written first.
    """
    prepared(parameters, comm, asked).do()


def prepared(parameters, comm, asked):
    """Return the `Run` of the parameters, which has not begun; see `run`. Collective."""
    from .options import ParameterError
    from .space.weakform import discretise

    if parameters.inertia and steady() and parameters.part("case").moving:
        raise ParameterError("inertia", "true", "steady flow on a mesh that moves is quasi-static; "
                             "allowed with -ts_type pseudo is false")
    return Run(discretise(parameters, comm), steady(), asked)


class Run:
    """One run: its driver, its result file, its checkpoints and what it says. Collective."""

    def __init__(self, form, is_steady, asked):
        from .output.terminal import Terminal
        from .output.writer import BALANCE, HISTORY, Source, Writer
        from .solve import state
        from .solve.driver import Driver

        self.began, self.form, self.case = time.monotonic(), form, form.case
        self.apart = form.grid.comm.tompi4py().Dup()
        self.comm, self.parameters = form.grid.comm.tompi4py(), form.case.parameters
        self.steady, self.last_checkpoint = is_steady, (time.monotonic(), 0)
        self.terminal = Terminal(form.grid.comm, self.parameters.progress)
        self.source, behind = None, None
        if is_steady:
            first = state.steady_start(form)
        elif self.parameters.restart:
            first, behind, damaged = state.checkpoint_start(form)
            self.source = Source(self.parameters.restart, behind["run"], behind["history"],
                                 behind["snapshots"])
            for text in damaged:
                self.terminal.say(f"  passed over a damaged checkpoint, {text}")
        elif self.parameters.mode_file:
            first = state.seeded(form)
        else:
            first = state.rest(form)
        self.behind = behind or {}
        self.landed = self.source.snapshots if self.source else 0
        self.added = choose_solver()
        self.driver = Driver(form, first, self.observe, is_steady, checkpoint=behind,
                             stop_requested=asked)
        if "pc_type" in self.added:
            self.terminal.say("pgran: no -pc_type is given; MUMPS solves every linear system, as "
                              "with options/direct.opts")
        columns = tuple(name for name in HISTORY if not is_steady or name not in BALANCE)
        self.writer = Writer(self.parameters.output, form, columns=columns)

    def do(self):
        """Run to the end; see `run` for what is raised."""
        from .options import Interrupted, ParameterError, SolutionError

        driver = self.driver
        try:
            self.terminal.opening(self.form, driver.ts)
            if self.case.why_at_rest:
                self.terminal.say(f"  {self.case.why_at_rest}")
            if self.source:
                self.terminal.say(f"  goes on from {self.case.label(driver.state.time)}")
            try:
                driver.solve()
            except (SolutionError, Interrupted) as error:
                if not all_ranks_arrive(self.apart):
                    error.alone = True
                    raise
                self.stop(isinstance(error, Interrupted))
                if not isinstance(error, Interrupted):
                    raise
                raise Interrupted(f"stopped by {error} at {self.case.label(driver.state.time)}; "
                                  + self.further()) from None
            if not driver.started and driver.state.time > (1.0 + 1e-9) * self.case.targets[-1]:
                raise ParameterError(
                    "restart", self.parameters.restart, "its checkpoint, at "
                    f"{self.case.label(driver.state.time)}, lies beyond the end of this run, "
                    f"{self.case.label(self.case.targets[-1])}")
            self.finish()
        finally:
            self.writer.close()

    def free(self):
        """Free what the run holds in PETSc and MPI; nothing can be asked of it afterwards."""
        self.driver.destroy()
        self.apart.Free()

    def begin(self, tried=True):
        """Make the result file.

        ``tried`` says that a step was, so that whoever reads options has read them.
        """
        if not self.writer.begun:
            if tried:
                report_unread(self.form.grid.comm)
            self.writer.begin(self.source, solver_options=solver_options(self.added),
                              begun=time.time() - self.seconds())
            if self.writer.kept:
                self.terminal.say(f"  an earlier {self.writer.path} is kept as {self.writer.kept}")

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

    # Checkpoints

    def due(self):
        """Return whether it is time for a checkpoint, which rank 0 decides."""
        then, step = self.last_checkpoint
        if self.source and not step:
            return True  # so that a file of another name has one at once
        every = self.parameters.checkpoint_steps
        if every:
            return self.writer.steps - step >= every
        return self.comm.bcast(
            time.monotonic() - then >= 60.0 * self.parameters.checkpoint_minutes)

    def checkpoint(self, repeat=True):
        """Write the history, and a checkpoint of the last accepted state.

        ``repeat`` is that of `pgran.solve.driver.Driver.values`.
        """
        from .output import checkpoint

        writer, driver = self.writer, self.driver
        writer.flush()
        # A snapshot of where a run was stopped is none that the whole run has: it is not counted.
        values = {**driver.values(repeat), "history": writer.steps, "snapshots": self.landed,
                  "seconds": self.seconds()}
        checkpoint.write(writer.path, self.form.grid, writer.run, writer.steps, values,
                         driver.state.arrays(self.form.grid))
        self.last_checkpoint = time.monotonic(), writer.steps

    def seconds(self):
        """Return what the run has taken so far, s, what lies before a restart included."""
        return float(self.behind.get("seconds", 0.0)) + time.monotonic() - self.began

    def further(self):
        """Return how a run that was stopped goes on, in words."""
        if not self.steady:
            return f"@restart {self.writer.path} goes on from there"
        if self.driver.started:
            return f"@restart {self.writer.path} seeks the steady flow from there"
        return "there is nothing to go on from: start it again"

    # The end

    def next_command(self):
        """Return a module that is worth starting next, with the option that takes the result."""
        if self.steady or not self.case.moving:
            return "pgran.eigen -pgran_restart"
        return "pgran.measure"

    def stop(self, interrupted):
        """Write the last accepted state of a run that fails or is interrupted, and how it ended.

        A run without an accepted step writes nothing, unless it is interrupted before its first
        time step: then it writes the checkpoint of its start.
        """
        from .output.writer import FAILED, STOPPED

        if not self.driver.started and (self.steady or not interrupted):
            return  # without an accepted step there is nothing to keep
        self.begin(tried=self.driver.started or not interrupted)
        if self.driver.started and (self.steady or not interrupted):
            self.writer.snapshot(self.driver.state.time, self.driver.fields())
        if not self.steady:
            self.checkpoint(repeat=interrupted)
        self.writer.flush(state=STOPPED if interrupted else FAILED)

    def finish(self):
        """Write what remains to be written at the end, and say so."""
        from .output.writer import COMPLETE, STOPPED

        driver, terminal = self.driver, self.terminal
        self.begin()
        whole = driver.controller.finished
        if driver.started and (self.steady or not whole):
            self.writer.snapshot(driver.state.time, driver.fields())
        if not self.steady:
            self.checkpoint()
        memory = self.comm.allreduce(
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
        cost = {**driver.cost(), "seconds": self.seconds(), "memory": memory,
                "ranks": self.comm.size}
        if self.steady:
            cost["steady_residual"] = driver.steady_residual()
        self.writer.flush(complete=whole, state=COMPLETE if whole else STOPPED, **cost)
        if self.steady:
            terminal.say("  steady: the rigid-viscous equations (2.9)-(2.11) hold to a residual of "
                         f"{cost['steady_residual']:.2e} {self.case.stress_unit} d")
        elif driver.at_rest:
            terminal.say(f"  at rest at {self.case.label(driver.state.time)}")
        elif not whole:
            terminal.say(f"  stopped by PETSc's options at {self.case.label(driver.state.time)} of "
                         f"{self.case.label(self.case.targets[-1])}")
        terminal.closing(self.writer, cost, self.next_command())


if __name__ == "__main__":
    sys.exit(main(sys.argv))
