"""A run in the calling process, on all its ranks: `pgran.run` without ``ranks``."""

import gc
import threading

import petsc4py

from .. import cases
from ..cli.petsc import check_names, database, decimal_points, given_texts, refuse_at_start
from ..cli.report import end_unless_shared, petsc_message
from ..options import Interrupted, OptionError, SolutionError, combined_options
from ..output.result import Result
from ..signals import Signals, preserved
from ..versions import FIRST, callback_error
from . import run_on_ranks

#: PETSc has one database of options per process, and solves in one thread at a time.
LOCK = threading.RLock()


def run(path, options_file, *options):
    """Run pgran in this process unless the run is complete; return the `Result`. Collective.

    Runs of several threads wait for each other; on several ranks only the main thread can run.
    """
    petsc4py.init(["pgran", *FIRST])
    from petsc4py import PETSc

    world = PETSc.COMM_WORLD.tompi4py()
    if world.size > 1 and threading.current_thread() is not threading.main_thread():
        raise OptionError(f"{threading.current_thread().name}: a run on {world.size} ranks of this "
                          "process must be started by the main thread")
    with LOCK:
        words = world.bcast(run_on_ranks.pending(path, options_file, *options))
        if words is not None:
            texts = combined_options(options_file, *words)
            refuse_at_start(texts)
            control_comm = world.Dup()  # as in `pgran.cli.start`
            try:
                with decimal_points(), database(texts), preserved() as can_set:
                    _solve(Signals() if can_set else lambda: None, control_comm)
            finally:
                control_comm.Free()
                gc.collect()
                PETSc.garbage_cleanup()
        return Result(path)


def _solve(stop_request, control_comm):
    """Run the simulation that PETSc's options describe; an error on some ranks ends all."""
    from petsc4py import PETSc

    from ..__main__ import Run, complete

    work = None
    try:
        parameters = cases.read(complete(given_texts()))
        check_names(PETSc.Options().getAll(), (), parameters.options)
        work = Run(parameters, PETSc.COMM_WORLD, stop_request)
        work.do()
    except BaseException as error:
        cause = callback_error(error)
        if isinstance(cause, PETSc.Error):
            cause = SolutionError(petsc_message(cause))
        end_unless_shared(cause, control_comm, f"pgran: error: {cause}")
        if isinstance(cause, (SolutionError, Interrupted)):
            cause = type(cause)(str(cause).replace("@", ""))  # parameters have no prefix in Python
        raise cause from None
    finally:
        if work:
            work.free()  # collective: an error on some ranks has ended all
