"""The options of a run, and how they are resolved."""

from pathlib import Path
from types import SimpleNamespace

from .definition import Option, markdown_table, plain, positive
from .errors import PREFIX, OptionError, ParameterError, unknown_option
from .loading import allowed_names, modules_of

#: Values that a restart and a mode file must have in common with the run that uses them.
BOTH = "restart", "mode_file"

#: Options that were renamed after release 0.2, {old: new}; None if the option was removed.
RENAMED = {"seed": "mode_file", "seed_size": "mode_amplitude",
           "step_perturbation": "step_min_deviation",
           "tolerance_perturbation": "tolerance_full_deviation",
           "tolerance_least": "tolerance_min_factor", "chord": "secant", "assembly": None}


def _component(name, default, folder, meaning, equation=""):
    """Return the `Option` that chooses a class from the modules of a folder."""
    path = [str(Path(__file__).parents[1].joinpath(*folder.split(".")))]
    return Option(name, "str", default, "", meaning, equation, shared=BOTH,
                  words=allowed_names(modules_of(path)))


#: Subjects of the options in `RUN` by the first option of each.
GROUPS = {"case": "problem", "phi": "material and loading", "output": "output, restart and start",
          "step_error": "time stepping", "tolerance_full_deviation": "solver",
          "grain_diameter": "units and terminal"}
#: The options that every run has.
RUN = (
    _component("case", "biaxial", "cases", "flow problem: domain, boundary conditions, loads, "
               "units and initial state"),
    _component("model", "ngf", "material.models", "rheological model: non-local granular fluidity "
               "(ngf), its dynamic form (ngf_primitive), local inertial rheology (li), or "
               "inertial-number gradient (ig, linear theory only)", "(2.3)-(2.8), (1.1), (5.1)"),
    _component("law", "bingham", "material.laws", "local flow law mu_loc(I)", "(1.2), (1.3)"),
    Option("phi", "float", 0.6, "", "solid volume fraction; it has an effect only with inertia",
           "(2.2)", low=0.0, high=1.0, open_low=True, shared=("mode_file",)),
    positive("inertial_number", 1e-3, "", "inertial number I0 of the reference flow, which sets "
             "the rate of deformation", "(1.1)", shared=BOTH),
    positive("shear_modulus", 1000.0, "stress", "elastic shear modulus G of the stiff Maxwell "
             "element", "D = sigma'/(2 eta) + (d sigma'/dt)/(2 G)"),
    Option("inertia", "bool", False, "", "include the inertial term phi rho_s dv/dt", "(2.2)"),
    Option("body_force", "floats", (0.0, 0.0), "stress/d", "body force b1,b2 per volume", "(2.2)",
           length=2, shared=("restart",)),
    Option("output", "str", "results/pgran.h5", "", "result file; an existing file is kept under a "
           "numbered name", suffix=".h5", changeable=True),
    Option("restart", "str", None, "", "result file to start from: its newest valid checkpoint, or "
           "with -ts_type pseudo and in pgran.eigen a snapshot", changeable=True),
    Option("restart_snapshot", "int", -1, "", "number of the snapshot, with -ts_type pseudo; "
           "negative numbers count from the end", needs="restart", changeable=True),
    Option("checkpoint_steps", "int", None, "", "number of steps between checkpoints; if unset, "
           "checkpoint_minutes applies", low=1, changeable=True),
    positive("checkpoint_minutes", 10.0, "min", "time between checkpoints; one is also written at "
             "the end of a run", changeable=True),
    Option("picture_every", "int", None, "", "number of steps between pictures of the inertial "
           "number, NAME_step0040.png etc.; requires matplotlib", low=1, changeable=True),
    Option("mode_file", "str", None, "", "mode computed by pgran.eigen; the run starts from the "
           "base flow of this mode plus the mode"),
    positive("mode_amplitude", 1e-3, "d gdot0", "largest velocity of this mode", needs="mode_file"),
    positive("step_error", 0.25, "", "tolerance for the error estimate of a time step, which "
             "compares velocity v and stress deviator sigma' with their extrapolation v*, sigma'*; "
             "v0 is the reference flow. A step with more than twice this error is repeated. Until "
             "a band has formed, the tolerance also limits (r dt)^2 at a growth rate r",
             "max|v - v*|/max|v - v0|, max|sigma' - sigma'*|/(mu_s P0), (r dt)^2",
             changeable=True),
    positive("step_min_deviation", 1e-3, "", "lower bound of max|v - v0| in the error estimate, "
             "relative to the largest velocity", changeable=True),
    positive("step_first", None, "1/gdot0", "first time step; if unset, a tenth of the elastic "
             "loading time", "mu_s P0/(10 G)", changeable=True),
    positive("step_max", 0.01, "1/gdot0", "largest time step", changeable=True),
    positive("step_min", 1e-8, "1/gdot0", "time step below which the run fails", changeable=True),
    Option("step_growth", "float", 1.5, "", "largest ratio of successive time steps", low=1.0,
           open_low=True, changeable=True),
    Option("tolerance_full_deviation", "float", 0.0, "", "relative deviation from the reference "
           "flow below which -snes_atol is reduced in proportion, so that growing perturbations "
           "are resolved; 0: never", "max|v - v0|/max|v|", low=0.0, changeable=True),
    positive("tolerance_min_factor", 1e-3, "", "smallest factor for this reduction of -snes_atol",
             changeable=True),
    Option("secant", "bool", True, "", "use a secant instead of the tangent in Newton's method "
           "near the double root of the fluidity equation", changeable=True),
    Option("coarse_correction", "bool", False, "", "precede each multigrid cycle by a solution on "
           "a coarse grid; for specimens much wider than a band", changeable=True),
    positive("steady_time", 1e3, "1/gdot0", "relaxation time T of elastic deformation in steady "
             "flow and its spectra; material at rest is nearly rigid", "theta = 1/(G T)",
             changeable=True),
    positive("grain_diameter", None, "m", "d in SI units, for the scales in the result file"),
    positive("grain_density", None, "kg/m^3", "rho_s in SI units, for the scales"),
    Option("progress", "str", "brief", "", "terminal output: every step (steps), about fifty lines "
           "per run (brief), or only errors (quiet)", choices=("steps", "brief", "quiet"),
           changeable=True),
)


class Parameters(SimpleNamespace):
    """The resolved options; each option is an attribute, and ``options`` are the `Option`s."""

    def __init__(self, options, parts, **values):
        super().__init__(options=tuple(options), _parts=dict(parts), **values)

    def part(self, name):
        """Return the class of the component ``name``: case, law or model."""
        return self._parts[name]

    def replace(self, **changes):
        """Return a copy with some values changed. The new values are not checked."""
        values = {option.name: getattr(self, option.name) for option in self.options}
        return Parameters(self.options, self._parts, **{**values, **changes})

    def text(self):
        """Return the parameters as the lines of an options file."""
        return "".join(f"-{option.prefix}{option.name} {plain(getattr(self, option.name))}\n"
                       for option in self.options if getattr(self, option.name) is not None)


def written(text):
    """Return {name: text} of lines from `Parameters.text`, with the present names."""
    texts = dict(line[1:].split(" ", 1) for line in text.splitlines())
    if f"{PREFIX}step_perturbation" not in texts:
        return texts  # not from release 0.2
    short = {name[len(PREFIX):]: value for name, value in texts.items()}
    return {PREFIX + name: value for name, value in _renamed(short).items()}


def _renamed(texts, known=()):
    """Return {name: text} with the names of release 0.2 replaced, except ``known`` names."""
    new = {name: name if name in known else RENAMED.get(name, name) for name in texts}
    return {new[name]: text for name, text in texts.items() if new[name]}


def table(parts):
    """Return {name: Option} of a run with these components, whose options replace `RUN`."""
    options = [*RUN, *(option for part in parts.values() for option in part.options)]
    return {option.name: option for option in options}


def read(texts, kinds, stored=False):
    """Return the resolved `Parameters` of {name: text}; names without the prefix are ignored.

    ``kinds`` are the `Component` of case, law and model. If the texts were ``stored`` in a result
    file, names of release 0.2 are accepted, and options of other components are ignored. Otherwise
    these raise `OptionError`, as unknown names do. Invalid values raise `ParameterError`.
    """
    texts = {name[len(PREFIX):]: text or "" for name, text in texts.items()
             if name.startswith(PREFIX)}
    defaults = {option.name: option.default for option in RUN}
    parts = {kind.name: kind.load(texts.get(kind.name, defaults[kind.name])) for kind in kinds}
    options = table(parts)
    if stored:
        texts = _renamed(texts, options)
    values = {name: option.default for name, option in options.items()}
    for name, text in texts.items():
        if name in options:
            values[name] = options[name].parse(text)
        elif not (owners := _owners(name, kinds)):
            if name not in RENAMED:
                raise unknown_option(name, options)
            cure = f"it is now -{PREFIX}{RENAMED[name]}" if RENAMED[name] else "it was removed"
            raise OptionError(f"unknown option -{PREFIX}{name}; {cure}")
        elif not stored:
            raise OptionError(f"-{PREFIX}{name} {text}: this option belongs to "
                              f"{' and '.join(owners)}, which this run does not use")
    parameters = Parameters(options.values(), parts, **values)
    for part in parts.values():
        part.resolve(parameters, set(texts) & set(options))
    _check_combinations(parameters)
    return parameters


def _owners(name, kinds):
    """Return the components that have an option, as ``-pgran_case biaxial``."""
    return [f"-{PREFIX}{kind.name} {part}" for kind in kinds for part in kind.names
            if any(option.name == name for option in kind.load(part).options)]


def _check_combinations(parameters):
    """Raise `ParameterError` if options contradict each other."""
    for option in parameters.options:
        value = getattr(parameters, option.name)
        if option.needs and value != option.default and getattr(parameters, option.needs) is None:
            raise ParameterError(option.name, value, f"requires @{option.needs}")
    first, low, high = (getattr(parameters, f"step_{name}") for name in ("first", "min", "max"))
    if first and first < low:
        raise ParameterError("step_first", first, f"must be >= @step_min {low}")
    if low >= high:
        raise ParameterError("step_min", low, f"must be < @step_max {high}")


def markdown(kinds):
    """Return the tables of all options in Markdown: of every run by subject, then by owner."""
    tables, subject = {}, ""
    for option in RUN:
        subject = GROUPS.get(option.name, subject)
        tables.setdefault(f"Every run: {subject}", []).append(option)
    for kind in kinds:
        owners = {}
        for name in kind.names:
            for option in kind.load(name).options:
                owners.setdefault(option, []).append(f"`{name}`")
        for option, having in sorted(owners.items(), key=lambda item: -len(item[1])):
            tables.setdefault(f"{kind.name.title()} {', '.join(having)}", []).append(option)
    return "\n".join(f"## {title}\n\n{markdown_table(options)}"
                     for title, options in tables.items()).rstrip("\n") + "\n"
