"""What the flows on a fixed mesh share: graded elements, walls and their fluidity, gravity."""

import numpy as np

from ..options import BOTH, Option, ParameterError, positive
from . import Case

#: The grains' rate as gdot0, for flows that nothing but their weight drives.
GRAINS_RATE = positive(
    "inertial_number", 1.0, "", "I0 = gdot0 d sqrt(rho_s/P_ref); at 1 the unit of time is that of "
    "the grains, d sqrt(rho_s/P_ref)", "(1.1)", shared=BOTH)


def size(name, default, meaning):
    """Return the row of a length in d."""
    return positive(name, default, "d", meaning, shared=BOTH)


def gravity(default, meaning, unit="P_w/d"):
    """Return the row of the weight of the material."""
    return Option("gravity", "float", default, unit, meaning, low=0.0, shared=("restart",))


def options(wall_fluidity="natural", element_size=0.5):
    """Return the rows of the mesh and of the walls, with the defaults of a case."""
    return (
        positive("element_size", element_size, "d", "mean side of an element; it divides the "
                 "domain", shared=BOTH),
        Option("grading", "float", 1.0, "", "exponent p of the grading across the flow: the "
               "distance from either end goes with the number of elements to the power p, and 1 "
               "makes them equal", "x = s^p/(s^p + (1 - s)^p)", low=1.0, high=10.0, shared=BOTH),
        Option("wall_fluidity", "str", wall_fluidity, "", "fluidity at walls: no flux, g = 0, or "
               "g = g_loc", choices=("natural", "zero", "local"), shared=("restart",)),
        Option("start", "str", "rest", "", "velocity with which a run in time starts: none, or "
               "that of the reference flow; it matters only with inertia",
               choices=("rest", "flow")))


class FixedMesh(Case):
    """A flow through a mesh that stays where it is.

    Attributes
    ----------
    walls : tuple of str
        The sides that are walls, where ``wall_fluidity`` holds.
    """

    moving = False
    #: the fluidity decays over A d/sqrt(mu_s) = 1.6 A d from what drives the flow
    max_coarse_size = 2.1
    max_coarse_elements = np.inf
    walls = ()

    def start(self, x):
        """Return velocity (2, n), fluidity (n,) and pressure (n,) at the start of a run in time."""
        velocity, fluidity, pressure = super().start(x)
        return velocity * (self.parameters.start == "flow"), fluidity, pressure

    # The steady flow by theory

    def profile(self):
        """Return the `pgran.theory.profiles.Profile` of the steady flow.

        Raises ValueError where there is none, and NotImplementedError without such a theory.
        """
        raise NotImplementedError(f"{type(self).__name__} has no profile")

    def along(self, x):
        """Return where points (2, ...) are in the profile (...), and two unit vectors (2, ...).

        The first one points along the flow, the second one along the profile.
        """
        raise NotImplementedError

    def steady(self, profile, x):
        """Return velocity (2, ...), fluidity, pressure and deviator (3, ...) of a profile.

        ``x`` (2, ...) are points, d. The deviator is -1, 0 or 1 times mu P in the shear of the two
        directions of `along`.
        """
        place, (e1, e2), (n1, n2) = self.along(x)
        P = profile.pressure(place)
        shear = profile.sense * profile.stress_ratio(place) * P
        return (profile.velocity(place) * np.array([e1, e2]), profile.fluidity(place), P,
                shear * np.array([2.0 * e1 * n1, 2.0 * e2 * n2, e1 * n2 + e2 * n1]))

    @property
    def walls_of_local_fluidity(self):
        """The sides on which g = g_loc."""
        return self.walls if self.parameters.wall_fluidity == "local" else ()

    def on(self, side, i, j):
        """Return which of the nodes ``i``, ``j`` (n,) lie on a side, (n,) bool."""
        nx, ny = self.shape
        return {"left": i == 0, "right": i == 2 * nx, "bottom": j == 0, "top": j == 2 * ny}[side]

    def prescribed_fluidity(self, time, i, j):
        """Return zero at walls that ask for it; not numbers where free, (n,)."""
        values = super().prescribed_fluidity(time, i, j)
        if self.parameters.wall_fluidity == "zero":
            for side in self.walls:
                values[self.on(side, i, j)] = 0.0
        return values

    @property
    def body_force(self):
        """The weight of the material besides what ``-pgran_body_force`` adds."""
        force = np.add(self.parameters.body_force, self.weight)
        if not force.any():
            return None
        return lambda x: np.reshape(force, (2,) + (1,) * (x.ndim - 1))

    @property
    def weight(self):
        """The weight of the material per volume (2,), stress/d."""
        return 0.0, 0.0

    def graded(self, index, count, length):
        """Return where the nodes ``index`` (n,) of ``count`` graded elements lie, (n,) from 0 on.

        Elements have straight sides: nodes in their middle are half-way.
        """
        corner, p = index // 2, self.parameters.grading
        turns, place = np.divmod(np.stack([corner, corner + index % 2]), count)
        s = place / count
        x = turns + s**p / (s**p + (1.0 - s)**p)
        return length * x.mean(axis=0)

    def refuse_fast(self, name, value, largest, allowed):
        """Refuse a load that no steady flow of the law can bear.

        ``largest`` is the stress ratio that the load asks for, and ``allowed(limit)`` the load that
        asks for the largest one of the law. With inertia the flow would accelerate until its end,
        and leave what the law describes.
        """
        limit = self.law.limit
        if largest >= limit * (1.0 - 1e-9):
            raise ParameterError(
                name, f"{value:g}", f"the flow would need mu = {largest:.4g}, and the law bears "
                f"less than {limit:.4g}: it would speed up for ever; allowed is less than "
                f"{allowed(limit):.4g}, or another @law")


class Layer(FixedMesh):
    """A layer 0 <= x2 <= H on a base at rest, periodic along x1; its rows are width and height."""

    periodic = True, False

    def along(self, x):
        """Return the height (...) of points (2, ...), and the directions of x1 and x2."""
        one, zero = np.ones_like(x[0]), np.zeros_like(x[0])
        return x[1], np.array([one, zero]), np.array([zero, one])

    @property
    def shape(self):
        """Return the number of elements along x1 and x2."""
        return self.elements_along("width"), self.elements_along("height")

    def coordinates(self, i, j):
        """Return the coordinates (2, n) of nodes, d."""
        return np.array([i * self.parameters.element_size / 2.0,
                         self.graded(j, self.shape[1], self.parameters.height)])

    def prescribed_velocity(self, time, i, j):
        """Return zero at the base; not numbers where free, (2, n)."""
        values = super().prescribed_velocity(time, i, j)
        values[:, self.on("bottom", i, j)] = 0.0
        return values
