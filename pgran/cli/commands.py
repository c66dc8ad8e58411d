"""Commands that do not need PETSc, and the help texts of all commands."""

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


def run_without_petsc(arguments, name, action, description, options, operands=""):
    """Run a command that does not need PETSc; return the exit code.

    ``arguments`` lack the name of the program, and ``operands`` describes those without a dash. A
    command without operands accepts the options of a run: it calls ``action(parameters, args)``
    instead of ``action(args, operands)``.
    """
    guard_streams()
    if set(VERSION) & set(arguments):
        print(f"pgran {__version__}")
        return 0
    wanted, all_options = help_wanted(arguments)
    if wanted or not arguments:
        more = "" if operands else (f"\n\n{help_text(cases.read({}).options)}" if all_options else
                                    f"\n\n-help {ALL} lists the options of a run too.")
        print(f"{description}\nOptions:\n\n{help_text(options)}{more}")
        return int(not wanted)

    def work():
        texts, others = _parse(arguments, options, run_options=not operands)
        args = values_of(options, texts)
        if not operands:
            with np.errstate(over="raise", divide="raise"):
                action(cases.read(parsed(others)), args)
        elif others:
            action(args, others)
        else:
            raise OptionError(f"{operands} missing")
        sys.stdout.flush()

    return exit_code(f"pgran.{name}", work) or int(sys.stdout.failed)


def _parse(arguments, options, run_options):
    """Split a command line into texts of options, {name: text}, and other words, a list."""
    kinds = {f"-{option.name}": option.kind for option in options}
    texts, others, words = {}, [], iter(arguments)
    for word in words:
        if word in kinds:
            text = "true" if kinds[word] == "flag" else next(words, None)
            if text is None or _is_option(text):
                raise OptionError(f"{word}: the value is missing")
            texts[word[1:]] = text
        elif _is_option(word) and not (run_options and word.startswith(f"-{PREFIX}")):
            raise unknown_option(word.lstrip("-"), [option.name for option in options], "")
        else:
            others.append(word)
    return texts, others


def _is_option(word):
    return re.match(r"-[^\d.]", word)  # a value may be a negative number
