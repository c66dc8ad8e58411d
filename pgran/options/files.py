"""Options files, command lines, and the options files that pgran provides."""

import os
import re
import shlex
import site
import sysconfig
from pathlib import Path

from .errors import PREFIX, OptionError
from .parameters import RUN

#: Environment variables from which PETSc reads options.
SOURCES = "PETSC_OPTIONS", "PETSC_OPTIONS_YAML"
NO_YAML = "options in YAML are not supported; -options_file reads lines -name value"
#: Longest line of an options file, characters.
MAX_LENGTH = 10000
#: Options of pgran that belong to the solver and not to the flow.
SOLVER = tuple(PREFIX + name for name in (
    "tolerance_full_deviation", "tolerance_min_factor", "coarse_correction"))
#: Options of steady.opts without which TSPSEUDO does not end.
PSEUDO = ("snes_type", "ts_pseudo_increment", "ts_pseudo_fatol", "ts_pseudo_frtol", "ts_max_steps")


def is_option(text):
    """Return whether a word of a command line is an option name and not a number."""
    return bool(re.match(r"--?[A-Za-z_]", text))


def check_sources(words):
    """Return the options {name: text} of a command line and of all other sources of PETSc.

    The other sources are PETSC_OPTIONS, and .petscrc and petscrc in the home and in the current
    directory. Raises `OptionError` if one of them is invalid.
    """
    try:
        more = shlex.split(os.environ.get(SOURCES[0], ""))
    except ValueError as error:
        raise OptionError(f"{SOURCES[0]}: {str(error).lower()}") from None
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
    """Raise `OptionError` if a word is not a valid name of an option of PETSc."""
    if word.startswith("--"):
        raise OptionError(f"{word}: options begin with one dash, as in {word[1:]} ({where})")
    if "=" in word:
        name, _, value = word.partition("=")
        raise OptionError(f"{word}: a blank separates name and value, as in {name} "
                          f"{value or 'VALUE'} ({where})")
    if word in ("-options_file_yaml", "-options_string_yaml"):
        raise OptionError(f"{word}: {NO_YAML} ({where})")


def check_command_line(words, where="command line"):
    """Raise `OptionError` unless words are ``-name [value]``; options files are checked too."""
    expected = False  # whether a value may follow
    for word, value in zip(words, [*words[1:], ""]):
        if is_option(word):
            check_name(word, where)
            if word == "-options_file":
                if not value or is_option(value):
                    raise OptionError("-options_file: the file name is missing")
                read_file(value)
            expected = True
        elif expected:
            expected = False
        else:
            raise OptionError(f"{word}: neither an option nor a value; options begin with a dash "
                              f"({where})")


def read_file(path, above=(), label=None):
    """Return the options {name: text} of a file and of the files that it includes.

    Names of included files are relative to this file or to the current directory.

    Parameters
    ----------
    path : str or Path
    above : tuple of str
        Real paths of the files that include this one.
    label : str, optional
        Name of the file in messages.

    Raises
    ------
    OptionError
        If a file cannot be read, or if a line is not ``-name [value]``.
    """
    label = label or f"-options_file {path}"
    if not os.path.exists(path):
        raise OptionError(f"{label}: there is no such file")
    if os.path.realpath(path) in above:
        raise OptionError(f"{label}: the file includes itself")
    try:
        lines = Path(path).read_bytes().decode().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise OptionError(f"{label}: cannot be read as text ({reason})") from None
    found = {}
    for number, line in enumerate(lines, 1):
        where = f"{label}, line {number}"
        name, value = _parsed_line(line, where)
        if name == "-options_file":
            nested = Path(path).parent / value
            found.update(read_file(nested if value and nested.is_file() else value,
                                   (*above, os.path.realpath(path))))
        elif name:
            found[name[1:]] = value
    return found


def _parsed_line(line, where):
    """The name and the value in a line of an options file; two empty texts if it is blank."""
    if "\0" in line:
        raise OptionError(f"{where}: not text")
    if len(line) > MAX_LENGTH:
        raise OptionError(f"{where}: has {len(line)} characters; must be <= {MAX_LENGTH}")
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        raise OptionError(f"{where}: {str(error).lower()}") from None
    if not words:
        return "", ""
    name, *values = words
    if not is_option(name) or name.startswith("--"):
        raise OptionError(f"{where}: {name} is not an option; a line is -name value")
    check_name(name, where)
    if len(values) > 1:
        raise OptionError(f"{where}: unexpected {' '.join(values[1:])}; a line is -name value")
    return name, values[0] if values else ""


def parsed(words):
    """Return {name: text} of words ``-name value``. The last value of a name is used."""
    texts, name = {}, None
    for word in map(str, words):
        if is_option(word):
            name = word.lstrip("-")
            texts[name] = ""
        elif name:
            texts[name], name = word, None
    return texts


def combined_options(options_file, *words):
    """Return {name: text} of an options file (or None) and of options that override it.

    Further options files among the words override the first one. Raises `OptionError` if a file
    cannot be read.
    """
    further = [path for word, path in zip(words, words[1:]) if str(word) == "-options_file"]
    texts = {}
    for path in filter(None, (options_file, *further)):
        texts.update(read_file(path))
    texts.update(parsed(words))
    texts.pop("options_file", None)
    return texts


def shipped(name):
    """Return the path of options/NAME.opts in the repository or an installation, or None."""
    folders = [Path(__file__).resolve().parents[2] / "options"]
    folders += [Path(base) / "share" / "pgran" / "options"
                for base in (sysconfig.get_path("data"), site.getuserbase())]
    return next((path for path in (folder / f"{name}.opts" for folder in folders)
                 if path.is_file()), None)


def default_solver(texts):
    """Return the solver of a run whose options do not choose one.

    It is the solver in the options file of the case if it suits the model and -ts_type, otherwise
    MUMPS as in options/solver_lu.opts.

    Parameters
    ----------
    texts : dict
        {name: text} of all options of the run, including those of PETSc.

    Returns
    -------
    path : Path or None
        The options file of the solver; None if ``-pc_type`` is among the options.
    solver : dict
        {name: text} of the options that are missing.
    """
    path, solver = None, {}
    steady = texts.get("ts_type") == "pseudo"
    if "pc_type" not in texts:
        for name in (_chosen(texts, "case"), "steady", "solver_lu"):
            path = shipped(name)
            found = read_file(path) if path else {}
            if "pc_type" in found and suits(found, texts):
                break
        else:
            raise OptionError("options/solver_lu.opts is missing; install pgran again")
        solver = {name: text for name, text in found.items()
                  if name in SOLVER or not name.startswith((PREFIX, "ts_type"))}
    if steady:
        file = shipped("steady")
        pseudo = read_file(file) if file else {}
        solver = {**{name: pseudo[name] for name in PSEUDO if name in pseudo}, **solver}
    return path, {name: text for name, text in solver.items() if name not in texts}


def suits(found, texts):
    """Return whether the solver of an options file suits the options {name: text} of a run.

    The type of time stepping must be the same. Multigrid suits only the model of the file.
    """
    stepping = [options.get("ts_type", "beuler") for options in (found, texts)]
    models = [_chosen(options, "model") for options in (found, texts)]
    return ("ts_type" not in found or stepping[0] == stepping[1]) and (
        found["pc_type"] == "lu" or models[0] == models[1])


def _chosen(texts, name):
    """The case, law or model in {name: text}, or its default."""
    return texts.get(PREFIX + name) or next(
        option.default for option in RUN if option.name == name)
