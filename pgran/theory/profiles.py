"""Steady unidirectional flows, from one-dimensional problems.

In each of these flows mu(x) and P(x) are known except for one constant, which follows from the
speed of the wall. NGF is then a linear two-point boundary-value problem for g, dynamic NGF a
nonlinear one, and LI has the local fluidity::

    A^2 d^2 lap g = (A^2 d^2/xi^2)(g - g_loc)                                    ngf
    A^2 d^2 lap g = K g + (b mu/s) g^2,  K = (A^2 d^2/xi^2) sign(mu_s - mu)      ngf_primitive
    g = g_loc = s I_loc(mu)/mu                                                   li

with s = sqrt(P)/I0. The velocity follows from v' = g mu, in a ring from r (v/r)' = -g mu. The
interval is divided into panels, with a division where mu = mu_s, and each panel has a polynomial
by collocation at Chebyshev points. Below a free surface s is proportional to the root u of the
depth, and the fields are smooth functions of u. Units: d, the stress unit of the
case and 1/gdot0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

#: Points per panel, additional points of the solution that estimates the error, and maximum number
#: of times that all panels are halved.
POINTS, MORE, HALVINGS = 20, 6, 4
#: Longest panel, d.
LONGEST = 1.5
#: Error of a profile over its maximum: aim, and largest value that is accepted.
TOLERANCE, LARGEST = 1e-10, 1e-6


class Panels:
    """Piecewise polynomials between ``ends`` (m + 1,), with ``n`` points in each of m panels.

    ``x`` (m, n) are the points, and ``D`` (m, n, n) the derivative matrices.
    """

    def __init__(self, ends, n):
        self.ends = np.asarray(ends, dtype=float)
        self._half = np.diff(self.ends)[:, None] / 2.0
        points, unit = -np.cos(np.pi * np.arange(n) / (n - 1)), np.eye(n)
        self._coefficients = np.linalg.inv(chebyshev.chebvander(points, n - 1))
        derivative, integral = (chebyshev.chebval(points, part).T @ self._coefficients for part in (
            chebyshev.chebder(unit), chebyshev.chebint(unit, lbnd=-1)))
        self.x = self.ends[:-1, None] + self._half * (points + 1.0)
        self.D, self._integral = derivative / self._half[:, :, None], integral

    def integral(self, values):
        """Return the integral (m, n) of ``values`` (m, n) from the left end."""
        parts = self._half * (values @ self._integral.T)
        return parts + np.concatenate([[0.0], np.cumsum(parts[:, -1])[:-1]])[:, None]

    def at(self, values, x):
        """Return the polynomials through ``values`` (m, n) at points ``x`` (...)."""
        x = np.clip(x, self.ends[0], self.ends[-1])
        panel = np.clip(np.searchsorted(self.ends, x, side="right") - 1, 0, len(values) - 1)
        local = (x - self.ends[panel]) / self._half[panel, 0] - 1.0
        series = values @ self._coefficients.T
        terms = chebyshev.chebvander(local, values.shape[1] - 1) * series[panel]
        return terms.sum(axis=-1).reshape(np.shape(x))


@dataclass
class StressProfile:
    """Stress ratio ``mu`` and pressure ``P`` at positions (...), and boundaries of a flow.

    The sign of mu is the sign of the shear rate. ``ends`` are ends of panels, ``wall`` is the
    fluidity at walls (natural, zero or local), and in a ``ring`` x is the radius. The panels of a
    flow of height ``depth`` H with a free surface are in u = sqrt(H - x), from surface to base.
    """

    mu: object
    P: object
    ends: np.ndarray
    wall: str
    ring: bool = False
    depth: object = None

    def position(self, x):
        """Return the coordinate of positions (...) in the panels."""
        x = np.asarray(x, dtype=float)
        return x if self.depth is None else np.sqrt(np.maximum(self.depth - x, 0.0))


@dataclass(frozen=True)
class Profile:
    """A steady flow; its functions take positions (...), d.

    ``constant`` is tau_w (planar shear) or mu_i (annulus), and ``error`` is relative.
    """

    panels: Panels
    g: np.ndarray
    v: np.ndarray
    flow: StressProfile
    constant: object
    error: float

    def velocity(self, x):
        """Return the speed along the flow, d gdot0."""
        return self.panels.at(self.v, self.flow.position(x))

    def fluidity(self, x):
        """Return g, gdot0."""
        return self.panels.at(self.g, self.flow.position(x))

    def pressure(self, x):
        """Return P, in the stress unit of the case."""
        return self.flow.P(self.flow.position(x))

    def stress_ratio(self, x):
        """Return mu = tau/P, signed."""
        return self.flow.mu(self.flow.position(x))


class Rheology:
    """A law and a model with A and I0: solves for the fluidity and velocity of a flow."""

    def __init__(self, law, model, A, I0):
        if model not in ("li", "ngf", "ngf_primitive"):
            raise ValueError(f"model {model}: expected one of: li, ngf, ngf_primitive")
        self.law, self.model, self.A, self.I0 = law, model, A, I0
        self._halvings = 0

    def profile(self, make, speed=None):
        """Return the `Profile` of the flow ``make(mu)`` on panels that are halved until accurate.

        ``mu`` is the largest stress ratio of a flow with a given wall speed, and None otherwise.
        """
        best = None
        for self._halvings in range(HALVINGS + 1):
            mu = None if speed is None else self._stress_ratio(make, speed)
            flow = make(mu)
            coarse, *less = self._solve(flow, POINTS)
            fine, *more = self._solve(flow, POINTS + MORE)
            error = max(np.abs(coarse.at(a, fine.x) - b).max() / (np.abs(b).max() or 1.0)
                        for a, b in zip(less, more))
            if best is not None and error > best.error:
                break  # rounding dominates, as just above a stopping height
            best = Profile(fine, *more, flow, mu, error)
            if error < TOLERANCE:
                break
        if not best.error < LARGEST:
            raise ValueError(f"the profile has an error of {best.error:.1e} of its maximum")
        return best

    def _stress_ratio(self, make, speed):
        """Return the stress ratio at which the flow ``make(mu)`` has a wall speed."""
        span = min(self.law.limit, 1e3) - self.law.yield_ratio

        def mu(position):
            return self.law.yield_ratio + span * np.exp(position) / (1.0 + np.exp(position))

        def excess(position):
            flow = make(mu(position))
            v = self._solve(flow, POINTS)[2]
            return np.log(max((v[0, 0] if flow.ring else v[-1, -1]) / speed, 1e-12))

        low = high = 0.0
        while excess(low) > 0.0:
            low -= 3.0
        while excess(high) < 0.0:
            high += 3.0
            if high > 34.0:
                raise ValueError("the law does not allow flow at this speed")
        return mu(_root(excess, low, high))

    def _solve(self, flow, n):
        """Return `Panels` with ``n`` points per panel, and g and v (m, n) of a flow.

        v is zero at the left end, but in a ring and on a slope at the right end.
        """
        ends = flow.ends
        for _ in range(self._halvings):
            ends = np.sort(np.concatenate([ends, (ends[1:] + ends[:-1]) / 2.0]))
        panels = Panels(ends, n)
        g = self._fluidity(flow, panels)
        rate = g * flow.mu(panels.x)
        if flow.depth is not None:
            v = panels.integral(-2.0 * panels.x * rate)
            return panels, g, v - v[-1, -1]
        if not flow.ring:
            return panels, g, panels.integral(rate)
        angular = panels.integral(-rate / panels.x)
        return panels, g, panels.x * (angular - angular[-1, -1])

    def _fluidity(self, flow, panels):
        middle = panels.x.mean(axis=1, keepdims=True)
        # Panels may end where mu = mu_s or P = 0: evaluate slightly inside.
        x = middle + (panels.x - middle) * (1.0 - 1e-14)
        mu, P = np.abs(flow.mu(x)), np.maximum(flow.P(x), 0.0)
        I, _ = self.law.inertial_number(mu)
        target = np.sqrt(P) / self.I0 * I / np.where(I > 0.0, mu, 1.0)
        if self.model == "li":
            return target
        size = self.law.inverse_length_squared(mu)[0]
        lap = self.A**2 * (panels.D @ panels.D)
        if flow.depth is not None:  # d/dz = d/du/(2u); the surface condition replaces the row u = 0
            u = np.where(panels.x > 0.0, panels.x, 1.0)[:, :, None]
            lap = (lap - self.A**2 * panels.D / u) / (4.0 * u**2)
        if flow.ring:
            lap = lap + self.A**2 * panels.D / panels.x[:, :, None]
        if self.model == "ngf":
            return self._boundary_value_problem(flow, panels, lap, size, size * target, target)
        signed = np.where(mu > self.law.yield_ratio, -size, size)
        b = self.law.stress_ratio(np.zeros_like(mu))[1]
        with np.errstate(divide="ignore"):
            drag = b * mu * self.I0 / np.sqrt(P)
        g = np.full_like(mu, 2.0 * target.max())
        for _ in range(100):
            new = self._boundary_value_problem(
                flow, panels, lap, signed + 2.0 * drag * g, drag * g**2, target)
            change, g = np.abs(new - g).max(), new
            # Newton's method converges quadratically, but towards g = 0 only linearly.
            if change <= 1e-9 * np.abs(g).max() or np.abs(g).max() < 1e-9 * target.max():
                return np.zeros_like(g) if np.abs(g).max() < 1e-6 * target.max() else g
        raise ValueError(f"the fluidity has not converged: it changes by {change:.1e} gdot0")

    def _boundary_value_problem(self, flow, panels, lap, k, source, target):
        """Solve lap g = k g - source with the conditions at the ends of panels; return g (m, n)."""
        m, n = panels.x.shape
        matrix, right = np.zeros((m, n, m, n)), -source
        for p in range(m):
            matrix[p, :, p] = lap[p] - np.diag(k[p])
        for p in range(1, m):  # continuity of g and g'
            matrix[p, 0], matrix[p - 1, -1] = 0.0, 0.0
            right[p, 0] = right[p - 1, -1] = 0.0
            matrix[p, 0, p, 0], matrix[p, 0, p - 1, -1] = 1.0, -1.0
            scale = 1.0 / np.abs(panels.D[p, 0, 0])
            matrix[p - 1, -1, p - 1] = -scale * panels.D[p - 1, -1]
            matrix[p - 1, -1, p] = scale * panels.D[p, 0]
        for end in (0, -1):
            matrix[end, end], right[end, end] = 0.0, 0.0
            if end == 0 and flow.depth is not None:
                # g = a + b u^2 + ... at a free surface, and no flux requires b = 0
                row = (panels.D[0] @ panels.D[0])[0]
                matrix[0, 0, 0] = row / np.abs(row).max()
            elif flow.wall == "natural":
                matrix[end, end, end] = panels.D[end, end] / np.abs(panels.D[end, end, end])
            else:
                matrix[end, end, end, end] = 1.0
                right[end, end] = target[end, end] if flow.wall == "local" else 0.0
        return np.linalg.solve(matrix.reshape(m * n, m * n), right.ravel()).reshape(m, n)


def _split(start, end, cuts=()):
    """Ends of panels from ``start`` to ``end``, including the ``cuts`` between them."""
    inner = [cut for cut in cuts if start + 1e-12 * end < cut < end * (1.0 - 1e-12)]
    stops = np.unique([start, *inner, end])
    return np.unique(np.concatenate([np.linspace(a, b, 1 + int(np.ceil((b - a) / LONGEST)))
                                     for a, b in zip(stops, stops[1:])]))


def _root(function, low, high):
    from scipy.optimize import brentq  # slow to import

    return brentq(function, low, high, xtol=1e-15)


def planar_shear(law, model, A, I0, height, gravity=0.0, wall="natural"):
    """Return the `Profile` of planar shear; its constant is tau_w. See `pgran.cases`."""
    def P(x):
        return 1.0 + gravity * (height - x)

    def make(tau):
        cuts = [height - (tau / law.yield_ratio - 1.0) / gravity] if gravity else []
        return StressProfile(lambda x: tau / P(x), P, _split(0.0, height, cuts), wall)

    return Rheology(law, model, A, I0).profile(make, height)


def vertical_chute(law, model, A, I0, width, gravity, wall="natural"):
    """Return the `Profile` of the chute; its velocity points down."""
    reach = law.yield_ratio / gravity
    cuts = [width / 2.0 - reach, width / 2.0, width / 2.0 + reach]
    flow = StressProfile(lambda x: gravity * (width / 2.0 - x), np.ones_like,
                         _split(0.0, width, cuts), wall)
    return Rheology(law, model, A, I0).profile(lambda mu: flow)


def annular_shear(law, model, A, I0, inner, outer, wall="natural", density=0.0):
    """Return the `Profile` of the ring over the radius; its constant is mu_i.

    With a ``density`` phi I0^2 the pressure is P_w minus the integral of density v^2/r from r to
    the outer wall. P and v are then found in turn.
    """
    pressure, found = np.ones_like, None
    rheology = Rheology(law, model, A, I0)

    def make(mu_i):
        top = mu_i * pressure(np.array(inner))

        def mu(r):
            return top * (inner / r)**2 / pressure(r)

        cut = _root(lambda r: law.yield_ratio - mu(np.array(r)), inner, 1e3 * outer) \
            if density else inner * np.sqrt(mu_i / law.yield_ratio)
        return StressProfile(mu, pressure, _split(inner, outer, [cut]), wall, True)

    for _ in range(60):
        previous, found = found, rheology.profile(make, inner)
        if not density or previous and abs(found.constant - previous.constant) < 1e-13:
            return found
        panels = found.panels
        rise = panels.integral(density * found.v**2 / panels.x)
        level = 1.0 - rise[-1, -1] + rise
        pressure = lambda r, p=panels, values=level: p.at(values, r)  # noqa: E731
    raise ValueError("pressure and speed of the ring have not converged")


def inclined_plane(law, model, A, I0, height, slope, wall="zero"):
    """Return the `Profile` on a slope (degrees) over the height above the base."""
    angle = np.radians(slope)
    mu = float(np.tan(angle))
    if not mu < law.limit:
        raise ValueError(f"slope {slope:g}: there is no steady flow, because the law has a smaller "
                         "limit")
    flow = StressProfile(lambda u: np.full_like(u, mu), lambda u: np.cos(angle) * u**2,
                         np.sqrt(_split(0.0, height)), wall, depth=height)
    return Rheology(law, model, A, I0).profile(lambda mu: flow)


def stopping_height(law, A, slope):
    """Return H_stop = (pi/2) xi, d, of dynamic NGF on a slope (degrees) with g = 0 at the base."""
    mu = np.tan(np.radians(slope))
    if mu <= law.yield_ratio:
        return np.inf
    return float(np.pi / 2.0 * A / np.sqrt(law.inverse_length_squared(np.asarray(mu))[0]))
