"""What starts every command: PETSc, options, help, signals, and errors that all ranks share.

A command that runs on ranks passes its work to `start`; one that needs numpy only passes it to
`answer`. Only this module and `pgran.options` know what an option is called.
"""

import importlib
import json
import locale
import os
import re
import shlex
import signal
import sys
import time
import traceback
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from . import __version__, cases, options
from .options import Interrupted, Option, OptionError, ParameterError, SolutionError
from .signals import SIGNALS
from .versions import FIRST, callback_error, was_read

HELP = ("-help", "--help", "-h")
#: The word after -help that asks for every option.
ALL = "all"
VERSION = "-version", "--version"
#: What one needs first, and where the rest is.
FIRST_HELP = f"""Options of a run:
  -options_file FILE          options, one in a line; options/*.opts are ready ones
  -pgran_case NAME            which flow, or FILE.py:Class; there are
                              {{cases}}
  -pgran_model, -pgran_law    the rheology: {{models}}; {{laws}}
  -pgran_output NAME.h5       where the result goes
  -pgran_restart NAME.h5      go on from the last checkpoint of a run

-help {ALL} shows every option, -help -pgran_case NAME those of a case (or law, or model) too, and
docs/options.md explains them. -doctor checks this installation, and -version prints the version.
PETSc's options (-ts_, -snes_, -ksp_, -pc_, -log_view, ...) hold too."""
#: Errors that are told in one message; all ranks raise them together.
REPORTED_ERRORS = OptionError, ParameterError, SolutionError
#: Exit code of a run that was asked to stop and can go on (EX_TEMPFAIL of sysexits.h).
STOPPED = 75
#: Seconds that the other ranks have to raise an error too, before it is taken for one rank's own.
TOGETHER = 3.0
#: The flag that asks for JSON, which most commands have.
JSON = Option("json", "flag", False, "", "print one JSON object instead of text", prefix="")
#: What the names of PETSc's and SLEPc's options begin with.
HEADS = ("ts", "snes", "ksp", "pc", "mat", "vec", "dm", "da", "is", "fieldsplit", "mg", "sub", "st",
         "eps", "bv", "ds", "rg", "step", "log", "malloc", "options", "info", "on", "fp", "start",
         "stop", "debug", "memory", "objects", "check", "error", "get", "version", "citations",
         "viewer", "draw", "display", "npc", "inner", "telescope", "redundant", "use", "device",
         "coarse", "cuda", "hip", "kokkos", "saws", "petsc", "skip", "python", "mpi", "not", "help",
         "esteig")
#: What a run is solved with unless its options choose: options/direct.opts ...
DIRECT = {"ts_adapt_scale_solve_failed": "0.25", "snes_linesearch_type": "basic",
          "snes_rtol": "1e-8", "snes_atol": "1e-8", "snes_stol": "0", "snes_max_it": "12",
          "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps",
          "mat_mumps_icntl_14": "100"}
#: ... and for pseudo-time what options/steady.opts says besides.
PSEUDO = {"snes_type": "newtonls", "ts_pseudo_increment": "2", "ts_pseudo_fatol": "1e-8",
          "ts_pseudo_frtol": "1e-50", "ts_max_steps": "200"}
#: Options that PETSc reads before or after a run, so that nothing tells whether it knows them.
OUTSIDE = ("options_file", "options_left", "options_view", "options_monitor", "skip_petscrc",
           "log_view", "log_view_memory", "log_all", "log_trace", "log_sync", "log_summary",
           "log_exclude", "log_include", "log_nest", "log_perfstubs", "malloc", "malloc_debug",
           "malloc_dump", "malloc_view", "malloc_view_threshold", "malloc_test", "memory_view",
           "objects_dump", "citations", "on_error_abort", "on_error_attach_debugger",
           "on_error_mpiabort", "not_shared_tmp", "shared_tmp", "ts_view", "ts_converged_reason")
#: Those that PETSc reads only when it starts or ends.
AT_START = tuple(name for name in OUTSIDE if name not in (
    "options_file", "options_left", "skip_petscrc", "ts_view", "ts_converged_reason"))
#: Options of PETSc that a misspelt one may have meant.
COMMON = ("ts_type", "ts_max_steps", "ts_monitor", "ts_adapt_scale_solve_failed",
          "ts_pseudo_increment", "ts_pseudo_fatol", "ts_pseudo_frtol", "snes_type", "snes_rtol",
          "snes_atol", "snes_stol", "snes_max_it", "snes_monitor", "snes_converged_reason",
          "snes_view", "snes_linesearch_type", "snes_lag_preconditioner", "snes_lag_jacobian",
          "ksp_type", "ksp_rtol", "ksp_atol", "ksp_max_it", "ksp_monitor", "ksp_converged_reason",
          "ksp_view", "pc_type", "pc_mg_levels", "pc_fieldsplit_type", "mat_type",
          "pc_factor_mat_solver_type", "mat_mumps_icntl_14", "eps_nev", "eps_ncv", "eps_tol",
          "eps_max_it", "eps_target", "st_type", "st_ksp_type", "st_pc_type", "vec_type",
          "dm_vec_type", "dm_mat_type", *OUTSIDE)
#: A number that is larger, or smaller than its inverse, may leave the range of floating point.
EXTREME = 1e50
#: Variables of the environment that PETSc reads options from.
SOURCES = "PETSC_OPTIONS", "PETSC_OPTIONS_YAML"
NO_YAML = "options are not read from YAML; -options_file takes a file of lines -name value"
#: Longest line of an options file, characters.
LONGEST = 10000


def as_json(answer):
    """Return ``answer`` as one JSON object; raises ValueError where a number is not finite."""
    return json.dumps(answer, allow_nan=False)


def command_option(name, kind, meaning, default=None, **more):
    """Return the row of an option that one command has; its name carries no prefix."""
    return Option(name, kind, default, more.pop("unit", ""), meaning, prefix="", **more)


def start(arguments, action, description="", rows=(), slepc=False,
          complete=lambda texts: texts):
    """Start PETSc, do ``action(parameters, own, comm)`` and return the exit code. Collective.

    Without options it prints what ``-help`` prints. Where PETSc has already been initialised in
    this process, its options are set aside meanwhile.

    An error of `REPORTED_ERRORS`, of PETSc or of memory that all ranks raise becomes one message of rank 0.
    What strikes only some ranks ends them all.

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
    complete : callable
        ``complete(texts)`` returns the texts of all options of a run, {name: text}, from those that
        were given.

    Returns
    -------
    int
        0 after success, `STOPPED` if a signal stopped the run, and 1 after an error.
    """
    guard_streams()
    running = petsc_runs()
    wants_help, everything_asked = _help_asked(arguments)
    given, problem = [word for word, before in zip(arguments, ["", *arguments])
                      if word not in (*HELP, *VERSION)
                      and not (word == ALL and before in HELP)], None
    found = {}
    try:
        found = check_sources(given[1:])
        if running:
            refuse_at_start(found)
    except OptionError as error:  # so that PETSc starts, and all ranks can end together
        given, problem = [*given[:1], "-skip_petscrc"], error
        for name in SOURCES:
            os.environ.pop(name, None)
    given = ["pgran", *FIRST, *file_first(given)[1:]]
    asked = {number: signal.getsignal(number) for number in SIGNALS}
    package = importlib.import_module("slepc4py" if slepc else "petsc4py")
    package.init(given)
    from petsc4py import PETSc

    asked[signal.SIGPIPE] = signal.SIG_IGN  # `Stream` sees the error
    for number, handler in asked.items():
        signal.signal(number, handler)  # as before PETSc took it
    comm, texts = PETSc.COMM_WORLD, {}
    apart = comm.tompi4py().Dup()  # so that waiting for the others meets no message of the work
    with decimal_points(), database(found) if running else nullcontext():
        try:
            if problem:
                raise problem
            if set(VERSION) & set(arguments):
                if comm.rank == 0:
                    print(f"pgran {__version__}", flush=True)
                return 0
            everything = PETSc.Options().getAll()
            texts = given_texts(rows)
            if wants_help or not arguments[1:]:
                if comm.rank == 0:
                    print(help_text(description, rows, _rows_for_help(texts)
                                    if everything_asked or wants_help and texts else ()),
                          flush=True)
                return 0 if wants_help else 1
            parameters = cases.read(complete(texts))
            check_names(everything, rows, parameters.options)
            values = SimpleNamespace(**{row.name: row.parse(texts[row.name]) if row.name in texts
                                        else row.default for row in rows})
            with strict(texts):
                action(parameters, values, comm)
            return int(bool(rows) and sys.stdout.failed)  # its answer is lost; a run has its file
        except BaseException as error:
            return report_error(error, comm, apart, extreme(texts))


def petsc_runs():
    """Return whether PETSc has been initialised in this process."""
    module = sys.modules.get("petsc4py.PETSc")
    return module is not None and module.Sys.isInitialized()


@contextmanager
def database(texts):
    """Let PETSc have the options {name: text} and no others, until the context ends."""
    from petsc4py import PETSc

    present = PETSc.Options()

    def take(wanted):
        before = {name: present.getString(name, "") for name in present.getAll()}
        for name in before:
            present.delValue(name)
        for name, text in wanted.items():
            present.setValue(name, text)
        return before

    before = take(texts)
    try:
        yield
    finally:
        take(before)


@contextmanager
def decimal_points():
    """Let C read and write numbers with a decimal point, as PETSc's options have it.

    PETSc reads numbers by strtod, which follows the locale of the process.
    """
    before = locale.setlocale(locale.LC_NUMERIC)
    locale.setlocale(locale.LC_NUMERIC, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)


def refuse_at_start(texts):
    """Raise `OptionError` if {name: text} has an option that PETSc reads only when it starts."""
    for name in AT_START:
        if name in texts:
            raise OptionError(f"-{name}: PETSc reads this option only when it starts, and it runs "
                              "in this process already; allowed in a process of its own")


def report_error(error, comm, apart, beyond):
    """Report an error once; return the exit code. Ends all ranks if only some have met it.

    ``beyond`` are the options that were given with an `extreme` value, in words.
    """
    from petsc4py import PETSc

    error = callback_error(error)
    code = STOPPED if isinstance(error, Interrupted) else 1
    if isinstance(error, Interrupted):
        text = f"pgran: {error.as_option()}"
    elif isinstance(error, SolutionError) and beyond:
        text = f"pgran: error: {beyond}: {error.as_option().split(' What may help:')[0]}"
    elif isinstance(error, REPORTED_ERRORS):
        text = f"pgran: error: {error.as_option()}"
    elif isinstance(error, ArithmeticError) and beyond:
        text = f"pgran: error: {beyond} ({error.args[-1]})"
    elif isinstance(error, PETSc.Error):
        text = f"pgran: error: {petsc_words(error)}"
    elif isinstance(error, MemoryError):
        text = ("pgran: error: not enough memory; larger elements, fewer of them, or more ranks on "
                f"more machines need less{f' ({error})' if str(error) else ''}")
    else:
        text = "".join(traceback.format_exception(error)).rstrip()
    end_unless_shared(error, apart, text)
    if text and comm.rank == 0:
        print(text, file=sys.stderr, flush=True)
    return code


def end_unless_shared(error, apart, text):
    """End all ranks, and say ``text``, unless all of them have raised an error. Collective.

    ``apart`` is an mpi4py communicator with no messages under way.
    """
    if getattr(error, "alone", False) or not all_ranks_arrive(apart):
        print(f"{text}\npgran: rank {apart.rank} failed and others did not; all are ended",
              file=sys.stderr, flush=True)
        apart.Abort(1)


def given_texts(rows=()):
    """Return the options of a run and of the `Option`s ``rows`` in PETSc's database, {name: text}.

    They count as read from then on.
    """
    from petsc4py import PETSc

    database = PETSc.Options()
    # getAll splits values at blanks; getString gives them whole, and counts them as used.
    return {name: database.getString(name, "") for name in database.getAll()
            if name.startswith(options.PREFIX) or name in {row.name for row in rows}}


def extreme(texts):
    """Return which of the options {name: text} have values beyond `EXTREME`, in words."""
    def beyond(part):
        try:
            size = abs(float(part))
        except ValueError:
            return False
        return size > EXTREME or 0.0 < size < 1.0 / EXTREME

    found = [f"-{name} {text}" for name, text in texts.items() if any(map(beyond, text.split(",")))]
    return f"{', '.join(found)}: too large or too small to compute with" if found else ""


def strict(texts):
    """Return a context in which numpy raises what it cannot compute if an option is `extreme`."""
    how = "raise" if extreme(texts) else "warn"
    return np.errstate(over=how, divide=how, invalid=how)


def all_ranks_arrive(comm):
    """Return whether all ranks come here within `TOGETHER` seconds.

    No other messages may be under way on the mpi4py communicator ``comm``. An error that is found
    not to be shared gets the attribute ``alone``, so that `start` ends all ranks at once.
    """
    request, end = comm.Ibarrier(), time.monotonic() + TOGETHER
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(0.001)
    return True


def petsc_words(error):
    """Return what PETSc says of an error, and which option it may come from, in one line."""
    from petsc4py import PETSc

    lines = [re.sub(r"^\[\d+\] ?", "", line).strip() for line in str(error).splitlines()]
    said = [line for line in lines if line and not re.search(r"\(\) (at|line) ", line)]
    text = " ".join(said[1:] or said)
    database = PETSc.Options()
    named = [f"-{name} {value}" for name, value in database.getAll().items()
             if value and (len(value) > 1 and re.search(rf"\b{re.escape(value)}\b", text)
                           or re.search(rf"\bvalue of {name.split('_')[-1]}\b", text))]
    return f"{', '.join(named)}: {text}" if named else f"PETSc: {text}"


def _rows_for_help(texts):
    try:
        return cases.read({name: text for name, text in texts.items()
                           if name[len(options.PREFIX):] in {kind.name for kind in cases.KINDS}}
                          ).options
    except REPORTED_ERRORS:
        return cases.read({}).options


# The command line, before PETSc reads it

def is_option(text):
    """Return whether a word of a command line is the name of an option, and no number."""
    return bool(re.match(r"--?[A-Za-z_]", text))


def check_sources(words):
    """Check the words of a command line, and all else that PETSc reads options from.

    That is PETSC_OPTIONS, and .petscrc and petscrc in the home and in the present folder. Returns
    what PETSc finds in all of them, {name: text}. Raises `OptionError` as `check_command_line` and
    `read_file` do.
    """
    try:
        more = shlex.split(os.environ.get(SOURCES[0], ""))
    except ValueError as problem:
        raise OptionError(f"{SOURCES[0]}: {str(problem).lower()}") from None
    check_command_line(words)
    check_command_line(more, SOURCES[0])
    if os.environ.get(SOURCES[1]):
        raise OptionError(f"{SOURCES[1]}: {NO_YAML}")
    found = {}
    for path in (Path(os.path.expanduser("~"), ".petscrc"), Path(".petscrc"), Path("petscrc")):
        if "-skip_petscrc" not in words + more and os.path.exists(path):
            found.update(read_file(path, label=path))
    return {**found, **combined_options(None, *more), **combined_options(None, *words)}


def check_name(word, where):
    """Raise `OptionError` where an option is written as none of PETSc's is."""
    if word.startswith("--"):
        raise OptionError(f"{word}: options begin with one dash, as in {word[1:]} ({where})")
    if "=" in word:
        name, _, value = word.partition("=")
        raise OptionError(f"{word}: a blank divides name and value, as in {name} "
                          f"{value or 'VALUE'} ({where})")
    if word in ("-options_file_yaml", "-options_string_yaml"):
        raise OptionError(f"{word}: {NO_YAML} ({where})")


def check_command_line(words, where="command line"):
    """Raise `OptionError` where the words of a command line are not ``-name [value]``.

    Files that ``-options_file`` names are checked too.
    """
    expected = False  # whether a value may follow
    for word, value in zip(words, [*words[1:], ""]):
        if is_option(word):
            check_name(word, where)
            if word == "-options_file":
                if not value or is_option(value):
                    raise OptionError("-options_file: the name of a file is missing")
                read_file(value)
            expected = True
        elif expected:
            expected = False
        else:
            raise OptionError(f"{word}: not an option, nor the value of one; options begin with a "
                              f"dash ({where})")


def read_file(path, above=(), label=None):
    """Return the options of a file, {name: text}; those of files that it names are among them.

    ``label`` is what messages call it.

    Raises
    ------
    OptionError
        If a file cannot be read, or a line is not ``-name [value]``.
    """
    label = label or f"-options_file {path}"
    if not os.path.exists(path):
        raise OptionError(f"{label}: there is no such file")
    if os.path.realpath(path) in above:
        raise OptionError(f"{label}: it names itself")
    try:
        lines = Path(path).read_bytes().decode().splitlines()
    except (OSError, UnicodeDecodeError) as problem:
        raise OptionError(f"{label}: it cannot be read as text "
                          f"({getattr(problem, 'strerror', None) or 'not UTF-8'})") from None
    found = {}
    for number, line in enumerate(lines, 1):
        def refuse(reason):
            raise OptionError(f"{label}, line {number}: {reason}")  # noqa: B023  # used at once

        if "\0" in line:
            refuse("it is no text")
        if len(line) > LONGEST:
            refuse(f"it has {len(line)} characters; allowed are {LONGEST}")
        try:
            words = shlex.split(line, comments=True)
        except ValueError as problem:
            refuse(str(problem).lower())
        if not words:
            continue
        name, *value = words
        if not is_option(name) or name.startswith("--"):
            refuse(f"{name} is no option; a line holds -name value")
        check_name(name, f"{label}, line {number}")
        if len(value) > 1:
            refuse(f"{' '.join(value[1:])} is too much; a line holds one option, -name value")
        if name == "-options_file":
            found.update(read_file(value[0] if value else "",
                                   (*above, os.path.realpath(path))))
        found[name[1:]] = value[0] if value else ""
    return found


def parsed(tokens):
    """Return {name: text} of options ``-name value``; the last one of a name holds."""
    texts, name = {}, None
    for token in map(str, tokens):
        if is_option(token):
            name = token.lstrip("-")
            texts[name] = ""
        elif name:
            texts[name], name = token, None
    return texts


def combined_options(options_file, *words):
    """Return {name: text} of an options file (None: of none) and of options that win over it.

    Further files that the options name win over the first one. Raises `pgran.options.OptionError`
    where a file cannot be read.
    """
    further = [path for word, path in zip(words, words[1:]) if str(word) == "-options_file"]
    texts = {}
    for path in filter(None, (options_file, *further)):
        texts.update(read_file(path))
    texts.update(parsed(words))
    texts.pop("options_file", None)
    return texts


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


# Names that nothing reads

def misspelt(name, other):
    """Return whether two names differ as a misspelling does: by a letter or two."""
    a, b = (re.sub(r"\d+", "#", text.replace("-", "_")) for text in (name, other))
    if a == b:
        return name != other and "-" in name
    longest, changed = [[0] * (len(b) + 1) for _ in range(2)], range(len(b) + 1)
    longest = list(changed)
    for i, letter in enumerate(a, 1):  # the distance of Levenshtein
        row = [i]
        for j, its in enumerate(b, 1):
            row.append(min(longest[j] + 1, row[-1] + 1, longest[j - 1] + (letter != its)))
        longest = row
    return longest[-1] <= (1 if min(len(a), len(b)) < 5 else 2)


def check_names(everything, rows, run_rows):
    """Refuse a name that is nearly one of this command, of a run, or of PETSc.

    ``everything`` = {name: text} are all options, ``rows`` and ``run_rows`` the `Option`s of the
    command and of the run. Raises `OptionError`.
    """
    mine = {name: f"-{name}" for name in (*(row.name for row in rows), "options_file", "help",
                                          "version", "doctor")}
    runs = {row.name: f"-{row.prefix}{row.name}" for row in run_rows}
    for name, value in everything.items():
        if name in mine or name.startswith(options.PREFIX):
            continue
        if (value or "").lower() == "nan":
            raise OptionError(f"-{name} {value}: allowed is a number")
        head = name.replace("-", "_").split("_")[0]
        near = [text for known, text in mine.items() if len(name) > 3 and misspelt(name, known)]
        if near:
            raise OptionError(f"-{name}: no such option; did you mean {' or '.join(near)}?")
        near = [text for known, text in runs.items()
                 if name == known or misspelt(name, text[1:])]
        if not near and len(head) > 2 and head not in HEADS:
            near = [f"-{known}{name[len(head):]}" for known in HEADS if misspelt(head, known)]
        if near:
            raise OptionError(f"-{name} {value or ''}".rstrip() + ": no such option; did you mean "
                              + " or ".join(near[:3]) + "?")


def unread():
    """Return the options of PETSc that nothing has read so far, {name: text}."""
    from petsc4py import PETSc

    return {name: value or "" for name, value in PETSc.Options().getAll().items()
            if name not in OUTSIDE and not was_read(name)}


def report_unread(comm):
    """Tell which options nothing has read. Collective.

    Raises
    ------
    OptionError
        If one of them is nearly one that was read, or a common one.
    """
    from petsc4py import PETSc

    # A file of another solver may follow one that chooses MUMPS.
    left = {name: value for name, value in unread().items() if DIRECT.get(name) != value}
    known = (set(PETSc.Options().getAll()) - set(left)) | set(COMMON)
    for name, value in left.items():
        near = [other for other in sorted(known) if misspelt(name, other)]
        if near and name not in COMMON:
            raise OptionError(f"-{name} {value}".rstrip() + ": no such option; did you mean "
                              + " or ".join(f"-{other}" for other in near[:3]) + "?")
    if left and comm.rank == 0:
        print("pgran: note: nothing has read " + ", ".join(
            f"-{name} {value}".rstrip() for name, value in left.items()), file=sys.stderr,
            flush=True)


# What a command meets on its way

class Stream:
    """Standard output or error that goes on in silence when it cannot be written.

    Attributes
    ----------
    failed : bool
        Whether something was lost, although whoever reads it has not gone.
    """

    def __init__(self, stream):
        self._stream, self.failed = stream, False

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text):
        """Write ``text``."""
        return self._try(lambda: self._stream.write(text))

    def flush(self):
        """Write what waits."""
        self._try(self._stream.flush)

    def _try(self, action):
        try:
            return action()
        except OSError as problem:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            if not isinstance(problem, BrokenPipeError):
                self.failed = True
                print("pgran: warning: standard output cannot be written "
                      f"({problem.strerror}); nothing more is shown", file=sys.stderr, flush=True)
            return None


def guard_streams():
    """Let no command end because standard output or error is closed, or cannot be written."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:  # closed: no file of the run may get its number
            os.open(os.devnull, os.O_RDWR)
        stream = getattr(sys, name)
        if number and not isinstance(stream, Stream):
            setattr(sys, name, Stream(stream or open(number, "w", closefd=False)))


def _help_asked(words):
    """Whether a command line asks for help, and for that on every option."""
    places = [place for place, word in enumerate(words) if word in HELP]
    return bool(places), any(words[place + 1:place + 2] == [ALL] for place in places)


def help_text(description, rows, run_rows=()):
    """Return the text of ``-help``: the first options, or with ``run_rows`` all of them."""
    mine = f"Options of this command:\n\n{options.help_text(rows)}\n\n" if rows else ""
    if not run_rows:
        names = {kind.name: " | ".join(kind.names) for kind in cases.KINDS}
        return f"{description}\n{mine}" + FIRST_HELP.format(
            cases=names["case"].replace(" |", ","), models=names["model"], laws=names["law"])
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
        error of `REPORTED_ERRORS`, ValueError or OSError, which become one message.
    rows : tuple of pgran.options.Option
        The command's own options.
    operands : str
        What the arguments without a dash are; empty where there are none.
    runs : bool
        Whether the command takes the options of a run.
    """
    guard_streams()
    if set(VERSION) & set(arguments):
        print(f"pgran {__version__}")
        return 0
    texts = {}
    try:
        wants_help, everything_asked = _help_asked(arguments)
        if not arguments or wants_help:
            more = (f"\n\n{options.help_text(cases.read({}).options)}" if everything_asked else
                    f"\n\n-help {ALL} shows the options of a run too.") if runs else ""
            print(f"{description}\nOptions:\n\n{options.help_text(rows)}{more}")
            return 0 if arguments else 1
        texts, found = parse(arguments, rows, bool(operands), runs)
        values = SimpleNamespace(**{row.name: row.parse(texts[row.name]) if row.name in texts
                                    else row.default for row in rows})
        if not runs and not found:
            raise OptionError(f"{operands} missing")
        with strict(texts):
            action(*((cases.read(texts), values) if runs else (values, found)))
        sys.stdout.flush()
        return int(sys.stdout.failed)
    except REPORTED_ERRORS as error:
        message = error.as_option()
    except (ValueError, OSError, KeyError) as error:
        message = str(error)
    except ImportError as error:
        message = f"{error}; pictures and grids need pip install 'pgran[plot]'"
    except ArithmeticError as error:
        if not extreme(texts):
            raise
        message = f"{extreme(texts)} ({error.args[-1]})"
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


def steady():
    """Return whether ``-ts_type`` asks for pseudo-time. Raises `OptionError` for other types."""
    from petsc4py import PETSc

    kind = PETSc.Options().getString("ts_type", PETSc.TS.Type.BEULER)
    if kind not in (PETSc.TS.Type.BEULER, PETSc.TS.Type.PSEUDO):
        raise OptionError(f"-ts_type {kind}: allowed is beuler | pseudo")
    return kind == PETSc.TS.Type.PSEUDO


def choose_solver():
    """Give the options of `DIRECT` that are missing, unless ``-pc_type`` says that one was chosen.

    PETSc's own defaults do not solve these equations. Those of TSPSEUDO solve one linear system a
    step and never end: the options of `PSEUDO` that are missing are given to every steady run.
    Returns the names of those that it gave, a set.
    """
    from petsc4py import PETSc

    database = PETSc.Options()
    wanted = {**({} if database.hasName("pc_type") else DIRECT), **(PSEUDO if steady() else {})}
    missing = {name: value for name, value in wanted.items() if not database.hasName(name)}
    for name, value in missing.items():
        database.setValue(name, value)
    return set(missing)


def solver_options(added):
    """Return the options of PETSc but those ``added`` by pgran, as the lines of an options file.

    They count as read from then on.
    """
    from petsc4py import PETSc

    database = PETSc.Options()
    return "".join(f"-{name} {database.getString(name, '')}".rstrip() + "\n"
                   for name in sorted(set(database.getAll()) - added)
                   if not name.startswith((options.PREFIX, "options_")))
