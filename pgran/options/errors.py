"""Errors that are reported to the user by the names of the options."""

import difflib

PREFIX = "pgran_"


class OptionError(ValueError):
    """The command line or an options file is invalid."""

    def as_option(self):
        """Return the message."""
        return str(self)


class ParameterError(ValueError):
    """A parameter is malformed, out of bounds, or contradicts another one.

    ``value`` is None if it is unknown. ``reason`` names other parameters as ``@name``. The prefix
    is empty for options of PETSc or of one command.
    """

    def __init__(self, name, value, reason, prefix=PREFIX):
        self.name, self.value, self.reason, self.prefix = name, value, reason, prefix
        self._label = f"{name}: " if value is None else f"{name} {value}: "
        super().__init__(self._label + reason.replace("@", ""))

    def as_option(self):
        """Return the message with names as on the command line."""
        return f"-{self.prefix}{self._label}{_with_prefix(self.reason)}"


class SolutionError(RuntimeError):
    """A run fails. Parameters are written as ``@name``, options of PETSc as ``@@name``."""

    def as_option(self):
        """Return the message with names as on the command line."""
        return _with_prefix(str(self))


class Interrupted(Exception):
    """A signal stopped a run before its end. Parameters are written as in `SolutionError`."""

    as_option = SolutionError.as_option


def _with_prefix(text):
    return text.replace("@@", "-").replace("@", f"-{PREFIX}")


def not_among(name, allowed, prefix="", otherwise=""):
    """Return which of the ``allowed`` names are similar to ``name``, else ``otherwise`` or all."""
    near = [prefix + other for other in difflib.get_close_matches(name, list(allowed))]
    if near:
        return f"did you mean {' or '.join(near)}?"
    return otherwise or f"expected {' | '.join(allowed)}"


def unknown_option(name, known, prefix=PREFIX):
    """Return the `OptionError` of an option ``-prefix name`` that is not ``known``."""
    cure = not_among(name, known, f"-{prefix}", "-help lists the options")
    return OptionError(f"unknown option -{prefix}{name}; {cure}")
