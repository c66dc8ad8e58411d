"""Flows on a fixed mesh: graded elements, walls and their fluidity, gravity."""

from abc import abstractmethod

import numpy as np

from ..options import BOTH, Option, ParameterError, positive
from . import ROUNDING, Case, pressure

#: Option of flows that are driven only by their weight: gdot0 is the inertial rate of the grains.
GRAINS_RATE = positive(
    "inertial_number", 1.0, "", "I0 = gdot0 d sqrt(rho_s/P_ref); with 1 the unit of time is the "
    "inertial time of the grains, d sqrt(rho_s/P_ref)", "(1.1)", shared=BOTH)


def size(name, default, meaning):
    """Return the option of a length in d."""
    return positive(name, default, "d", meaning, shared=BOTH)


def gravity(default, meaning, unit="P_w/d"):
    """Return the option of the weight of the material."""
    return Option("gravity", "float", default, unit, meaning, low=0.0, shared=("restart",))


def options(wall_fluidity="natural", element_size=0.5):
    """Return the options of mesh and walls, with the defaults of a case."""
    return (
        positive("element_size", element_size, "d", "mean side of an element; must divide the "
                 "domain", shared=BOTH),
        Option("grading", "float", 1.0, "", "exponent p of the grading across the flow: the "
               "distance from either end is proportional to the number of elements to the power p; "
               "1: uniform", "x = s^p/(s^p + (1 - s)^p)", low=1.0, high=10.0, shared=BOTH),
        Option("wall_fluidity", "str", wall_fluidity, "", "fluidity at walls: no flux, g = 0, or "
               "g = g_loc", choices=("natural", "zero", "local"), shared=("restart",)),
        Option("start", "str", "rest", "", "initial velocity of a transient run: zero, or the "
               "reference flow; it has an effect only with inertia", choices=("rest", "flow")))


class FixedMesh(Case):
    """A steady or transient flow of width and height on a fixed mesh."""

    moving = False
    #: The fluidity decays over A d/sqrt(mu_s) = 1.6 A d.
    max_coarse_size = 2.1
    max_coarse_elements = np.inf
    #: Sides where the option ``wall_fluidity`` holds.
    walls = ()

    @property
    def shape(self):
        return self.elements_along("width"), self.elements_along("height")

    @property
    def weight(self):
        return 0.0, -getattr(self.parameters, "gravity", 0.0)

    def start(self, x):
        velocity, fluidity, pressure = super().start(x)
        return velocity * (self.parameters.start == "flow"), fluidity, pressure

    @property
    def walls_of_local_fluidity(self):
        return self.walls if self.parameters.wall_fluidity == "local" else ()

    def on(self, side, i, j):
        """Return whether the nodes ``i``, ``j`` (n,) lie on a side, (n,) bool."""
        nx, ny = self.shape
        return {"left": i == 0, "right": i == 2 * nx, "bottom": j == 0, "top": j == 2 * ny}[side]

    def prescribed_fluidity(self, time, i, j):
        values = super().prescribed_fluidity(time, i, j)
        if self.parameters.wall_fluidity == "zero":
            for side in self.walls:
                values[self.on(side, i, j)] = 0.0
        return values

    def graded(self, index, count, length):
        """Return the positions (n,) of the nodes ``index`` of ``count`` graded elements, from 0."""
        p = self.parameters.grading
        corners = np.stack([index // 2, (index + 1) // 2])  # a middle node is half-way between them
        turns, s = np.divmod(corners / count, 1.0)
        return length * (turns + s**p / (s**p + (1.0 - s)**p)).mean(axis=0)

    def static(self, what, mu):
        """Return why nothing flows at the stress ratio ``mu``, or None above yield."""
        limit = self.law.yield_ratio
        return None if mu > limit else (f"{what} has mu = {mu:.4g}, which does not exceed the "
                                        f"yield value {limit:.4g}: the material is static")

    def refuse_fast(self, name, value, largest, allowed):
        """Raise `ParameterError` if the law has no steady flow at the stress ratio ``largest``."""
        limit = self.law.limit
        if largest >= limit * (1.0 - ROUNDING):
            raise ParameterError(
                name, f"{value:g}", f"there is no steady flow: mu = {largest:.4g} exceeds the "
                f"limit {limit:.4g} of the law; must be less than {allowed:.4g}, or use "
                "another @law")


class Falling(FixedMesh):
    """Material that falls under its weight along a wall; the right wall has the pressure P_w.

    ``span`` is the option of the distance that, times half the weight, is the stress ratio at the
    wall, and ``symbol`` its symbol.
    """

    stress_unit = "P_w"
    observables = {"shear_stress": "stress", "mean_speed": "d gdot0"}

    def __init__(self, parameters):
        super().__init__(parameters)
        self.refuse_fast("gravity", parameters.gravity, self.wall_ratio, 2.0 * self.law.limit
                         / getattr(parameters, self.span))

    @property
    def wall_ratio(self):
        """Stress ratio at the wall."""
        return 0.5 * self.parameters.gravity * getattr(self.parameters, self.span)

    @property
    def why_at_rest(self):
        return self.static(f"the wall, gravity {self.symbol}/2,", self.wall_ratio)

    def coordinates(self, i, j):
        return np.array([self.graded(i, self.shape[0], getattr(self.parameters, self.span)),
                         j * self.parameters.element_size / 2.0])

    def tractions(self, time):
        return {"right": pressure(1.0)}


class Unidirectional(FixedMesh):
    """A flow that varies along one coordinate, with a `pgran.theory.profiles.Profile`."""

    @abstractmethod
    def profile(self):
        """Return the `pgran.theory.profiles.Profile` of the steady flow."""

    @property
    def rheology(self):
        """Law, model, A and I0, the first arguments of `pgran.theory.profiles`."""
        p = self.parameters
        return self.law, self.material.model.theory, p.A, p.inertial_number

    @abstractmethod
    def along(self, x):
        """Return the profile coordinate (...) of points (2, ...) and unit vectors (2, ...).

        The first vector points along the flow, the second one along the profile.
        """

    def steady(self, profile, x):
        """Return velocity (2, ...), fluidity, pressure and deviator (3, ...) of a profile.

        The deviator is a shear stress of size mu P between the two directions of `along`.
        """
        position, (e1, e2), (n1, n2) = self.along(x)
        P = profile.pressure(position)
        # Where mu > 0 the velocity increases along the profile, but decreases in a ring.
        shear = (-1.0 if profile.flow.ring else 1.0) * profile.stress_ratio(position) * P
        return (profile.velocity(position) * np.array([e1, e2]), profile.fluidity(position), P,
                shear * np.array([2.0 * e1 * n1, 2.0 * e2 * n2, e1 * n2 + e2 * n1]))


class Layer(Unidirectional):
    """A layer 0 <= x2 <= H on a base without motion, periodic along x1."""

    periodic = True, False

    def along(self, x):
        one, zero = np.ones_like(x[0]), np.zeros_like(x[0])
        return x[1], np.array([one, zero]), np.array([zero, one])

    def coordinates(self, i, j):
        return np.array([i * self.parameters.element_size / 2.0,
                         self.graded(j, self.shape[1], self.parameters.height)])

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        values[:, self.on("bottom", i, j)] = 0.0
        return values
