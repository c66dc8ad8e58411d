"""Cases: one file a flow. A case owns its domain, walls, loads, units, start, end and observables.

A case is a class that derives from `Case`; a new case is one new file, here or anywhere else.
`read` resolves options, and `create` makes the case that they describe.
"""

import copyreg
from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from .. import options
from ..material import LAWS, MODELS, Material
from ..options import BOTH, Option, ParameterError, positive

#: Counts that differ by less than this share are the same.
ROUNDING = 1e-9
#: Most elements in one direction; more could not be counted.
MOST = 1e9

#: The rows of a case that is counted by time.
TIME = (
    positive("end_time", 1.0, "1/gdot0", "where the run ends", changeable=True),
    Option("snapshots", "floats", None, "1/gdot0", "times at which the fields are written, each "
           "reached exactly; times beyond the end are left out, and the end is always written",
           low=0.0, open_low=True, changeable=True),
    Option("rest_speed", "float", 1e-6, "d gdot0", "the run also ends when the largest velocity "
           "has been above this and falls below it; 0 leaves this out", low=0.0, changeable=True),
)


def pressure(value):
    """Return the traction of a pressure on the deformed side, for `Case.tractions`."""
    return lambda x, area: -value * area


def traction(vector):
    """Return a traction (2,) of fixed direction and size, for `Case.tractions`."""
    return lambda x, area: np.multiply.outer(vector, np.hypot(*area))


class Case(ABC):
    """A flow: the seam between a problem and the solver.

    A subclass must define `shape` and `coordinates`; everything else has a default. Functions of
    global indices take integer arrays ``i``, ``j`` (n,): of Q2 nodes (two an element), of corners
    or of elements, counted along x1 and x2 (or along whatever `coordinates` makes of them). On a
    periodic grid they may lie beyond its ends. Lengths are in d, stresses in the stress unit of
    the case, times in 1/gdot0.

    Parameters
    ----------
    parameters : pgran.options.Parameters
        The resolved options.

    Attributes
    ----------
    options : tuple of pgran.options.Option
        The case's own options. A row with the name of a common one takes its place. The rows of
        `TIME` are added unless the case has a row named snapshots.
    periodic : tuple of bool
        Whether the grid closes on itself along i and along j.
    moving : bool
        Whether the mesh moves with the material. On a fixed mesh the flow rotates and advects the
        stress, and inertia contains the convective acceleration (v.grad) v.
    max_coarse_size : float
        Mean side over A d of the coarsest elements that multigrid may use. They resolve what
        couples velocity and fluidity over long distances: three are the shortest growing wavelength
        (k A d = 0.1226) unless a case says otherwise.
    max_coarse_elements : float
        How many elements the coarsest grid may have, as every rank may have to factorise its
        matrix. Beyond them it is coarsened further, whatever `max_coarse_size` says.
    walls_of_local_fluidity : tuple of str
        Sides where g = g_loc takes the place of the fluidity equation. Their ends must be periodic.
    free_surfaces : tuple of str
        Sides where the pressure goes to zero. Close to them the fluidity source is integrated as a
        function of the root of the distance.
    rests : str or None
        Why nothing flows in this case, in words, where that is known beforehand.
    base_gradient : ndarray, (2, 2)
        A velocity gradient that is added to that of the nodal velocity, gdot0.
    stress_unit : str
        What stresses are measured in.
    fluidity_source : callable or None
        ``fluidity_source(x)`` returns a source (...) of the fluidity equation at points ``x``
        (2, ...), for verification. ``body_force`` is of the same kind and returns (2, ...).
    observables : dict or tuple of str
        Names of the columns that `observe` adds to the history, as {name: unit}, where "stress" in
        a unit means that of the case; or the names alone, for pure numbers.
    progress_name : str
        What `count` returns; the attribute of a snapshot that says how far the run was.
    """

    options = ()
    periodic = False, False
    moving = True
    max_coarse_size = 17.0
    max_coarse_elements = 300
    base_gradient = np.zeros((2, 2))
    stress_unit = "stress"
    fluidity_source = None
    walls_of_local_fluidity = ()
    free_surfaces = ()
    why_at_rest = None
    observables = ()
    progress_name = "time"

    def __init_subclass__(cls, **more):
        super().__init_subclass__(**more)
        if not any(row.name == "snapshots" for row in cls.options):
            cls.options = (*cls.options, *TIME)

    def __init__(self, parameters):
        self.parameters = parameters
        self.law = parameters.part("law").of(parameters)

    # Options

    @classmethod
    def resolve(cls, parameters, given):
        """Fill in and check values of ``parameters``; ``given`` holds the names that were set.

        By default the snapshots end with ``end_time``. Raises `pgran.options.ParameterError`.
        """
        parameters.snapshots = reached(parameters.snapshots, parameters.end_time)

    @classmethod
    def homogeneous(cls, parameters):
        """Return the parameters of the same flow without imperfection, for spectra."""
        return parameters

    @classmethod
    def with_wave(cls, parameters, k):
        """Return the parameters of a cell that holds the wave vector ``k`` (2,), 1/d, or None.

        None says that the case is no such cell, so that no theory of waves holds.
        """
        return None

    # Units and reference flow

    @property
    def inertial_time(self):
        """sqrt(d^2 rho_s) in sqrt(stress)/gdot0; I0 where stresses are in the reference stress."""
        return self.parameters.inertial_number

    @property
    def stress_ratio(self):
        """mu_loc of the reference flow."""
        return float(self.law.stress_ratio(np.asarray(self.parameters.inertial_number))[0])

    @property
    def pressure(self):
        """Pressure of the reference flow, stress."""
        return 1.0

    @property
    def fluidity(self):
        """Fluidity of the reference flow, gdot0."""
        return 1.0 / self.stress_ratio

    @cached_property
    def material(self):
        """The `pgran.material.Material` in the units of the case."""
        parameters = self.parameters
        return Material(self.law, parameters.part("model").of(parameters), self.inertial_time,
                        self.pressure, self.stress_ratio, parameters.phi,
                        parameters.shear_modulus)

    @property
    def stress_scale(self):
        """The stress unit in Pa, or None where the options do not say it."""
        return None

    def scales(self):
        """Return the SI scales that the options determine, {name: value}.

        Length d (m), the stress unit (Pa), and the time 1/gdot0 (s).
        """
        d, density = self.parameters.grain_diameter, self.parameters.grain_density
        found = {}
        if d:
            found["scale_length"] = d
        if self.stress_scale:
            found["scale_stress"] = self.stress_scale
        if d and density and self.stress_scale:
            found["scale_time"] = d * np.sqrt(density / self.stress_scale) / self.inertial_time
        return found

    @property
    def specimen(self):
        """Arguments of `pgran.theory.specimen.growth_rate` for this case, or None.

        None says that the closed form of the specimen does not hold.
        """
        return None

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
        """How many unknowns there are: velocity and fluidity at Q2 nodes, pressure at corners."""
        nodes, corners = (np.prod([degree * n + 1 - int(wrap) for n, wrap in zip(
            self.shape, self.periodic)], dtype=float) for degree in (2, 1))
        fields = len(self.shape) + int(self.material.model.has_fluidity)
        return int(nodes * fields + corners)

    @property
    def closed(self):
        """Whether the grid closes on itself in space along i and along j, as a ring does."""
        return tuple(wrap and bool((np.abs(shift) <= 1e-9).all())
                     for wrap, shift in zip(self.periodic, self.period))

    @property
    def period(self):
        """By how much the initial coordinates change once around the grid, (2, 2), d.

        The first entry is the change along i, the second one along j; zero where the grid is not
        periodic.
        """
        found = np.zeros((2, 2))
        for axis, wrap in enumerate(self.periodic):
            if wrap:
                index = np.zeros((2, 2), dtype=int)
                index[axis, 1] = 2 * self.shape[axis]
                first, last = self.coordinates(*index).T
                found[axis] = last - first
        return found

    def elements_along(self, name):
        """Return how many elements of ``element_size`` make the length that a parameter gives.

        Raises `pgran.options.ParameterError` where they do not divide it.
        """
        size, side = getattr(self.parameters, name), self.parameters.element_size
        if size / side > MOST:
            raise ParameterError(name, f"{size:g}", f"makes {size / side:.3g} elements of "
                                 f"@element_size {side:g}; allowed are {MOST:g}")
        count = round(size / side)
        if count < 1 or abs(count * side - size) > 1e-9 * size:
            raise ParameterError(name, f"{size:g}",
                                 f"must be a whole multiple of @element_size {side:g}")
        return count

    # Conditions

    def prescribed_velocity(self, time, i, j):
        """Return prescribed nodal velocities (2, n), d gdot0; not a number where free."""
        return np.full((2, i.size), np.nan)

    def prescribed_fluidity(self, time, i, j):
        """Return prescribed nodal fluidities (n,), gdot0; not a number where free."""
        return np.full(i.size, np.nan)

    def prescribed_pressure(self, time, i, j):
        """Return prescribed corner pressures (n,), stress; not a number where free."""
        return np.full(i.size, np.nan)

    def tractions(self, time):
        """Return the loads on sides, {side: traction}; sides are left, right, bottom and top.

        ``traction(x, area)`` returns the force (2, ...) on pieces of the deformed side at points
        ``x`` (2, ...), whose outward normals times length are ``area`` (2, ...). `pressure` and
        `traction` make such functions.
        """
        return {}

    @property
    def body_force(self):
        """A function that returns b (2, ...) of (2.2), stress/d, at points (2, ...), or None."""
        force = self.parameters.body_force
        if not any(force):
            return None
        return lambda x: np.reshape(force, (2,) + (1,) * (x.ndim - 1))

    def nodes_outside(self, time, x, i, j):
        """Return which nodes have left the domain, (n,) bool, and in words how; None if none can.

        ``x`` (2, n) are the nodes ``i``, ``j`` (n,) at a time.
        """
        return None

    def yield_factor(self, i, j):
        """Return mu_s of elements over its nominal value, (n,)."""
        return np.ones(i.size)

    # Start

    def start(self, x):
        """Return velocity (2, n), fluidity (n,) and pressure (n,) at rest, at points (2, n).

        The velocity is where Newton's method starts; without fluidity nothing flows yet.
        """
        velocity, _, pressure = self.reference(x)
        return velocity, np.zeros(x.shape[1]), pressure

    def reference(self, x):
        """Return velocity (2, n), fluidity (n,) and pressure (n,) of the reference flow.

        It is the flow that spectra are taken about, that a seed is added to, from which steady
        flow is sought, and from which the step control measures departures.
        """
        n = x.shape[1]
        return np.zeros_like(x), np.full(n, self.fluidity), np.full(n, self.pressure)

    # End and observables

    def progress(self, time):
        """Return how far a run is at a time, in what `progress_name` names."""
        return time

    def time_of(self, count):
        """Return the time at which a count is reached; the inverse of `count`."""
        return count

    @property
    def targets(self):
        """Times to land on exactly, in increasing order; the last one ends the run."""
        return [self.time_of(count) for count in self.parameters.snapshots]

    def label(self, time):
        """Return how far a run is at a time, in words."""
        return f"time {time:.4g}"

    def observe(self, flow):
        """Return the `observables` of an accepted step, {name: number}. Collective.

        ``flow`` is a `pgran.solve.driver.AcceptedStep`. It has ``time``, ``reaction(side)``, the force (2,)
        on a side, ``torque(side)``, ``extent(side)``, the lengths (2,) of a side along x1 and x2,
        and ``mean_velocity(side)``, (2,).
        """
        return {}


CASES = options.Component("case", __name__, Case)
#: The parts of a problem, which bring their own options along.
KINDS = CASES, LAWS, MODELS


def _pickled(parameters):
    """Pickle `pgran.options.Parameters` by the names of their parts, which may come from files."""
    return _unpickled, ({row.name: getattr(parameters, row.name) for row in parameters.options},)


def _unpickled(values):
    parts = {kind.name: kind.load(values[kind.name]) for kind in KINDS}
    return options.Parameters(options.table(parts).values(), parts, **values)


copyreg.pickle(options.Parameters, _pickled)


def read(given, stored=False):
    """Return the resolved `pgran.options.Parameters` of a case with its law and model.

    ``given`` and ``stored`` are those of `pgran.options.read`, which says what is raised.
    """
    return options.read(given, KINDS, stored)


def create(parameters):
    """Return the case of resolved parameters.

    Raises
    ------
    ParameterError
        If the parameters do not fit together, or a user's case has no valid `Case.shape`.
    """
    case = parameters.part("case")(parameters)
    name, shape = parameters.case, case.shape
    if not (len(shape) == 2 and all(isinstance(n, (int, np.integer)) and n > 0 for n in shape)):
        raise ParameterError("case", name, f"its shape is {shape}; allowed are two integers > 0")
    nodes = np.array([0, 2 * shape[0]]), np.array([0, 2 * shape[1]])
    if np.shape(case.coordinates(*nodes)) != (2, 2):
        raise ParameterError("case", name, "its coordinates must be of shape (2, n) for n nodes")
    return case


def reached(counts, end):
    """Return the counts (n,) at which fields are written: those before the ``end``, and it.

    Counts that differ by rounding only are one.
    """
    found = [end]
    for count in sorted(counts or (), reverse=True):
        if count < found[-1] * (1.0 - ROUNDING):
            found.append(count)
    return tuple(reversed(found))


class PureShear(Case):
    """What cases around homogeneous pure shear share: units, reference flow and imperfection.

    The units are those of the specimen of section 4: stresses in |sigma_1|, P0 =
    1/(1 - mu_loc(I0)), g0 = 1/mu_loc(I0), v = (x1/2, -x2/2), sqrt(d^2 rho_s) = I0 sqrt(P0).
    """

    stress_unit = "|sigma_1|"
    SIZE = (positive("width", 40.0, "d", "width L of the specimen or cell", shared=BOTH),
            positive("height", None, "d", "height H of the specimen or cell; three widths unless "
                     "given", shared=BOTH),
            positive("lateral_stress", None, "Pa", "|sigma_1| in SI units, for the scales"))

    def __init__(self, parameters):
        super().__init__(parameters)
        if not self.stress_ratio < 1.0:
            raise ParameterError(
                "inertial_number", f"{parameters.inertial_number:g}",
                f"mu_loc(I0) is {self.stress_ratio:.4g}, and plane-strain compression needs it "
                "below 1 (3.19)")

    @classmethod
    def resolve(cls, parameters, given):
        """Make the height three widths unless it is given."""
        if parameters.height is None:
            parameters.height = 3.0 * parameters.width

    @classmethod
    def homogeneous(cls, parameters):
        """Return the parameters without the weak element."""
        return parameters.replace(imperfection=1.0)

    @property
    def inertial_time(self):
        """sqrt(d^2 rho_s) = I0 sqrt(P0), in sqrt(|sigma_1|)/gdot0."""
        return self.parameters.inertial_number * np.sqrt(self.pressure)

    @property
    def pressure(self):
        """P0, in |sigma_1|."""
        return 1.0 / (1.0 - self.stress_ratio)

    @property
    def stress_scale(self):
        """|sigma_1| in Pa, or None."""
        return self.parameters.lateral_stress
