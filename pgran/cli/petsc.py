"""Start of MPI and PETSc for commands on ranks, and PETSc's options."""

import difflib
import importlib
import locale
import os
import signal
import sys
from contextlib import contextmanager, nullcontext

from .. import __version__, cases
from ..options import PREFIX, OptionError, default_solver
from ..options.files import all_sources
from ..signals import preserved
from ..versions import FIRST
from .commands import ALL, HELP, VERSION, help_wanted, run_help, values_of
from .report import report_error
from .streams import guard_streams

#: Beginnings of options that PETSc reads only when it starts.
AT_START = ("log_", "malloc", "memory_view", "objects_dump", "citations", "on_error",
            "options_view", "options_monitor")


def start(arguments, action, description="", options=(), slepc=False,
          complete=lambda texts: texts):
    """Start PETSc, call ``action(parameters, args, comm)`` and return the exit code. Collective.

    An error that all ranks raise is reported once; an error on some ranks ends all of them.

    ``arguments`` begin with the name of the program, and ``args`` has the values of the command's
    ``options``. ``complete(texts)`` returns all options of a run, {name: text}, from given ones.
    """
    guard_streams()
    module = sys.modules.get("petsc4py.PETSc")
    running = module is not None and module.Sys.isInitialized()
    wanted, all_options = help_wanted(arguments)
    words = [word for word, previous in zip(arguments[1:], arguments)
             if word not in (*HELP, *VERSION) and not (word == ALL and previous in HELP)]
    found, invalid = {}, None
    try:
        found = all_sources(words)
        if running:
            refuse_at_start(found)
    except OptionError as error:  # reported below, when all ranks can end together
        invalid = error
    os.environ.pop("PETSC_OPTIONS", None)  # `found` contains them
    words = (word for name, text in found.items() for word in (f"-{name}", text) if word)
    with preserved():
        package = importlib.import_module("slepc4py" if slepc else "petsc4py")
        package.init(["pgran", *FIRST, "-skip_petscrc", *words])
    from petsc4py import PETSc

    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # `guard_streams` handles the error
    comm = PETSc.COMM_WORLD
    control_comm = comm.tompi4py().Dup()  # without messages of the action
    with decimal_points(), database(found) if running else nullcontext():
        try:
            if invalid:
                raise invalid
            if set(VERSION) & set(arguments):
                if comm.rank == 0:
                    print(f"pgran {__version__}", flush=True)
                return 0
            texts = given_texts(options)
            if wanted or not arguments[1:]:
                kinds = [f"{PREFIX}{kind.name}" for kind in cases.KINDS]
                chosen = {name: text for name, text in texts.items() if name in kinds}
                run_options = cases.read(chosen).options if all_options or texts else ()
                if comm.rank == 0:
                    print(run_help(description, options, run_options), flush=True)
                return int(not wanted)
            parameters = cases.read(complete(texts))
            check_names(PETSc.Options().getAll(), options, parameters.options)
            action(parameters, values_of(options, texts), comm)
            return int(bool(options) and sys.stdout.failed)  # a run has its result file
        except BaseException as error:
            return report_error(error, comm, control_comm)


@contextmanager
def database(texts):
    """Replace all options of PETSc by {name: text} within the context."""
    from petsc4py import PETSc

    present = PETSc.Options()

    def replace(wanted):
        for name in present.getAll():
            present.delValue(name)
        for name, text in wanted.items():
            present.setValue(name, text)

    previous = _texts(present.getAll())
    replace(texts)
    try:
        yield
    finally:
        replace(previous)


def _texts(names):
    """Return {name: text} of PETSc's options, which then count as used."""
    from petsc4py import PETSc

    database = PETSc.Options()  # getAll splits values at blanks
    return {name: database.getString(name, "") for name in names}


@contextmanager
def decimal_points():
    """Read and write numbers with a decimal point; PETSc uses the locale of the process."""
    previous = locale.setlocale(locale.LC_NUMERIC)
    locale.setlocale(locale.LC_NUMERIC, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_NUMERIC, previous)


def refuse_at_start(texts):
    """Raise `OptionError` if {name: text} has an option that PETSc reads only when it starts."""
    for name in texts:
        if name.startswith(AT_START):
            raise OptionError(f"-{name}: PETSc reads this option only when it starts, and it "
                              "already runs in this process; use a separate process")


def given_texts(options=()):
    """Return {name: text} of a run and of a command; PETSc then counts them as used."""
    from petsc4py import PETSc

    names = {option.name for option in options}
    return _texts(name for name in PETSc.Options().getAll()
                  if name.startswith(PREFIX) or name in names)


def check_names(texts, options, run_options):
    """Raise `OptionError` for a misspelt option of pgran in {name: text}, and for a value nan."""
    names = {option.name for option in options} | {"options_file", "help", "version", "doctor"}
    run_names = {f"{PREFIX}{option.name}" for option in run_options}
    for name, value in texts.items():
        if name in names or name.startswith(PREFIX):
            continue
        if (value or "").lower() == "nan":
            raise OptionError(f"-{name} {value}: must be a number")
        near = difflib.get_close_matches(name.replace("-", "_"), names | run_names, cutoff=0.85)
        if near or PREFIX + name in run_names:
            raise OptionError(f"unknown option -{name}; did you mean "
                              f"-{near[0] if near else PREFIX + name}?")


def steady():
    """Return whether ``-ts_type`` is pseudo-time. Raises `OptionError` for other types."""
    from petsc4py import PETSc

    kind = PETSc.Options().getString("ts_type", PETSc.TS.Type.BEULER)
    if kind not in (PETSc.TS.Type.BEULER, PETSc.TS.Type.PSEUDO):
        raise OptionError(f"-ts_type {kind}: expected one of: beuler | pseudo")
    return kind == PETSc.TS.Type.PSEUDO


def choose_solver(texts):
    """Pass the `default_solver` of a run to PETSc; return its path and the completed options."""
    from petsc4py import PETSc

    database = PETSc.Options()
    path, solver = default_solver({**database.getAll(), **texts})
    for name, text in solver.items():
        if not name.startswith(PREFIX):
            database.setValue(name, text)
    return path, {**texts, **{n: text for n, text in solver.items() if n.startswith(PREFIX)}}


def solver_options():
    """Return all options of PETSc as the lines of an options file."""
    from petsc4py import PETSc

    names = (name for name in sorted(PETSc.Options().getAll())
             if not name.startswith((PREFIX, "options_", "skip_petscrc")))
    return "".join(f"-{name} {text}".rstrip() + "\n" for name, text in _texts(names).items())
