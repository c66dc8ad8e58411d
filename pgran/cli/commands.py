"""Commands that do not need PETSc, and the help texts of all commands."""

import argparse
import json
import re
import sys
from types import SimpleNamespace

import numpy as np

from .. import __version__, cases
from ..options import PREFIX, OptionError, command_option, help_text, parsed
from ..options.errors import unknown_option
from .report import exit_code
from .streams import guard_streams

HELP = ("-help", "--help", "-h")
ALL = "all"
VERSION = "-version", "--version"
JSON = command_option("json", "flag", "print one JSON object instead of text", False)
SUMMARY = f"""Options of a run:
  -options_file FILE          read options from a file, one per line; see options/*.opts
  -pgran_case NAME            flow problem, or FILE.py:Class; NAME is one of
                              {{case}}
  -pgran_model, -pgran_law    rheology: {{model}}; {{law}}
  -pgran_output NAME.h5       result file
  -pgran_restart NAME.h5      resume a run from its last checkpoint

-help {ALL} lists every option; with -pgran_case NAME it includes the options of that case.
docs/reference/options.md describes them. -doctor checks the installation, and -version prints the
version.
Options of PETSc (-ts_, -snes_, -ksp_, -pc_, -log_view, ...) are accepted too."""


def as_json(value):
    """Return ``value`` as JSON. Raises ValueError if a number is not finite."""
    return json.dumps(value, allow_nan=False)


def help_wanted(words):
    """Return whether a command line requests help, and whether it requests all options."""
    following = [after for word, after in zip(words, [*words[1:], ""]) if word in HELP]
    return bool(following), ALL in following


def run_help(description, options, run_options=()):
    """Return the text of ``-help`` of a command on ranks: the summary, or all ``run_options``."""
    if run_options:
        last = f"Options of the run, as <default> [unit]:\n\n{help_text(run_options)}"
    else:
        last = SUMMARY.format(**{kind.name: ", ".join(kind.names) for kind in cases.KINDS})
    first = f"Options of this command:\n\n{help_text(options)}\n\n" if options else ""
    return f"{description}\n{first}{last}"


def values_of(options, texts):
    """Return a namespace with the values of a command's options, given as {name: text}."""
    return SimpleNamespace(**{
        option.name: option.parse(texts[option.name]) if option.name in texts else option.default
        for option in options})


def run_without_petsc(arguments, name, action, description, options, operands="", runs=False):
    """Run a command that does not need PETSc; return the exit code.

    Parameters
    ----------
    arguments : list of str
        The command line without the name of the program.
    action : callable
        ``action(args, operands)``, or ``action(parameters, args)`` with ``runs``.
    options : tuple of pgran.options.Option
        Options of the command.
    operands : str
        Description of the arguments without a dash, if the command has any.
    runs : bool
        Whether the command accepts the options of a run.
    """
    guard_streams()
    if set(VERSION) & set(arguments):
        print(f"pgran {__version__}")
        return 0
    wanted, all_options = help_wanted(arguments)
    if wanted or not arguments:
        more = (f"\n\n{help_text(cases.read({}).options)}" if all_options else
                f"\n\n-help {ALL} lists the options of a run too.") if runs else ""
        print(f"{description}\nOptions:\n\n{help_text(options)}{more}")
        return int(not wanted)

    def work():
        texts, found = _parse(arguments, options, bool(operands), runs)
        args = values_of(options, texts)
        if operands and not found:
            raise OptionError(f"{operands} missing")
        overflow = "raise" if runs else "warn"
        with np.errstate(over=overflow, divide=overflow):
            action(*((cases.read(texts), args) if runs else (args, found)))
        sys.stdout.flush()

    return exit_code(f"pgran.{name}", work) or int(sys.stdout.failed)


class _Parser(argparse.ArgumentParser):
    """Options with one dash and their full name; values may begin with a minus sign."""

    def __init__(self):
        super().__init__(add_help=False, allow_abbrev=False)
        self._negative_number_matcher = re.compile(r"-[\d.]")

    def _get_option_tuples(self, option_string):
        return []  # no abbreviations

    def error(self, message):
        raise OptionError(message.replace("argument ", "").replace("expected one argument",
                                                                   "the value is missing"))


def _parse(arguments, options, operands, runs):
    """Split a command line into texts of options, {name: text}, and operands, a list."""
    parser = _Parser()
    for option in options:
        flag = {"action": "store_const", "const": "true"} if option.kind == "flag" else {}
        parser.add_argument(f"-{option.name}", **flag)
    found, rest = parser.parse_known_args(arguments)
    for word in rest:
        option = word.startswith("-") and not re.match(r"-[\d.]", word)
        if option and not (runs and word.startswith(f"-{PREFIX}")):
            raise unknown_option(word.lstrip("-"), [option.name for option in options], "")
    texts = {name: text for name, text in vars(found).items() if text is not None}
    return (texts, rest) if operands else ({**texts, **parsed(rest)}, [])
