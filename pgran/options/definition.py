"""The description of an option, and tables of options for ``-help`` and the documentation."""

import math
from dataclasses import dataclass

from .errors import PREFIX, ParameterError

#: Texts of truth values.
BOOLS = {"true": True, "1": True, "yes": True, "on": True, "": True,
         "false": False, "0": False, "no": False, "off": False}


@dataclass(frozen=True)
class Option:
    """One option: its name without prefix, its type, its allowed values and its documentation."""

    name: str
    kind: str  #: float, int, bool, str, flag (a bool without a value), floats or ints (lists)
    default: object  #: None if the option is unset or follows from other options
    unit: str
    meaning: str
    equation: str = ""
    choices: tuple = ()
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False  #: whether the bound is excluded
    open_high: bool = False
    length: int = 0  #: of a list; 0 for any length
    shared: tuple = ()  #: input files that need the same value: restart, mode_file
    prefix: str = PREFIX
    words: str = ""  #: allowed values, if the other attributes do not describe them
    needs: str = ""  #: another option, without which this one has no effect
    suffix: str = ""  #: required end of a file name
    changeable: bool = False  #: whether a restart may change the value

    @property
    def allowed(self):
        """Description of the allowed values."""
        if self.words or self.choices:
            return self.words or " | ".join(self.choices)
        if self.kind in ("bool", "flag"):
            return "true | false"
        if self.kind == "str":
            return f"a file name that ends in {self.suffix}" if self.suffix else "text"
        several = self.length or "a list of"
        noun = {"int": "an integer", "float": "a number", "ints": f"{several} integers",
                "floats": f"{several} numbers"}[self.kind]
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'>' if self.open_low else '>='} {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"{'<' if self.open_high else '<='} {self.high:g}")
        return f"{noun} {' and '.join(bounds)}".strip()

    def parse(self, text):
        """Return the value of ``text``, or raise `ParameterError` if it is not allowed."""
        text = str(text).strip()
        number, listed = int if self.kind in ("int", "ints") else float, self.kind.endswith("s")
        try:
            if self.kind in ("bool", "flag"):
                return BOOLS[text.lower()]
            if self.kind == "str":
                if text and text.endswith(self.suffix) and text in (self.choices or (text,)):
                    return text
            else:
                numbers = tuple(map(number, text.split(",") if listed else [text]))
                if all(map(self._within, numbers)) and self.length in (0, len(numbers)):
                    return numbers if listed else numbers[0]
        except (KeyError, ValueError, OverflowError):
            pass
        raise ParameterError(self.name, text, ("expected one of: " if "|" in self.allowed else
                                               "must be ") + self.allowed, self.prefix)

    def _within(self, number):
        return (math.isfinite(number) and self.low <= number <= self.high
                and not (self.open_low and number == self.low)
                and not (self.open_high and number == self.high))


def positive(name, default, unit, meaning, equation="", **more):
    """Return the `Option` of a number greater than zero."""
    return Option(name, "float", default, unit, meaning, equation, low=0.0, open_low=True, **more)


def command_option(name, kind, meaning, default=None, unit="", **more):
    """Return the `Option` of one command; its name has no prefix."""
    return Option(name, kind, default, unit, meaning, prefix="", **more)


def plain(value):
    """Return a value as text, as in an options file; None is ``none``."""
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return ",".join(f"{number!r}" for number in value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def help_text(options):
    """Return options as the text of ``-help``."""
    return "\n".join(
        f"  -{option.prefix}{option.name} <{plain(option.default)}>"
        + (f" [{option.unit}]" if option.unit else "") + f": {option.meaning}"
        + (f"  {option.equation}" if option.equation else "") + f"\n      allowed: {option.allowed}"
        for option in options)


def markdown_table(options):
    """Return options as a table in Markdown."""
    lines = ["| option | default | unit | allowed | meaning | equation |",
             "|---|---|---|---|---|---|"]
    for option in options:
        default = "" if option.default is None else plain(option.default)
        cells = (f"`-{option.prefix}{option.name}`", default, option.unit, option.allowed,
                 option.meaning, option.equation)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"
