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

    Parameters
    ----------
    name : str
        Name of the parameter, without prefix.
    value : object
        Its value, or None if it is unknown.
    reason : str
        What is wrong, or what is allowed. Other parameters are written as ``@name``.
    prefix : str
        Prefix of the option: ``pgran_``, or empty for options of PETSc or of one command.
    """

    def __init__(self, name, value, reason, prefix=PREFIX):
        super().__init__(f"{_with_value(name, value)}: {reason.replace('@', '')}")
        self.name, self.value, self.reason, self.prefix = name, value, reason, prefix

    def as_option(self):
        """Return the message with names as on the command line."""
        name = f"-{self.prefix}{_with_value(self.name, self.value)}"
        return f"{name}: {_with_prefix(self.reason)}"


class Interrupted(Exception):
    """A signal stopped a run before its end. Parameters are written as in `SolutionError`."""

    def as_option(self):
        """Return the message with names as on the command line."""
        return _with_prefix(str(self))


class SolutionError(RuntimeError):
    """A run fails. Parameters are written as ``@name``, options of PETSc as ``@@name``."""

    def as_option(self):
        """Return the message with names as on the command line."""
        return _with_prefix(str(self))


def _with_value(name, value):
    return name if value is None else f"{name} {value}"


def _with_prefix(text):
    return text.replace("@@", "-").replace("@", f"-{PREFIX}")


def hint(name, known, prefix=PREFIX):
    """Return the options with a similar name as a question, or a reference to ``-help``."""
    near = difflib.get_close_matches(name, list(known), n=3)
    if not near:
        return "-help lists the options"
    return f"did you mean {' or '.join(f'-{prefix}{other}' for other in near)}?"


def not_among(name, allowed):
    """Return which of the ``allowed`` names are similar to ``name``, or all if none is similar."""
    near = difflib.get_close_matches(name, list(allowed), n=3)
    return f"did you mean {' or '.join(near)}?" if near else f"expected {' | '.join(allowed)}"
