"""A run in the calling process, on all its ranks: `pgran.run` without ``ranks``."""

import gc
import signal
import threading
from contextlib import contextmanager

import petsc4py

from .. import cases
from ..cli import (
    check_names,
    combined_options,
    database,
    decimal_points,
    end_unless_shared,
    given_texts,
    petsc_message,
    refuse_at_start,
)
from ..options import Interrupted, OptionError, SolutionError
from ..output.result import Result
from ..signals import SIGNALS, Signals
from ..versions import FIRST, callback_error
from . import run_on_ranks

#: PETSc has one database of options per process, and solves in one thread at a time.
LOCK = threading.RLock()


@contextmanager
def signals():
    """Yield a function that returns the name of a received signal, or None."""
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None  # only the main thread can handle signals
        return
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield Signals()
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def run(path, options_file, *options):
    """Run pgran in this process unless the run is complete; return the `Result`. Collective.

    All ranks of the process take part. Runs of several threads wait for each other. PETSc's options
    of the process are restored afterwards. The parameters are described at
    `pgran.runs.run_on_ranks.done`.

    Raises
    ------
    OptionError, ParameterError
        If options are inconsistent, or if a thread other than the main one starts a run on several
        ranks, where threads could wait for each other for ever.
    SolutionError
        If the solution or PETSc fails.
    Interrupted
        If a signal stops the run. The same call resumes it.
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
                with decimal_points(), database(texts), signals() as stop_request:
                    _solve(stop_request, control_comm)
            finally:
                control_comm.Free()
                gc.collect()
                PETSc.garbage_cleanup()
        return Result(path)


def _solve(stop_request, control_comm):
    """Run the simulation that PETSc's options describe; an error on some ranks ends all."""
    from petsc4py import PETSc

    from ..__main__ import complete, prepared

    work = None
    try:
        parameters = cases.read(complete(given_texts()))
        check_names(PETSc.Options().getAll(), (), parameters.options)
        work = prepared(parameters, PETSc.COMM_WORLD, stop_request)
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
