"""Reports of errors that all ranks share, and of PETSc options that are not used."""

import difflib
import re
import subprocess
import sys
import time
import traceback

from ..options import Interrupted, OptionError, ParameterError, SolutionError
from ..options.files import read_file, shipped
from ..versions import callback_error, was_read

#: Errors that are reported in one message. All ranks raise them together.
REPORTED_ERRORS = OptionError, ParameterError, SolutionError
#: Exit code of a run that a signal stopped and that can be resumed (EX_TEMPFAIL of sysexits.h).
STOPPED = 75
#: Seconds until the other ranks must have raised an error too.
TOGETHER = 3.0
#: Options that PETSc reads only at the end, so that they seem to be unused before.
AT_END = ("citations", "log_view", "malloc_dump", "objects_dump", "options_left", "options_view",
          "skip_petscrc", "ts_converged_reason", "ts_view")


def exit_code(command, action, *arguments):
    """Call ``action(*arguments)``, report errors of the user in one message; return the exit code.

    Messages begin with the name of the ``command``.
    """
    try:
        action(*arguments)
        return 0
    except (Interrupted, *REPORTED_ERRORS, OverflowError, FloatingPointError) as error:
        print(f"{command}: {message_of(error)}", file=sys.stderr)
        return STOPPED if isinstance(error, Interrupted) else 1
    except (ValueError, OSError, KeyError, subprocess.SubprocessError) as error:
        message = str(error)
    except ImportError as error:
        message = f"{error}; pictures and grids need pip install 'pgran[plot]'"
    print(f"{command}: error: {message}", file=sys.stderr)
    return 1


def message_of(error):
    """Return the message of an error, or a traceback."""
    if isinstance(error, Interrupted):
        return error.as_option()
    if isinstance(error, REPORTED_ERRORS):
        return f"error: {error.as_option()}"
    if isinstance(error, (OverflowError, FloatingPointError)):
        return f"error: floating-point error ({error.args[-1]}); check the values of the options"
    if isinstance(error, MemoryError):
        return ("error: not enough memory; use larger elements, fewer elements, or more ranks on "
                f"more machines{f' ({error})' if str(error) else ''}")
    from petsc4py import PETSc

    if isinstance(error, PETSc.Error):
        return f"error: {petsc_message(error)}"
    return "".join(traceback.format_exception(error)).rstrip()


def report_error(error, comm, control_comm):
    """Report an error once; return the exit code. Ends all ranks if only some raised an error."""
    error = callback_error(error)
    text = f"pgran: {message_of(error)}"
    end_unless_shared(error, control_comm, text)
    if comm.rank == 0:
        print(text, file=sys.stderr, flush=True)
    return STOPPED if isinstance(error, Interrupted) else 1


def end_unless_shared(error, control_comm, text):
    """Print ``text`` and end all ranks unless all of them raised an error. Collective."""
    if getattr(error, "one_rank_only", False) or not all_ranks_arrive(control_comm):
        print(f"{text}\npgran: rank {control_comm.rank} failed and others did not; all are ended",
              file=sys.stderr, flush=True)
        control_comm.Abort(1)


def all_ranks_arrive(comm):
    """Return whether all ranks call this function within `TOGETHER` seconds.

    ``comm`` is an mpi4py communicator without pending messages. Otherwise the caller sets
    ``one_rank_only`` of its error, so that all ranks are ended at once.
    """
    request, end = comm.Ibarrier(), time.monotonic() + TOGETHER
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(0.001)
    return True


def petsc_message(error):
    """Return the message of an error of PETSc in one line, with the options that it mentions."""
    from petsc4py import PETSc

    lines = [re.sub(r"^\[\d+\] ?", "", line).strip() for line in str(error).splitlines()]
    lines = [line for line in lines if line and not re.search(r"\(\) (at|line) ", line)]
    text = " ".join(lines[1:] or lines)
    named = [f"-{name} {value}" for name, value in PETSc.Options().getAll().items()
             if value and (len(value) > 1 and re.search(rf"\b{re.escape(value)}\b", text)
                           or re.search(rf"\bvalue of {name.split('_')[-1]}\b", text))]
    return f"{', '.join(named)}: {text}" if named else f"PETSc: {text}"


def report_unused(comm):
    """Print a warning about PETSc options that have not been used so far."""
    from petsc4py import PETSc

    everything = {name: value or "" for name, value in PETSc.Options().getAll().items()}
    # A file with multigrid may follow one with the direct solver.
    direct = read_file(shipped("solver_lu"))
    unused = {name: value for name, value in everything.items() if name not in AT_END
              and direct.get(name) != value and not was_read(name)}
    used = [name for name in everything if name not in unused]
    texts = []
    for name, value in unused.items():
        near = difflib.get_close_matches(name, [*used, *AT_END], n=1, cutoff=0.85)
        texts.append(f"-{name} {value}".rstrip() + (f" (did you mean -{near[0]}?)" if near else ""))
    if texts and comm.rank == 0:
        print(f"pgran: warning: unused PETSc option(s): {', '.join(texts)}", file=sys.stderr,
              flush=True)
