"""Options files, command lines, and the options files that pgran provides."""

import os
import re
import shlex
from pathlib import Path

from .errors import PREFIX, OptionError
from .parameters import RUN

#: Options of pgran that belong to the solver and not to the flow.
SOLVER = tuple(PREFIX + name for name in (
    "tolerance_full_deviation", "tolerance_min_factor", "coarse_correction"))
#: Options of steady.opts without which TSPSEUDO does not end.
PSEUDO = ("snes_type", "ts_pseudo_increment", "ts_pseudo_fatol", "ts_pseudo_frtol", "ts_max_steps")


def parsed(words, where="command line", folder=".", above=()):
    """Return {name: text} of words ``-name [value]``, which override the options files they name.

    ``where`` is the source for messages. Options files are in ``folder`` or the current directory;
    ``above`` are the files that include this one. Raises `OptionError`.
    """
    files, texts, name = {}, {}, None
    for word in map(str, words):
        if re.match(r"--[A-Za-z_]", word):
            raise OptionError(f"{word}: options begin with one dash, as in {word[1:]} ({where})")
        if re.match(r"-[A-Za-z_]", word):
            if "=" in word:
                raise OptionError(f"{word}: a blank separates name and value, as in "
                                  f"{word.replace('=', ' ')} ({where})")
            name = word[1:]
            texts[name] = ""
        elif name:
            if name == "options_file":
                path = Path(folder) / word
                files.update(read_file(path if path.is_file() else word, above))
            texts[name], name = word, None
        else:
            raise OptionError(f"{word}: neither an option nor a value; options begin with a dash "
                              f"({where})")
    if not texts.pop("options_file", "FILE"):
        raise OptionError(f"-options_file: the file name is missing ({where})")
    return {**files, **texts}


def read_file(path, above=()):
    """Return {name: text} of an options file and of the files that it includes; see `parsed`."""
    label, real = f"-options_file {path}", os.path.realpath(path)
    if real in above:
        raise OptionError(f"{label}: the file includes itself")
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise OptionError(f"{label}: cannot be read as text ({reason})" if os.path.exists(path)
                          else f"{label}: there is no such file") from None
    found = {}
    for number, line in enumerate(lines, 1):
        where = f"{label}, line {number}"
        found.update(parsed(_split(line, where, comments=True), where, Path(path).parent,
                            (*above, real)))
    return found


def _split(text, where, **how):
    try:
        return shlex.split(text, **how)
    except ValueError as error:
        raise OptionError(f"{where}: {str(error).lower()}") from None


def combined_options(options_file, *words):
    """Return {name: text} of an options file (or None) and of words that override it."""
    return {**(read_file(options_file) if options_file else {}), **parsed(words)}


def all_sources(words):
    """Return {name: text} of a command line, PETSC_OPTIONS, and petscrc files as PETSc has them."""
    files = Path.home() / ".petscrc", Path(".petscrc"), Path("petscrc")
    found = {}
    for path in filter(Path.is_file, files if "-skip_petscrc" not in words else ()):
        found.update(read_file(path))
    variable = "PETSC_OPTIONS"
    found.update(parsed(_split(os.environ.get(variable, ""), variable), variable))
    return {**found, **parsed(words)}


def shipped(name):
    """Return the path of options/NAME.opts in the repository or an installation, or None."""
    parents = Path(__file__).resolve().parents
    folders = [parents[2] / "options"] + [parent / "share/pgran/options" for parent in parents]
    paths = (folder / f"{name}.opts" for folder in folders)
    return next((path for path in paths if path.is_file()), None)


def default_solver(texts):
    """Return the path and the missing options {name: text} of the solver of a run.

    It is the solver in the options file of the case if it suits the model and -ts_type, otherwise
    MUMPS as in options/solver_lu.opts. The path is None if ``texts``, {name: text} of all options,
    contain ``-pc_type``.
    """
    path, solver = None, {}
    if "pc_type" not in texts:
        paths = filter(None, map(shipped, (_chosen(texts, "case"), "steady", "solver_lu")))
        path = next(path for path in paths if suits(read_file(path), texts))
        solver = {name: text for name, text in read_file(path).items()
                  if name in SOLVER or not name.startswith((PREFIX, "ts_type"))}
    if texts.get("ts_type") == "pseudo":
        steady = read_file(shipped("steady"))
        solver = {**{name: steady[name] for name in PSEUDO}, **solver}
    return path, {name: text for name, text in solver.items() if name not in texts}


def suits(found, texts):
    """Return whether the solver of an options file suits the options {name: text} of a run.

    Multigrid suits models of NGF only, because no coarse grid resolves bands of a local rheology.
    """
    if "pc_type" not in found or found.get("ts_type") not in (None, texts.get("ts_type", "beuler")):
        return False
    return found["pc_type"] == "lu" or _chosen(texts, "model").startswith("ngf")


def _chosen(texts, name):
    return texts.get(PREFIX + name) or next(
        option.default for option in RUN if option.name == name)
