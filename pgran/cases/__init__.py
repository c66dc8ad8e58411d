"""Cases, which are flow problems. A new case is one new file, in this package or elsewhere."""

import copyreg
from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from .. import options
from ..kinematics import PLANE
from ..material import LAWS, MODELS, Material
from ..options import BOTH, Option, ParameterError, positive

#: Relative differences below this are rounding.
ROUNDING = 1e-9
#: Maximum number of elements in one direction.
MAX_ELEMENTS = 1e9

#: Options of a case whose progress is time.
TIME = (
    positive("end_time", 1.0, "1/gdot0", "end of the run", changeable=True),
    Option("snapshots", "floats", None, "1/gdot0", "exact times at which fields are written; times "
           "after the end are ignored, and the end is always written", low=0.0, open_low=True,
           changeable=True),
    Option("rest_speed", "float", 1e-6, "d gdot0", "the run also ends when the largest velocity "
           "falls below this value; 0: never", low=0.0, changeable=True),
)


def pressure(value):
    """Return the traction of a pressure on the deformed side, for `Case.tractions`."""
    return lambda x, area: -value * area


def traction(vector):
    """Return a traction (2,) of fixed direction and size, for `Case.tractions`."""
    return lambda x, area: np.multiply.outer(vector, np.linalg.norm(area, axis=0))


class Case(ABC):
    """A flow problem: everything about a flow except how it is discretised and solved.

    A subclass must define `shape` and `coordinates`; everything else has a default. Global indices
    are integer arrays ``i``, ``j`` (n,) of Q2 nodes (two per element), corners or elements. They
    count along x1 and x2, or along the curves that `coordinates` defines, and may lie beyond the
    ends of a periodic grid. Lengths are in d, stresses in the stress unit of the case, and times in
    1/gdot0.
    """

    #: Options, which replace common ones. `TIME` is added without an option named snapshots.
    options = ()
    #: Whether the grid is periodic along i and along j.
    periodic = False, False
    #: Whether the mesh moves with the material. Otherwise the flow rotates and advects the stress,
    #: and inertia contains the convective acceleration (v.grad) v.
    moving = True
    #: Largest mean side of an element of the coarsest multigrid level, over A d: a third of the
    #: shortest growing wavelength (k A d = 0.1226).
    max_coarse_size = 17.0
    #: Largest number of elements of the coarsest level, which has priority over this size.
    max_coarse_elements = 300
    #: The `pgran.kinematics.Kinematics` of the flow.
    kinematics = PLANE
    #: Pressure of the reference flow, stress.
    pressure = 1.0
    #: Name of the stress unit, and its value in Pa or None.
    stress_unit, stress_scale = "stress", None
    #: Arguments of `pgran.theory.specimen.growth_rate`, or None if it does not apply.
    specimen = None
    #: Weight per volume (c,), stress/d.
    weight = 0.0, 0.0
    #: Source (...) of the fluidity equation as a function of points (2, ...), or None.
    fluidity_source = None
    #: Sides where g = g_loc replaces the fluidity equation. Their ends must be periodic.
    walls_of_local_fluidity = ()
    #: Sides where the pressure vanishes, and the fluidity depends on the root of the distance.
    free_surfaces = ()
    #: Why nothing flows in this case, if this is known in advance.
    why_at_rest = None
    #: Columns that `observe` adds to the history, as {name: unit}, where "stress" in a unit means
    #: ``stress_unit``; or only names, for pure numbers.
    observables = ()
    #: Name of the quantity `progress`, and of its attribute of a snapshot.
    progress_name = "time"

    def __init_subclass__(cls, **more):
        super().__init_subclass__(**more)
        if not any(option.name == "snapshots" for option in cls.options):
            cls.options = (*cls.options, *TIME)

    def __init__(self, parameters):
        self.parameters = parameters
        self.law = parameters.part("law").of(parameters)

    @classmethod
    def resolve(cls, parameters, names):
        """Complete and check ``parameters``; ``names`` are the options that the user has set."""
        parameters.snapshots = reached(parameters.snapshots, parameters.end_time)

    @classmethod
    def homogeneous(cls, parameters):
        """Return the parameters of the same flow without imperfection, for spectra."""
        return parameters

    @classmethod
    def with_wave(cls, parameters, k):
        """Return the parameters of a periodic cell for the wave vector ``k`` (2,), 1/d, or None."""
        return None

    # Units and reference flow

    @property
    def inertial_time(self):
        """sqrt(d^2 rho_s) in sqrt(stress)/gdot0."""
        return self.parameters.inertial_number

    @property
    def stress_ratio(self):
        """mu_loc of the reference flow."""
        return float(self.law.stress_ratio(np.asarray(self.parameters.inertial_number))[0])

    @property
    def fluidity(self):
        """Fluidity of the reference flow, gdot0."""
        return 1.0 / self.stress_ratio

    @cached_property
    def material(self):
        """The `pgran.material.Material` in the units of the case."""
        p = self.parameters
        return Material(self.law, p.part("model").of(p), self.inertial_time, self.pressure,
                        self.stress_ratio, p.phi, p.shear_modulus)

    def scales(self):
        """Return the SI scales that the options determine: d (m), stress (Pa), and 1/gdot0 (s)."""
        d, density = self.parameters.grain_diameter, self.parameters.grain_density
        found = {"scale_length": d, "scale_stress": self.stress_scale}
        if d and density and self.stress_scale:
            found["scale_time"] = d * np.sqrt(density / self.stress_scale) / self.inertial_time
        return {name: value for name, value in found.items() if value}

    @property
    def base_gradient(self):
        """Velocity gradient (c, dim) that is added to the gradient of the nodal velocity, gdot0."""
        return np.zeros((self.kinematics.velocities, self.kinematics.dim))

    # Mesh

    @property
    @abstractmethod
    def shape(self):
        """Number of elements along i and j, a pair of int."""

    @abstractmethod
    def coordinates(self, i, j):
        """Return the initial coordinates (2, n) of nodes, d."""

    @property
    def unknowns(self):
        """Number of unknowns: velocity and fluidity at Q2 nodes, pressure at corners."""
        shape, more = np.array(self.shape, dtype=float), 1 - np.array(self.periodic)
        nodes, corners = ((degree * shape + more).prod() for degree in (2, 1))
        fields = self.kinematics.velocities + self.material.model.has_fluidity
        return int(nodes * fields + corners)

    @property
    def closed(self):
        """Whether the grid is closed in space along i and along j, as in a ring."""
        joined = (np.abs(self.period) <= 1e-9).all(axis=1)
        return tuple((joined & self.periodic).tolist())

    @property
    def period(self):
        """Change of the initial coordinates over one period along i and j, or zero, (2, 2), d."""
        nx, ny = self.shape
        first, *last = self.coordinates(np.array([0, 2 * nx, 0]), np.array([0, 0, 2 * ny])).T
        return np.where(np.reshape(self.periodic, (2, 1)), last - first, 0.0)

    def elements_along(self, name):
        """Return the number of elements of side ``element_size`` along the length ``name``."""
        size, side = getattr(self.parameters, name), self.parameters.element_size
        if size / side > MAX_ELEMENTS:
            raise ParameterError(name, f"{size:g}", f"requires {size / side:.3g} elements of "
                                 f"@element_size {side:g}; the maximum is {MAX_ELEMENTS:g}")
        count = max(1, round(size / side))
        if abs(count * side - size) > ROUNDING * size:
            raise ParameterError(name, f"{size:g}",
                                 f"must be an integer multiple of @element_size {side:g}")
        return count

    # Conditions

    def prescribed_velocity(self, time, *index):
        """Return prescribed nodal velocities (c, n), d gdot0; NaN where free."""
        return np.full((self.kinematics.velocities, index[0].size), np.nan)

    def prescribed_fluidity(self, time, *index):
        """Return prescribed nodal fluidities (n,), gdot0; NaN where free."""
        return np.full(index[0].size, np.nan)

    def prescribed_pressure(self, time, *index):
        """Return prescribed corner pressures (n,), stress; NaN where free."""
        return np.full(index[0].size, np.nan)

    def tractions(self, time):
        """Return the loads on sides (left, right, bottom and top), {side: traction}.

        ``traction(x, area)`` returns the force (2, ...) on pieces of the deformed side at points
        ``x`` (2, ...), where ``area`` (2, ...) is the outward normal times the length.
        """
        return {}

    @property
    def body_force(self):
        """A function that returns b (c, ...) of (2.2), stress/d, at points (dim, ...), or None."""
        force = np.zeros(self.kinematics.velocities)
        for part in self.parameters.body_force, self.weight:
            force[:len(part)] += part
        if not force.any():
            return None
        return lambda x: np.reshape(force, (-1,) + (1,) * (x.ndim - 1))

    def nodes_outside(self, time, x, *index):
        """Return which nodes at ``x`` (dim, n) have left the domain, and how, or None."""
        return None

    def yield_factor(self, *index):
        """Return mu_s of elements over its nominal value, (n,)."""
        return np.ones(index[0].size)

    # Start

    def start(self, x):
        """Return the initial velocity (2, n), fluidity (n,) and pressure (n,) at points (2, n)."""
        velocity, _, pressure = self.reference(x)
        return velocity, np.zeros(x.shape[1]), pressure

    def reference(self, x):
        """Return velocity (2, n), fluidity (n,) and pressure (n,) of the reference flow.

        It is the base state of spectra and of an added mode, the initial guess for steady flow,
        and the base of the deviations in step-size control.
        """
        n = x.shape[1]
        return (np.zeros((self.kinematics.velocities, n)), np.full(n, self.fluidity),
                np.full(n, self.pressure))

    # End and observables

    def progress(self, time):
        """Return the progress of a run at a time, the quantity `progress_name`."""
        return time

    def time_of(self, progress):
        """Return the time of a given `progress`."""
        return progress

    @property
    def targets(self):
        """Times that steps end at exactly, in increasing order; the last one ends the run."""
        return [self.time_of(progress) for progress in self.parameters.snapshots]

    def label(self, time):
        """Return the progress of a run at a time as text."""
        return f"time {time:.4g}"

    def observe(self, flow):
        """Return the `observables` of a `pgran.solve.driver.AcceptedStep`, {name: number}.

        ``flow`` has ``time``, ``reaction(side)`` (2,), ``torque(side)``, ``extent(side)`` (2,) and
        ``mean_velocity(side)`` (2,). Collective.
        """
        return {}


CASES = options.Component("case", __name__, Case)
#: The components of a problem, each with its own options.
KINDS = CASES, LAWS, MODELS


def _pickled(parameters):
    """Pickle `pgran.options.Parameters` by the names of their parts, which may come from files."""
    return _unpickled, ({row.name: getattr(parameters, row.name) for row in parameters.options},)


def _unpickled(values):
    parts = {kind.name: kind.load(values[kind.name]) for kind in KINDS}
    return options.Parameters(options.table(parts).values(), parts, **values)


copyreg.pickle(options.Parameters, _pickled)


def read(texts, stored=False):
    """Return the resolved parameters of a case with its law and model, see `pgran.options.read`."""
    return options.read(texts, KINDS, stored)


def create(parameters):
    """Return the case of resolved parameters; `ParameterError` if they are inconsistent."""
    case = parameters.part("case")(parameters)
    name, shape = parameters.case, case.shape
    if not (len(shape) == 2 and all(isinstance(n, (int, np.integer)) and n > 0 for n in shape)):
        raise ParameterError("case", name, f"its shape is {shape}; must be two integers > 0")
    nodes = np.array([0, 2 * shape[0]]), np.array([0, 2 * shape[1]])
    if np.shape(case.coordinates(*nodes)) != (2, 2):
        raise ParameterError("case", name, "its coordinates must have the shape (2, n) for n nodes")
    return case


def reached(targets, end):
    """Return the ``targets`` before the ``end``, without duplicates up to rounding, and the end."""
    found = [end]
    for target in sorted(targets or (), reverse=True):
        if target < found[-1] * (1.0 - ROUNDING):
            found.append(target)
    return tuple(reversed(found))


class PureShear(Case):
    """Homogeneous pure shear in the units of section 4, the base of specimen and periodic cell.

    P0 = 1/(1 - mu_loc(I0)), g0 = 1/mu_loc(I0), v = (x1/2, -x2/2), sqrt(d^2 rho_s) = I0 sqrt(P0).
    """

    stress_unit = "|sigma_1|"
    SIZE = (positive("width", 40.0, "d", "width L of the specimen or cell", shared=BOTH),
            positive("height", None, "d", "height H of the specimen or cell; default: three widths",
                     shared=BOTH),
            positive("lateral_stress", None, "Pa", "|sigma_1| in SI units, for the scales"))

    def __init__(self, parameters):
        super().__init__(parameters)
        if not self.stress_ratio < 1.0:
            raise ParameterError(
                "inertial_number", f"{parameters.inertial_number:g}",
                f"mu_loc(I0) is {self.stress_ratio:.4g}; plane-strain compression requires a value "
                "below 1 (3.19)")

    @classmethod
    def resolve(cls, parameters, names):
        if not parameters.height:
            parameters.height = 3.0 * parameters.width

    @classmethod
    def homogeneous(cls, parameters):
        return parameters.replace(imperfection=1.0)

    @property
    def inertial_time(self):
        return self.parameters.inertial_number * np.sqrt(self.pressure)

    @property
    def pressure(self):
        return 1.0 / (1.0 - self.stress_ratio)

    @property
    def stress_scale(self):
        return self.parameters.lateral_stress
