"""The table of every option: name, type, default, unit, bounds, meaning, equation.

The reader, the text of ``-help`` and the table of the documentation are all
made from `TABLE`. The module imports neither PETSc nor MPI, so the closed-form
theory can use it too. Lengths are in grain diameters d, stresses in the lateral
stress |sigma_1|, times in 1/gdot0, the inverse of the target shear rate.
"""

import difflib
import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

PREFIX = "pgran_"
#: A case is a file in pgran/cases.
CASES = tuple(sorted(path.stem for path in (Path(__file__).parent / "cases").glob("*.py")
                     if path.stem != "__init__"))


class OptionError(ValueError):
    """An option is unknown, malformed, out of bounds, or clashes with another."""


@dataclass(frozen=True)
class Option:
    """One row of the table.

    ``kind`` is one of float, int, bool, str or ``floats`` (a comma-separated
    list); ``low`` and ``high`` bound numbers, exclusively where ``open_low`` or
    ``open_high`` say so; ``length`` fixes the size of a list. A default of None
    is resolved from other options or means absent, as ``meaning`` tells.
    """

    name: str
    kind: str
    default: object
    unit: str
    meaning: str
    equation: str = ""
    choices: tuple = ()
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    length: int = 0

    @property
    def allowed(self):
        """The values that are accepted, in words."""
        if self.choices:
            return " | ".join(self.choices)
        if self.kind == "bool":
            return "true | false"
        if self.kind == "str":
            return "text"
        noun = {"int": "an integer", "float": "a number"}.get(
            self.kind, f"{self.length or 'a list of'} numbers")
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'>' if self.open_low else '>='} {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"{'<' if self.open_high else '<='} {self.high:g}")
        return " ".join([noun, " and ".join(bounds)]).strip()

    def refuse(self, value):
        """Raise the `OptionError` of a value that is not allowed."""
        raise OptionError(f"-{PREFIX}{self.name} {value}: allowed is {self.allowed}")

    def parse(self, text):
        """Return the value of ``text``, checked against type and bounds."""
        if text is None:
            return None
        text = str(text).strip()
        if self.kind == "str":
            if (self.choices and text not in self.choices) or not text:
                self.refuse(text)
            return text
        if self.kind == "bool":
            meaning = {"true": True, "1": True, "yes": True, "on": True, "": True,
                       "false": False, "0": False, "no": False, "off": False}
            if text.lower() not in meaning:
                self.refuse(text)
            return meaning[text.lower()]
        try:
            if self.kind == "int":
                numbers = (int(text),)
            elif self.kind == "float":
                numbers = (float(text),)
            else:
                numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            self.refuse(text)
        for number in numbers:
            if (not math.isfinite(number) or number < self.low or number > self.high
                    or (self.open_low and number <= self.low)
                    or (self.open_high and number >= self.high)):
                self.refuse(text)
        if self.length and len(numbers) != self.length:
            self.refuse(text)
        return numbers if self.kind == "floats" else numbers[0]


def _positive(name, default, unit, meaning, equation="", **more):
    return Option(name, "float", default, unit, meaning, equation, low=0.0, open_low=True, **more)


TABLE = (
    Option("case", "str", "biaxial", "", "the problem: domain, boundary conditions, start",
           choices=CASES),
    Option("model", "str", "ngf", "", "rheology: non-local granular fluidity, local inertial, "
           "or inertial-number gradient (linear theory only)", "(2.3)-(2.8), (1.1), (5.1)",
           choices=("ngf", "li", "ig")),
    Option("law", "str", "bingham", "", "the local law mu_loc(I)", "(1.2), (1.3)",
           choices=("bingham", "jop")),
    _positive("mu_s", 0.3819, "", "static yield value of the stress ratio", "(1.2), (1.3)"),
    _positive("mu_2", 0.6435, "", "limit of the stress ratio (jop)", "(1.3)"),
    _positive("b", 0.9377, "", "slope of mu_loc at I = 0", "(1.2), (1.3)"),
    _positive("A", 0.48, "", "non-local amplitude", "(2.8)"),
    Option("phi", "float", 0.6, "", "solid volume fraction, for inertia alone", "(2.2)",
           low=0.0, high=1.0, open_low=True),
    _positive("inertial_number", 0.001, "", "target inertial number I0; it sets the plate speed",
              "(1.1)"),
    _positive("width", 40.0, "d", "width L of the specimen or cell"),
    _positive("height", None, "d", "height H of the specimen or cell; three widths unless given"),
    _positive("element_size", 2.0, "d", "side of an element; it divides width and height"),
    Option("cell_elements", "int", 16, "", "elements each way of the periodic cell", low=1),
    _positive("shear_modulus", 1000.0, "|sigma_1|", "elastic shear modulus G of the stiff Maxwell "
              "element", "D = sigma'/(2 eta) + (d sigma'/dt)/(2 G)"),
    Option("inertia", "bool", False, "", "keep phi rho_s dv/dt", "(2.2)"),
    Option("body_force", "floats", (0.0, 0.0), "|sigma_1|/d", "body force b1,b2 per volume",
           "(2.2)", length=2),
    Option("imperfection", "float", 0.99, "", "yield value of the central element over mu_s; "
           "1 leaves it out", low=0.0, open_low=True, high=1.0),
    _positive("imperfection_size", None, "d", "side of the weak square, whose lower left corner is "
              "at the centre (biaxial); one element unless given"),
    Option("imperfection_mirrored", "bool", False, "", "put the weak square to the left of the "
           "centre instead (biaxial)"),
    Option("plates_slip", "bool", True, "", "let the specimen slip along the plates; otherwise "
           "both carry it with the v1 of homogeneous flow (biaxial)"),
    Option("compression", "float", 0.10, "", "where the run ends, 1 - h/H", "h = H exp(D2 t)",
           low=0.0, high=1.0, open_low=True, open_high=True),
    Option("snapshots", "floats", None, "", "compressions at which the fields are written, each "
           "reached exactly; those beyond the end are not, and the end is written always", low=0.0,
           high=1.0, open_low=True, open_high=True),
    Option("output", "str", "results/pgran.h5", "", "result file; NAME.xdmf is written beside it, "
           "an earlier file is kept under a numbered name"),
    Option("restart", "str", None, "", "result file whose snapshot gives geometry and fields "
           "(-ts_type pseudo)"),
    Option("restart_snapshot", "int", -1, "", "which snapshot of that file; negative counts from "
           "the end"),
    Option("seed", "str", None, "", "file of a mode, as pgran.eigen writes it, that is added to "
           "homogeneous flow to start from"),
    _positive("seed_size", 1e-3, "d gdot0", "largest velocity of that mode"),
    _positive("step_error", 0.1, "", "largest departure of a step from the extrapolation of the "
              "last two states, of the velocity over its departure from homogeneous flow and of "
              "the stress deviator over mu_s P0; a step that exceeds it twice is repeated "
              "smaller, but not below a tenth of the time of elastic loading",
              "max|v - v*|/max|v - v0|, max|sigma' - sigma'*|/(mu_s P0)"),
    _positive("step_perturbation", 1e-3, "", "smallest departure from homogeneous flow that "
              "step_error resolves, over the largest velocity"),
    _positive("step_first", None, "1/gdot0", "first time step; a tenth of the time of elastic "
              "loading unless given", "mu_s P0/(10 G)"),
    _positive("step_max", 0.01, "1/gdot0", "largest time step"),
    _positive("step_min", 1e-8, "1/gdot0", "smallest time step; the run stops with an error below "
              "it"),
    Option("step_growth", "float", 1.5, "", "largest ratio of successive steps", low=1.0,
           open_low=True),
    _positive("grain_diameter", None, "m", "d in SI units, for the scales in the result file"),
    _positive("grain_density", None, "kg/m^3", "rho_s in SI units, for the scales"),
    _positive("lateral_stress", None, "Pa", "|sigma_1| in SI units, for the scales"),
    Option("progress", "str", "brief", "", "what the terminal shows: every step, some fifty lines "
           "a run, or nothing but errors", choices=("steps", "brief", "quiet")),
)
_BY_NAME = {option.name: option for option in TABLE}


class Settings(SimpleNamespace):
    """The resolved options, one attribute for each row of `TABLE`."""

    def text(self):
        """Return the options as the lines of an options file."""
        return "".join(f"-{PREFIX}{option.name} {_plain(getattr(self, option.name))}\n"
                       for option in TABLE if getattr(self, option.name) is not None)


def written(text):
    """Return ``{name: text}`` of the lines that `Settings.text` makes, for `read`."""
    return dict(line[1:].split(" ", 1) for line in text.splitlines())


def _plain(value):
    if isinstance(value, tuple):
        return ",".join(f"{number!r}" for number in value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def read(given):
    """Return the `Settings` for ``given``, a mapping of names to texts.

    Names carry the prefix ``pgran_`` without a dash; others are left to PETSc.
    Raises `OptionError` for an unknown name, a value out of bounds, or values
    that contradict each other.
    """
    values = {option.name: option.default for option in TABLE}
    for key, text in given.items():
        if not key.startswith(PREFIX):
            continue
        name = key[len(PREFIX):]
        if name not in _BY_NAME:
            near = difflib.get_close_matches(name, _BY_NAME, n=3)
            hint = "did you mean " + " or ".join(f"-{PREFIX}{n}" for n in near) + "?" \
                if near else "-help lists the options"
            raise OptionError(f"-{key} {text}: no such option; {hint}")
        values[name] = _BY_NAME[name].parse("" if text is None else text)
    settings = Settings(**values)
    _resolve(settings)
    return settings


def _resolve(settings):
    """Fill in the defaults that depend on other options and check what spans several."""
    if settings.height is None:
        settings.height = 3.0 * settings.width
    if settings.law == "jop" and settings.mu_2 <= settings.mu_s:
        raise OptionError(f"-pgran_mu_2 {settings.mu_2}: must exceed "
                          f"-pgran_mu_s {settings.mu_s} with -pgran_law jop")
    reached = {c for c in settings.snapshots or () if c < settings.compression}
    settings.snapshots = (*sorted(reached), settings.compression)
    if settings.step_first and settings.step_first < settings.step_min:
        raise OptionError(f"-pgran_step_first {settings.step_first}: must not lie below "
                          f"-pgran_step_min {settings.step_min}")
    if settings.step_min >= settings.step_max:
        raise OptionError(f"-pgran_step_min {settings.step_min}: must lie below "
                          f"-pgran_step_max {settings.step_max}")


def elements_along(name, size, element_size):
    """Return how many elements of ``element_size`` make ``size``; both in d.

    Raises `OptionError`, naming the option ``name``, where they do not divide.
    """
    count = round(size / element_size)
    if count < 1 or abs(count * element_size - size) > 1e-9 * size:
        raise OptionError(f"-pgran_{name} {size:g}: must be a whole multiple of "
                          f"-pgran_element_size {element_size:g}")
    return count


def help_text():
    """Return the table as the text that ``-help`` prints."""
    lines = []
    for option in TABLE:
        default = "none" if option.default is None else _plain(option.default)
        unit = f" [{option.unit}]" if option.unit else ""
        equation = f"  {option.equation}" if option.equation else ""
        lines.append(f"  -{PREFIX}{option.name} <{default}>{unit}: {option.meaning}{equation}\n"
                     f"      allowed: {option.allowed}")
    return "\n".join(lines)


def markdown_table():
    """Return the table in Markdown, as the README shows it."""
    def cell(text):
        return str(text).replace("|", "\\|")

    rows = ["| option | default | unit | allowed | meaning | equation |",
            "|---|---|---|---|---|---|"]
    for option in TABLE:
        default = "" if option.default is None else _plain(option.default)
        rows.append("| " + " | ".join(cell(text) for text in (
            f"`-{PREFIX}{option.name}`", default, option.unit, option.allowed,
            option.meaning, option.equation)) + " |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(markdown_table(), end="")
