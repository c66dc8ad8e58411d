"""Run a case: mpiexec -n 2 python -m pgran -options_file options/biaxial.opts

Solves dense granular flow with the local inertial or the non-local granular
fluidity rheology, equations (2.2)-(2.9), on a structured Q2-Q1 grid. With
-ts_type beuler the mesh follows the deformation; with -ts_type pseudo it is
frozen and the steady rigid-viscous flow is found. A good run ends with the name
of its result file; a failed one with the reason, and exit code 1.
"""

import os
import resource
import sys
import time
import traceback

import petsc4py

HELP = ("-help", "--help", "-h")


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    return command(arguments, run, __doc__)


def command(arguments, action, description, slepc=False):
    """Do ``action(settings, comm)``, or print the ``description`` and all options for -help.

    Returns the exit code, as `start` does. Collective.
    """
    if any(argument in HELP for argument in arguments):
        from . import options

        text = (f"{description}\nOptions, as <default> [unit]; PETSc's own (-ts_, -snes_, -ksp_, "
                f"-pc_, -log_view, ...) hold too:\n\n{options.help_text()}")
        return start(arguments, lambda settings, comm: comm.rank or print(text, flush=True), slepc)
    return start(arguments, action, slepc)


def start(arguments, action, slepc=False):
    """Start PETSc, do ``action(settings, comm)`` and return the exit code. Collective.

    An `OptionError` or a `StepError`, which all ranks raise together, becomes one
    message of rank 0. Anything else may have struck one rank alone: it ends them all.
    """
    given = file_first([argument for argument in arguments if argument not in HELP])
    missing = [name for flag, name in zip(given, given[1:])
               if flag == "-options_file" and not os.path.isfile(name)]
    if missing:
        given = given[:1]  # so that PETSc starts, and all ranks can end together
    if slepc:
        import slepc4py
        slepc4py.init(given)
    else:
        petsc4py.init(given)
    from petsc4py import PETSc

    comm = PETSc.COMM_WORLD
    if comm.size > 1:  # Debian's h5py has MPI where mpiexec left its traces, which srun does not
        os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
    from . import options
    from .evolve import StepError

    try:
        if missing:
            raise options.OptionError(f"-options_file {missing[0]}: there is no such file")
        action(options.read(given_options()), comm)
        return 0
    except (options.OptionError, StepError) as error:
        if comm.rank == 0:
            print(f"pgran: error: {error}", file=sys.stderr, flush=True)
        return 1
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        if comm.size > 1:
            comm.tompi4py().Abort(1)
        return 1


def file_first(arguments):
    """Return ``arguments`` with -options_file at the front, so that the command line wins over it.

    PETSc reads its arguments in order, and a file where it stands.
    """
    program, *rest = arguments
    files = []
    while "-options_file" in rest[:-1]:
        place = rest.index("-options_file")
        files += rest[place:place + 2]
        del rest[place:place + 2]
    return [program, *files, *rest]


def given_options():
    """Return pgran's options that PETSc was given, {name: text}, and count them as used."""
    from petsc4py import PETSc

    from .options import PREFIX

    database = PETSc.Options()
    # getAll splits values at blanks; getString gives them whole.
    return {name: database.getString(name, "") for name in database.getAll()
            if name.startswith(PREFIX)}


def run(settings, comm):
    """Solve the case of ``settings`` and write its results. Collective.

    Raises `OptionError` before anything is computed, and `StepError` where the
    solution stops, after writing the last state that was reached.
    """
    from petsc4py import PETSc

    from . import evolve, results, weakform
    from .options import OptionError
    from .terminal import Terminal

    begin = time.monotonic()
    form = weakform.discretise(settings, comm)
    case, frozen = form.case, evolve.frozen()
    if settings.restart and not frozen:
        raise OptionError(f"-pgran_restart {settings.restart}: allowed with -ts_type pseudo alone")
    if settings.inertia and frozen:
        raise OptionError("-pgran_inertia true: steady flow is quasi-static; allowed with "
                          "-ts_type pseudo is false")
    if frozen:
        state = evolve.steady_start(form)
    else:
        state = evolve.homogeneous(form) if settings.seed else evolve.rest(form)
    targets = [] if frozen else [case.time_at(c) for c in settings.snapshots]
    terminal = Terminal(comm, settings.progress)

    def observe(evolution, report):
        with PETSc.Log.Stage("Output"):
            show(evolution, report)

    def show(evolution, report):
        state = evolution.state
        compression = case.compression(state.time)
        writer.record(time=state.time, compression=compression,
                      top_stress=evolution.plate_stress(), **report)
        if frozen:
            residual, done = evolution.steady_residual(), 0.0
            text = f"residual {residual:.2e}"
        else:
            done = compression / settings.compression
            text = f"{100 * compression:6.3f} of {100 * settings.compression:g} %"
        terminal.step(evolution.ts.getStepNumber(), done, text, report)
        if report["landed"]:
            write_fields()

    def write_fields():
        time = evolution.state.time
        writer.snapshot(time, case.compression(time), evolution.fields())

    evolution = evolve.Evolution(form, settings, state, targets, observe)
    writer = results.Writer(settings.output, form.grid, settings)
    terminal.opening(settings, form, evolution.ts)
    if writer.kept:
        terminal.say(f"  an earlier {writer.path} is kept as {writer.kept}")
    try:
        evolution.solve()
    except evolve.StepError:
        if evolution.started:
            write_fields()
        raise
    complete = not evolution.targets
    if frozen or not complete:
        write_fields()
    memory = comm.tompi4py().allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
    cost = {**evolution.cost(), "seconds": time.monotonic() - begin, "memory": memory,
            "ranks": comm.size}
    writer.flush(complete=complete, **cost)
    if frozen:
        residual = evolution.steady_residual()
        writer.flush(steady_residual=residual)
        terminal.say(f"  steady: the rigid-viscous equations (2.9)-(2.11) hold to a residual of "
                     f"{residual:.2e} |sigma_1| d")
    elif not complete:
        reached = 100 * case.compression(evolution.state.time)
        terminal.say(f"  stopped by PETSc's options at {reached:.4g} % of "
                     f"{100 * settings.compression:g} %")
    terminal.closing(writer, cost)


if __name__ == "__main__":
    sys.exit(main(sys.argv))
