"""A run in the process that asks for it, on all its ranks: `pgran.run` without ``ranks``."""

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
    petsc_words,
    refuse_at_start,
    strict,
)
from ..options import Interrupted, OptionError, SolutionError
from ..output.result import Result
from ..signals import SIGNALS, Signals
from ..versions import FIRST, callback_error
from . import run_on_ranks

#: PETSc has one database of options for a process, and solves in one thread at a time.
LOCK = threading.RLock()


@contextmanager
def signals():
    """Give what says whether a signal asks the run to stop, as `pgran.__main__.run` takes it."""
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None  # only the main thread may have signals
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield Signals()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run(path, options_file, *options):
    """Run pgran to ``path`` in this process unless that is done; return its `Result`. Collective.

    All ranks of the process take part. PETSc's options of the process are set aside meanwhile. Runs
    of several threads wait for each other. The parameters are those of
    `pgran.runs.run_on_ranks.done`.

    Raises
    ------
    OptionError, ParameterError
        If the options do not fit together, or if a thread other than the main one starts a run on
        several ranks, where threads could wait for each other for ever.
    SolutionError
        If the solution stops, or PETSc does.
    Interrupted
        If a signal stops it; the same call goes on.
    """
    petsc4py.init(["pgran", *FIRST])
    from petsc4py import PETSc

    world = PETSc.COMM_WORLD.tompi4py()
    if world.size > 1 and threading.current_thread() is not threading.main_thread():
        raise OptionError(f"{threading.current_thread().name}: a run on {world.size} ranks of this "
                          "process is allowed in the main thread only")
    with LOCK:
        words = world.bcast(run_on_ranks.pending(path, options_file, *options))
        if words is not None:
            texts = combined_options(options_file, *words)
            refuse_at_start(texts)
            apart = world.Dup()  # as in `pgran.cli.start`
            try:
                with decimal_points(), database(texts), signals() as asked:
                    _solve(asked, apart)
            finally:
                apart.Free()
                gc.collect()
                PETSc.garbage_cleanup()
        return Result(path)


def _solve(asked, apart):
    """Run what PETSc's options say; an error that not all ranks share ends them."""
    from petsc4py import PETSc

    from ..__main__ import complete, prepared

    work = None
    try:
        texts = given_texts()
        parameters = cases.read(complete(texts))
        check_names(PETSc.Options().getAll(), (), parameters.options)
        with strict(texts):
            work = prepared(parameters, PETSc.COMM_WORLD, asked)
            work.do()
    except BaseException as error:
        cause = callback_error(error)
        if isinstance(cause, PETSc.Error):
            cause = SolutionError(petsc_words(cause))
        end_unless_shared(cause, apart, f"pgran: error: {cause}")
        if isinstance(cause, (SolutionError, Interrupted)):
            cause = type(cause)(str(cause).replace("@", ""))  # by the names that Python has
        raise cause from None
    finally:
        if work:
            work.free()  # all ranks come here, as others have ended
