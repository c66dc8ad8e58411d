"""Options: what one row of a table is, how a table is read, and the rows that every run has.

The rows of a run are `RUN` and those that its case, law and model bring along. The reader, the
text of ``-help`` and the tables of the documentation are all made from these rows. The module
needs neither PETSc nor MPI. Lengths are in grain diameters d, stresses in the reference stress of
the case, and times in 1/gdot0, the inverse of its reference shear rate.
"""

import difflib
import functools
import importlib
import importlib.machinery
import importlib.util
import math
import os
import pkgutil
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

PREFIX = "pgran_"


class OptionError(ValueError):
    """The command line or an options file cannot be read as it stands."""

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
        The value that was given, or None where it is not known.
    reason : str
        What is wrong or allowed. It names other parameters as ``@name``.
    prefix : str
        What the option's name begins with: ``pgran_``, or nothing for an option of PETSc or of
        one command.
    """

    def __init__(self, name, value, reason, prefix=PREFIX):
        super().__init__(f"{_named(name, value)}: {reason.replace('@', '')}")
        self.name, self.value, self.reason, self.prefix = name, value, reason, prefix

    def as_option(self):
        """Return the message with the names that the options have on the command line."""
        return f"-{self.prefix}{_named(self.name, self.value)}: {_spelled(self.reason)}"


class Interrupted(Exception):
    """A run was asked to stop before its end; the message names parameters as `SolutionError`'s."""

    def as_option(self):
        """Return the message with the names that the options have on the command line."""
        return _spelled(str(self))


class SolutionError(RuntimeError):
    """A run cannot go on; the message names parameters as ``@name``, and PETSc's as ``@@name``."""

    def as_option(self):
        """Return the message with the names that the options have on the command line."""
        return _spelled(str(self))


def _named(name, value):
    return name if value is None else f"{name} {value}"


def _spelled(text):
    return text.replace("@@", "-").replace("@", f"-{PREFIX}")


@dataclass(frozen=True)
class Option:
    """One row of a table of options.

    Attributes
    ----------
    name : str
        Name without prefix.
    kind : str
        float, int, bool, str, flag (a bool that takes no value), floats or ints
        (comma-separated lists).
    default : object
        None where the value is absent, or follows from other options as ``meaning`` tells.
    unit, meaning, equation : str
        Documentation.
    choices : tuple of str
        The values that are allowed, if only these are.
    low, high : float
        Bounds of numbers, exclusive where ``open_low`` or ``open_high`` say so.
    length : int
        Size of a list, 0 for any.
    shared : tuple of str
        The starts whose file must have been made with the same value: restart, seed.
    prefix : str
        What the name on the command line begins with.
    words : str
        What is accepted, where the other attributes do not say it.
    needs : str
        The option without which this one means nothing.
    suffix : str
        What the name of a file must end in.
    changeable : bool
        Whether a run that goes on from a checkpoint may change the value.
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
    shared: tuple = ()
    prefix: str = PREFIX
    words: str = ""
    needs: str = ""
    suffix: str = ""
    changeable: bool = False

    @property
    def allowed(self):
        """The values that are accepted, in words."""
        if self.words:
            return self.words
        if self.choices:
            return " | ".join(self.choices)
        if self.kind in ("bool", "flag"):
            return "true | false"
        if self.kind == "str":
            return f"a file name that ends in {self.suffix}" if self.suffix else "text"
        noun = {"int": "an integer", "float": "a number"}.get(self.kind)
        if noun is None:
            things = "integers" if self.kind == "ints" else "numbers"
            noun = f"{self.length or 'a list of'} {things}"
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'>' if self.open_low else '>='} {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"{'<' if self.open_high else '<='} {self.high:g}")
        return " ".join([noun, " and ".join(bounds)]).strip()

    def refuse(self, value, reason=None):
        """Raise the `ParameterError` of a value that is not allowed."""
        raise ParameterError(self.name, value, reason or f"allowed is {self.allowed}", self.prefix)

    def parse(self, text):
        """Return the value of ``text``, checked against kind and bounds.

        Raises
        ------
        ParameterError
            If the text is not a value of this option.
        """
        text = str(text).strip()
        if self.kind == "str":
            if (self.choices and text not in self.choices) or not text \
                    or not text.endswith(self.suffix):
                self.refuse(text)
            return text
        if self.kind in ("bool", "flag"):
            meaning = {"true": True, "1": True, "yes": True, "on": True, "": True,
                       "false": False, "0": False, "no": False, "off": False}
            if text.lower() not in meaning:
                self.refuse(text)
            return meaning[text.lower()]
        number = int if self.kind in ("int", "ints") else float
        try:
            numbers = tuple(number(part) for part in (
                text.split(",") if self.kind in ("floats", "ints") else [text]))
        except ValueError:
            self.refuse(text)
        if not all(self._within(number) for number in numbers):
            self.refuse(text)
        if self.length and len(numbers) != self.length:
            self.refuse(text)
        return numbers if self.kind in ("floats", "ints") else numbers[0]

    def _within(self, number):
        return (math.isfinite(number) and self.low <= number <= self.high
                and not (self.open_low and number == self.low)
                and not (self.open_high and number == self.high))


def positive(name, default, unit, meaning, equation="", **more):
    """Return the row of a number greater than zero."""
    return Option(name, "float", default, unit, meaning, equation, low=0.0, open_low=True, **more)


def parts_of(path):
    """Return the names of the modules in a package's path, (n,) strings, and how to name others."""
    names = sorted(module.name for module in pkgutil.iter_modules(path)
                   if not module.name.startswith("_"))
    return *names, "package.module:Class", "path/to/file.py:Class"


def _part(name, default, folder, meaning, equation=""):
    """The row that chooses a part of the problem from the modules of a folder."""
    path = [str(Path(__file__).parent.joinpath(*folder.split(".")))]
    return Option(name, "str", default, "", meaning, equation, shared=BOTH,
                  words=" | ".join(parts_of(path)))


#: A restart, and a mode that seeds a run, must have been made with the same value.
BOTH = "restart", "mode_file"

#: The rows that every run has.
RUN = (
    _part("case", "biaxial", "cases", "the flow: domain, walls, loads, units and start"),
    _part("model", "ngf", "material.models", "the rheology: ngf is non-local granular fluidity, "
          "ngf_primitive its dynamic form, li the local inertial one, ig the inertial-number "
          "gradient, which only the linear theory knows", "(2.3)-(2.8), (1.1), (5.1)"),
    _part("law", "bingham", "material.laws", "the local law mu_loc(I)", "(1.2), (1.3)"),
    Option("phi", "float", 0.6, "", "solid volume fraction; it matters only with inertia", "(2.2)",
           low=0.0, high=1.0, open_low=True, shared=("mode_file",)),
    positive("inertial_number", 1e-3, "", "inertial number I0 of the reference flow; it sets how "
             "fast the flow is driven", "(1.1)", shared=BOTH),
    positive("shear_modulus", 1000.0, "stress", "elastic shear modulus G of the stiff Maxwell "
             "element", "D = sigma'/(2 eta) + (d sigma'/dt)/(2 G)"),
    Option("inertia", "bool", False, "", "keep phi rho_s dv/dt", "(2.2)"),
    Option("body_force", "floats", (0.0, 0.0), "stress/d", "body force b1,b2 per volume", "(2.2)",
           length=2, shared=("restart",)),
    Option("output", "str", "results/pgran.h5", "", "result file; NAME.xdmf and the snapshots "
           "are written beside it, and an earlier file is kept under a numbered name",
           suffix=".h5", changeable=True),
    Option("restart", "str", None, "", "result file from which to start: with -ts_type beuler the "
           "run goes on from its newest good checkpoint, with -ts_type pseudo one of its snapshots "
           "gives geometry and fields, and pgran.eigen finds the spectrum about a snapshot",
           changeable=True),
    Option("restart_snapshot", "int", -1, "", "which snapshot of that file, with -ts_type pseudo; "
           "a negative number counts from the end", needs="restart", changeable=True),
    Option("checkpoint_steps", "int", None, "", "write a checkpoint after this many steps; by time "
           "unless given", low=1, changeable=True),
    positive("checkpoint_minutes", 10.0, "min", "write a checkpoint after this many minutes; one "
             "is also written at the end of a run, and when it is stopped", changeable=True),
    Option("picture_every", "int", None, "", "draw the inertial number after each of so many "
           "steps, NAME_step0040.png and so on; needs matplotlib", low=1, changeable=True),
    Option("mode_file", "str", None, "", "file of a mode, as pgran.eigen writes it; the run starts from "
           "the flow that the mode was found about, plus the mode: the reference flow, or a "
           "snapshot of a fixed mesh"),
    positive("mode_amplitude", 1e-3, "d gdot0", "largest velocity of that mode",
             needs="mode_file"),
    positive("step_error", 0.25, "", "largest departure of a step from the extrapolation of the "
             "last two states: that of the velocity is taken relative to its departure from the "
             "reference flow, that of the stress deviator relative to the yield stress; a step "
             "that exceeds it twice is repeated smaller, but not below a tenth of the time of "
             "elastic loading; until a band has formed also the largest square of r dt, where r is "
             "the rate at which changes of the velocity grow",
             "max|v - v*|/max|v - v0|, max|sigma' - sigma'*|/(mu_s P0), (r dt)^2",
             changeable=True),
    positive("step_min_deviation", 1e-3, "", "smallest departure from the reference flow that "
             "step_error resolves, relative to the largest velocity", changeable=True),
    positive("step_first", None, "1/gdot0", "first time step; a tenth of the time of elastic "
             "loading unless given", "mu_s P0/(10 G)", changeable=True),
    positive("step_max", 0.01, "1/gdot0", "largest time step", changeable=True),
    positive("step_min", 1e-8, "1/gdot0", "smallest time step; the run stops with an error below "
             "it", changeable=True),
    Option("step_growth", "float", 1.5, "", "largest ratio of successive steps", low=1.0,
           open_low=True, changeable=True),
    Option("tolerance_full_deviation", "float", 0.0, "", "departure from the reference flow, over "
           "its size, from which on -snes_atol holds; below it the tolerance of Newton's method is "
           "smaller in proportion, so that what it leaves stays small against what grows; 0 leaves "
           "it as it is", "max|v - v0|/max|v|", low=0.0, changeable=True),
    positive("tolerance_min_factor", 1e-3, "", "smallest share of -snes_atol that this comes to",
             changeable=True),
    Option("chord", "bool", True, "", "Newton's method takes the chord of F in place of its "
           "tangent near the double root of the fluidity equation", changeable=True),
    Option("coarse_correction", "bool", False, "", "every linear system is first solved on the "
           "coarsest grid that resolves the growing waves, for all fields together; for specimens "
           "much wider than a band", changeable=True),
    positive("steady_time", 1e3, "1/gdot0", "steady flow, with -ts_type pseudo and in spectra "
             "about a snapshot, may deform elastically within this time; it makes the material "
             "that rests nearly rigid", "theta = 1/(G T)", changeable=True),
    positive("grain_diameter", None, "m", "d in SI units, for the scales in the result file"),
    positive("grain_density", None, "kg/m^3", "rho_s in SI units, for the scales"),
    Option("progress", "str", "brief", "", "what the terminal shows: every step, some fifty lines "
           "a run, or only errors", choices=("steps", "brief", "quiet"), changeable=True),
)


class Parameters(SimpleNamespace):
    """The resolved options: one attribute for each row.

    `options` are the `Option`s themselves, and `part` gives the classes of case, law and model.
    """

    def __init__(self, rows, parts, **values):
        super().__init__(_rows=tuple(rows), _parts=dict(parts), **values)

    @property
    def options(self):
        """The rows of the table that these parameters were read by."""
        return self._rows

    def part(self, name):
        """Return the class of the case, law or model: ``name`` says which."""
        return self._parts[name]

    def replace(self, **changes):
        """Return a copy with some values changed. The changed values are not checked."""
        values = {row.name: getattr(self, row.name) for row in self._rows}
        return Parameters(self._rows, self._parts, **{**values, **changes})

    def text(self):
        """Return the parameters as the lines of an options file."""
        return "".join(f"-{row.prefix}{row.name} {plain(getattr(self, row.name))}\n"
                       for row in self._rows if getattr(self, row.name) is not None)


def plain(value):
    """Return a value as it is written in an options file."""
    if isinstance(value, tuple):
        return ",".join(f"{number!r}" for number in value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def written(text):
    """Return ``{name: text}`` of the lines that `Parameters.text` makes."""
    return dict(line[1:].split(" ", 1) for line in text.splitlines())


@dataclass(frozen=True)
class Component:
    """A part of a problem that one option chooses: a case, a law or a model.

    It is a class that derives from ``base``. The option names it as a module of ``package``, as
    ``package.module:Class`` or as ``path/to/file.py:Class``.
    """

    name: str
    package: str
    base: type

    @property
    def names(self):
        """The names of those that pgran has, (n,) strings."""
        return parts_of(importlib.import_module(self.package).__path__)[:-2]

    def load(self, text):
        """Return the class that ``text`` names.

        Raises
        ------
        ParameterError
            If there is none, or if it lacks what its base class asks for.
        """
        def refuse(reason):
            raise ParameterError(self.name, text, reason)

        target, _, wanted = text.rpartition(":")
        if not target and text not in self.names:
            refuse("allowed is " + " | ".join(
                parts_of(importlib.import_module(self.package).__path__)))
        try:
            module = _module(target, _changed(target)) if target else importlib.import_module(
                f"{self.package}.{text}")
        except (Exception, SystemExit) as problem:  # a user's file may fail in any way
            refuse(f"{target} cannot be imported: {type(problem).__name__}: "
                   f"{str(problem).splitlines()[0] if str(problem) else 'no reason given'}")
        own = {name: value for name, value in vars(module).items()
               if isinstance(value, type) and issubclass(value, self.base)
               and value.__module__ == module.__name__}
        found = getattr(module, wanted, None) if target else next(iter(own.values()))
        if found is None:
            refuse(f"{target} has no class {wanted}; it has {', '.join(own) or 'none'}")
        if not (isinstance(found, type) and issubclass(found, self.base)):
            refuse(f"{wanted} is not a subclass of {self.base.__module__}.{self.base.__name__}")
        if missing := sorted(found.__abstractmethods__):
            refuse(f"{wanted} misses {', '.join(missing)}")
        if not all(isinstance(row, Option) for row in found.options):
            refuse(f"options of {wanted} must be a tuple of pgran.options.Option")
        return found


def _changed(target):
    """When a file was changed last, ns, so that it is read again; None for a dotted name."""
    return os.stat(target).st_mtime_ns if os.path.isfile(target) else None


class _SourceLoader(importlib.machinery.SourceFileLoader):
    """Reads a user's file as it is, and neither reads nor writes bytecode beside it."""

    def get_code(self, fullname):
        """Return the compiled source."""
        return self.source_to_code(self.get_data(self.path), self.path)


@functools.cache
def _module(target, changed):
    """Import a module by its dotted name, or from a file that was ``changed`` then."""
    if not target.endswith(".py"):
        return importlib.import_module(target)
    path = Path(target)
    if not path.is_file():
        raise FileNotFoundError("there is no such file")
    name = f"pgran_user_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_SourceLoader(name, str(path)))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # so that dataclasses in the file find their module
    spec.loader.exec_module(module)
    return module


def table(parts):
    """Return the rows of a run with these parts, ``{name: Option}``.

    A row of a case, law or model takes the place of the row of `RUN` that has its name.
    """
    rows = {row.name: row for row in RUN}
    for part in parts.values():
        rows.update((row.name, row) for row in part.options)
    return rows


def read(given, kinds, stored=False):
    """Return the resolved `Parameters`.

    Parameters
    ----------
    given : dict
        Texts by name. Names carry the prefix ``pgran_``; others are left to PETSc.
    kinds : iterable of Component
        Case, law and model. `pgran.cases.read` passes these.
    stored : bool
        Whether the options come from a result file: options of other parts are then left out.

    Raises
    ------
    OptionError
        If a name is unknown, or belongs to another case, law or model.
    ParameterError
        If a value is not allowed, or contradicts another one.
    """
    texts = {key[len(PREFIX):]: "" if text is None else text for key, text in given.items()
             if key.startswith(PREFIX)}
    defaults = {row.name: row.default for row in RUN}
    parts = {kind.name: kind.load(texts.get(kind.name, defaults[kind.name])) for kind in kinds}
    rows = table(parts)
    values = {name: row.default for name, row in rows.items()}
    for name, text in texts.items():
        if name in rows:
            values[name] = rows[name].parse(text)
            continue
        owners = _owners(name, kinds)
        if not owners:
            raise OptionError(f"-{PREFIX}{name} {text}: no such option; {hint(name, rows)}")
        if not stored:
            raise OptionError(f"-{PREFIX}{name} {text}: this option belongs to "
                              f"{' and '.join(owners)}, which this run does not use")
    parameters = Parameters(rows.values(), parts, **values)
    for part in parts.values():
        part.resolve(parameters, {name for name in texts if name in rows})
    for row in rows.values():
        value = getattr(parameters, row.name)
        if row.needs and value != row.default and getattr(parameters, row.needs) is None:
            raise ParameterError(row.name, value, f"means nothing without @{row.needs}")
    if parameters.step_first and parameters.step_first < parameters.step_min:
        raise ParameterError("step_first", parameters.step_first,
                             f"must not lie below @step_min {parameters.step_min}")
    if parameters.step_min >= parameters.step_max:
        raise ParameterError("step_min", parameters.step_min,
                             f"must lie below @step_max {parameters.step_max}")
    return parameters


def _owners(name, kinds):
    """The parts that have an option, as ``-pgran_case biaxial``."""
    return [f"-{PREFIX}{kind.name} {part}" for kind in kinds for part in kind.names
            if any(row.name == name for row in kind.load(part).options)]


def hint(name, known, prefix=PREFIX):
    """Return what an unknown option may have been meant to be, in words."""
    near = difflib.get_close_matches(name, list(known), n=3)
    if not near:
        return "-help lists the options"
    return "did you mean " + " or ".join(f"-{prefix}{other}" for other in near) + "?"


def not_among(name, allowed):
    """Return that ``name`` is not one of the names that are ``allowed``, in words for a message.

    It names the similar ones, or all of them if none is similar.
    """
    near = difflib.get_close_matches(name, list(allowed), n=3)
    return f"did you mean {' or '.join(near)}?" if near else "allowed are " + ", ".join(allowed)


def help_text(rows):
    """Return rows as the text that ``-help`` prints."""
    lines = []
    for row in rows:
        default = "none" if row.default is None else plain(row.default)
        unit = f" [{row.unit}]" if row.unit else ""
        equation = f"  {row.equation}" if row.equation else ""
        lines.append(f"  -{row.prefix}{row.name} <{default}>{unit}: {row.meaning}{equation}\n"
                     f"      allowed: {row.allowed}")
    return "\n".join(lines)


def markdown_table(rows):
    """Return rows as a table in Markdown."""
    def cell(text):
        return str(text).replace("|", "\\|")

    lines = ["| option | default | unit | allowed | meaning | equation |",
             "|---|---|---|---|---|---|"]
    for row in rows:
        default = "" if row.default is None else plain(row.default)
        lines.append("| " + " | ".join(cell(text) for text in (
            f"`-{row.prefix}{row.name}`", default, row.unit, row.allowed, row.meaning,
            row.equation)) + " |")
    return "\n".join(lines) + "\n"


def markdown(kinds):
    """Return all tables in Markdown: every run's, and those of each case, law and model."""
    titles = {"case": "Case", "law": "Law", "model": "Model"}
    parts = [("Every run", RUN)] + [
        (f"{titles[kind.name]} `{name}`", kind.load(name).options)
        for kind in kinds for name in kind.names]
    return "\n".join(f"## {title}\n\n{markdown_table(rows) if rows else 'No options of its own.'}"
                     for title, rows in parts).rstrip("\n") + "\n"
