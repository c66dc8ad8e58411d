"""What starts every command: PETSc, options, help, and errors that all ranks share.

A command that runs on ranks passes its work to `start`; one that needs numpy only passes it to
`answer`. Only this module and `pgran.options` know what an option is called.
"""

import os
import sys
import traceback
from types import SimpleNamespace

from . import cases, options
from .options import Option, OptionError, ParameterError, SolutionError

HELP = ("-help", "--help", "-h")
#: Errors that are told in one message; all ranks raise them together.
TOLD = OptionError, ParameterError, SolutionError
#: The flag that asks for JSON, which most commands have.
JSON = Option("json", "flag", False, "", "print one JSON object instead of text", prefix="")


def own(name, kind, meaning, default=None, **more):
    """Return the row of an option that one command has; its name carries no prefix."""
    return Option(name, kind, default, more.pop("unit", ""), meaning, prefix="", **more)


def start(arguments, action, description="", rows=(), slepc=False):
    """Start PETSc, do ``action(parameters, own, comm)`` and return the exit code. Collective.

    An error of `TOLD`, which all ranks raise together, becomes one message of rank 0. Anything
    else may have struck only one rank: it ends them all.

    Parameters
    ----------
    arguments : list of str
        The command line, with the program's name first.
    action : callable
        What to do with the resolved `pgran.options.Parameters`, a namespace of the command's own
        options, and the communicator of PETSc.
    description : str
        What ``-help`` prints above the options.
    rows : tuple of pgran.options.Option
        The command's own options.
    slepc : bool
        Whether to start SLEPc too.
    """
    wants_help = any(argument in HELP for argument in arguments)
    given = file_first([argument for argument in arguments if argument not in HELP])
    missing = [name for flag, name in zip(given, given[1:])
               if flag == "-options_file" and not os.path.isfile(name)]
    if missing:
        given = given[:1]  # so that PETSc starts, and all ranks can end together
    if slepc:
        import slepc4py
        slepc4py.init(given)
    else:
        import petsc4py
        petsc4py.init(given)
    from petsc4py import PETSc

    comm = PETSc.COMM_WORLD
    if comm.size > 1:  # Debian's h5py has MPI where mpiexec left its traces, which srun does not
        os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
    try:
        if missing:
            raise OptionError(f"-options_file {missing[0]}: there is no such file")
        database = PETSc.Options()
        # getAll splits values at blanks; getString gives them whole, and counts them as used.
        texts = {name: database.getString(name, "") for name in database.getAll()
                 if name.startswith(options.PREFIX) or name in {row.name for row in rows}}
        parameters = cases.read(texts)
        own_values = _own(texts, rows, database.getAll())
        if wants_help:
            if comm.rank == 0:
                print(help_text(description, rows, parameters.rows), flush=True)
        else:
            action(parameters, own_values, comm)
        return 0
    except TOLD as error:
        if comm.rank == 0:
            print(f"pgran: error: {error.as_option()}", file=sys.stderr, flush=True)
        return 1
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        if comm.size > 1:
            comm.tompi4py().Abort(1)
        return 1


def _own(texts, rows, everything):
    """Values of a command's own options, {name: value}; refuses what is nearly one of them."""
    names = {row.name for row in rows}
    for name in everything:
        if rows and name not in names and not name.startswith(options.PREFIX):
            hint = options.hint(name, names, prefix="")
            if hint.startswith("did you mean") and len(name) > 3:
                raise OptionError(f"-{name}: no such option; {hint}")
    return SimpleNamespace(**{row.name: row.parse(texts[row.name]) if row.name in texts
                              else row.default for row in rows})


def help_text(description, rows, run_rows):
    """Return the text of ``-help``."""
    mine = f"Options of this command:\n\n{options.help_text(rows)}\n\n" if rows else ""
    return (f"{description}\n{mine}Options of the run, as <default> [unit]. A case, law or model "
            "brings its own: name it beside -help to see them. PETSc's options (-ts_, -snes_, "
            f"-ksp_, -pc_, -log_view, ...) hold too.\n\n{options.help_text(run_rows)}")


def answer(arguments, name, action, description, rows, operands="", runs=False):
    """Do ``action`` with a command line that needs no PETSc, and return the exit code.

    Parameters
    ----------
    arguments : list of str
        The command line without the program's name.
    name : str
        The command, for messages.
    action : callable
        ``action(own, operands)``, or ``action(parameters, own)`` with ``runs``. It may raise an
        error of `TOLD`, ValueError or OSError, which become one message.
    rows : tuple of pgran.options.Option
        The command's own options.
    operands : str
        What the arguments without a dash are; empty where there are none.
    runs : bool
        Whether the command takes the options of a run.
    """
    try:
        if not arguments or any(argument in HELP for argument in arguments):
            more = f"\n\n{options.help_text(cases.read({}).rows)}" if runs else ""
            print(f"{description}\nOptions:\n\n{options.help_text(rows)}{more}")
            return 0 if arguments else 1
        texts, found = parse(arguments, rows, bool(operands), runs)
        values = SimpleNamespace(**{row.name: row.parse(texts[row.name]) if row.name in texts
                                    else row.default for row in rows})
        if runs:
            action(cases.read(texts), values)
            return 0
        if not found:
            raise OptionError(f"{operands} missing")
        action(values, found)
        return 0
    except TOLD as error:
        message = error.as_option()
    except (ValueError, OSError, KeyError) as error:
        message = str(error)
    print(f"pgran.{name}: error: {message}", file=sys.stderr)
    return 1


def parse(arguments, rows, operands, runs):
    """Split a command line into texts of options, {name: text}, and operands, [text].

    Raises `OptionError` where it cannot be read.
    """
    known = {row.name: row for row in rows}
    texts, found, position = {}, [], 0
    while position < len(arguments):
        argument = arguments[position]
        position += 1
        if not argument.startswith("-"):
            if not operands:
                raise OptionError(f"{argument}: no option; {options.hint(argument, known, '')}")
            found.append(argument)
            continue
        name = argument.lstrip("-")
        if name not in known and not (runs and name.startswith(options.PREFIX)):
            more = "-pgran_..., " if runs else ""
            raise OptionError(f"{argument}: no such option; allowed are {more}"
                              + ", ".join(f"-{row.name}" for row in rows))
        if name in known and known[name].kind == "flag":
            texts[name] = "true"
            continue
        if position == len(arguments):
            raise OptionError(f"{argument}: a value is missing")
        texts[name] = arguments[position]
        position += 1
    return texts, found


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


def steady():
    """Return whether ``-ts_type`` asks for pseudo-time. Raises `OptionError` for other types."""
    from petsc4py import PETSc

    kind = PETSc.Options().getString("ts_type", PETSc.TS.Type.BEULER)
    if kind not in (PETSc.TS.Type.BEULER, PETSc.TS.Type.PSEUDO):
        raise OptionError(f"-ts_type {kind}: allowed is beuler | pseudo")
    return kind == PETSc.TS.Type.PSEUDO


def solver_options():
    """Return the options of PETSc that were given, as the lines of an options file."""
    from petsc4py import PETSc

    database = PETSc.Options()
    return "".join(f"-{name} {database.getString(name, '')}".rstrip() + "\n"
                   for name in sorted(database.getAll())
                   if not name.startswith(options.PREFIX) and name != "options_file")
