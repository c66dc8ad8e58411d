"""Steady unidirectional flows and their time scales, from one-dimensional problems.

In each of these flows mu(x) and P(x) are known up to one constant, which the speed of the wall
fixes. Steady NGF is then a linear two-point problem, the primitive form a nonlinear one, and LI
none::

    A^2 d^2 lap g = (A^2 d^2/xi^2)(g - g_loc)                                    ngf
    A^2 d^2 lap g = K g + (b mu/s) g^2,  K = (A^2 d^2/xi^2) sign(mu_s - mu)      ngf_primitive
    g = g_loc = s I_loc(mu)/mu                                                   li

with s = sqrt(P)/I0, and v' = g mu, in a ring r (v/r)' = -g mu. Panels end where mu = mu_s. Each
holds a polynomial, by collocation at Chebyshev points. Below a free surface s goes to zero like the
root u of the depth, and everything is smooth in u. Lengths are in d, stresses in P_ref of
the case and times in 1/gdot0, as in `pgran.cases`.
"""

from dataclasses import dataclass

import numpy as np

#: Points of a panel, and how many more its check has.
POINTS, MORE = 20, 6
#: Longest panel, d.
LONGEST = 1.5
#: Error of a profile over its maximum that is aimed at, and beyond which it is refused.
TOLERANCE, LARGEST = 1e-10, 1e-6
#: Speeds below this share of the wall's are rest.
TINY = 1e-12
#: How often all panels are halved at most.
HALVINGS = 4


def chebyshev(n):
    """Return n Chebyshev points on [-1, 1] in increasing order, and their derivative matrix."""
    x = -np.cos(np.pi * np.arange(n) / (n - 1))
    c = np.where((np.arange(n) == 0) | (np.arange(n) == n - 1), 2.0, 1.0) * (-1.0)**np.arange(n)
    with np.errstate(divide="ignore"):
        D = np.outer(c, 1.0 / c) / (x[:, None] - x)
    np.fill_diagonal(D, 0.0)
    np.fill_diagonal(D, -D.sum(axis=1))
    return x, D


class Panels:
    """Piecewise polynomials between ``ends`` (m + 1,), with ``n`` points in each of m panels.

    Attributes
    ----------
    x : ndarray, (m, n)
        The points; neighbouring panels share theirs.
    D : ndarray, (m, n, n)
        Derivative matrices.
    """

    def __init__(self, ends, n):
        self.ends, self.n = np.asarray(ends, dtype=float), n
        self.xi, D = chebyshev(n)
        half = np.diff(self.ends)[:, None] / 2.0
        self.x = self.ends[:-1, None] + half * (self.xi + 1.0)
        self.D = D / half[:, :, None]
        whole = D.copy()
        whole[0] = np.eye(n)[0]
        self._integral = np.linalg.inv(whole)
        self._integral[:, 0] = 0.0  # zero at the left end
        self._half = half

    def integral(self, values):
        """Return the integral (m, n) of ``values`` (m, n) from the left end."""
        parts = self._half * (values @ self._integral.T)
        return parts + np.concatenate([[0.0], np.cumsum(parts[:, -1])[:-1]])[:, None]

    def at(self, values, x):
        """Return the polynomials through ``values`` (m, n) at points ``x`` (...)."""
        x = np.asarray(x, dtype=float)
        flat = np.clip(x.ravel(), self.ends[0], self.ends[-1])
        panel = np.clip(np.searchsorted(self.ends, flat, side="right") - 1, 0, len(values) - 1)
        local = (flat - self.ends[panel]) / self._half[panel, 0] - 1.0
        weight = (-1.0)**np.arange(self.n)
        weight[[0, -1]] *= 0.5
        with np.errstate(divide="ignore", invalid="ignore"):
            terms = weight / (local[:, None] - self.xi)
            found = (terms * values[panel]).sum(axis=1) / terms.sum(axis=1)
        same = np.abs(local[:, None] - self.xi) < 1e-15
        hit = same.any(axis=1)
        found[hit] = values[panel[hit], np.argmax(same[hit], axis=1)]
        return found.reshape(x.shape)


@dataclass
class StressProfile:
    """What is known of a flow before its fluidity.

    Attributes
    ----------
    mu, P : callable
        Stress ratio and pressure at positions, arrays of one shape.
    ends : ndarray
        Where panels end.
    walls : tuple of bool
        Whether the left and the right end are walls; a free surface is none.
    wall : str
        Fluidity at walls: natural, zero or local.
    ring : bool
        Whether x is the radius of a ring.
    depth : float or None
        Of a flow with a free surface: its height H. Panels then count u = sqrt(H - x), and the base
        is their right end.
    """

    mu: object
    P: object
    ends: np.ndarray
    walls: tuple
    wall: str
    ring: bool = False
    depth: object = None

    def place(self, x):
        """Return where positions (...) lie among the panels."""
        x = np.asarray(x, dtype=float)
        return x if self.depth is None else np.sqrt(np.maximum(self.depth - x, 0.0))


@dataclass(frozen=True)
class Profile:
    """A steady flow; its functions take positions (...), d.

    Attributes
    ----------
    constant : float or None
        tau_w (planar shear) or mu_i (annulus).
    error : float
        The larger of the errors of g and v over their maxima, by more points.
    """

    panels: Panels
    g: np.ndarray
    v: np.ndarray
    flow: StressProfile
    constant: object
    error: float

    @property
    def sense(self):
        """1 where mu > 0 makes the speed grow along the profile, -1 where it falls (ring)."""
        return -1.0 if self.flow.ring else 1.0

    def velocity(self, x):
        """Return the speed along the flow, d gdot0."""
        return self.panels.at(self.v, self.flow.place(x))

    def fluidity(self, x):
        """Return g, gdot0."""
        return self.panels.at(self.g, self.flow.place(x))

    def pressure(self, x):
        """Return P, in the reference stress of the case."""
        return self.flow.P(self.flow.place(x))

    def stress_ratio(self, x):
        """Return mu = tau/P."""
        return self.flow.mu(self.flow.place(x))


class Rheology:
    """A law and a model with its amplitude and I0, as a two-point problem needs them."""

    def __init__(self, law, model, A, I0):
        if model not in ("li", "ngf", "ngf_primitive"):
            raise ValueError(f"model {model}: allowed is li | ngf | ngf_primitive")
        self.law, self.model, self.A, self.I0 = law, model, A, I0
        self._halvings = 0

    def refined(self, find):
        """Return ``find()``, a `Profile`, on panels that are halved until it is known well enough.

        Where rounding ends that, as just above a stopping height, the best one is returned. Raises
        ValueError if its error exceeds `LARGEST`.
        """
        best = None
        for self._halvings in range(HALVINGS + 1):
            found = find()
            if best is not None and found.error > best.error:
                break
            best = found
            if best.error < TOLERANCE:
                return best
        if not best.error < LARGEST:
            raise ValueError(f"the profile is known to {best.error:.1e} of its maximum only")
        return best

    def panels(self, flow, n):
        """Return `Panels` of a flow with ``n`` points each."""
        ends = flow.ends
        for _ in range(self._halvings):
            ends = np.sort(np.concatenate([ends, (ends[1:] + ends[:-1]) / 2.0]))
        return Panels(ends, n)

    def local(self, mu, P):
        """Return g_loc = s I_loc(mu)/mu, gdot0."""
        I, _ = self.law.inertial_number(mu)
        return np.sqrt(P) / self.I0 * I / np.where(I > 0.0, mu, 1.0)

    def fluidity(self, flow, panels):
        """Return g (m, n) of a flow on panels."""
        middle = panels.x.mean(axis=1, keepdims=True)
        # Ends of panels may lie where mu = mu_s or P = 0: take both from within.
        x = middle + (panels.x - middle) * (1.0 - 1e-14)
        mu, P = flow.mu(x), np.maximum(flow.P(x), 0.0)
        target = self.local(mu, P)
        if self.model == "li":
            return target
        size = self.law.inverse_length_squared(mu)[0]
        lap = self.A**2 * (panels.D @ panels.D)
        if flow.depth is not None:  # d/dz = d/du/(2u); the row of u = 0 is that of the surface
            u = np.where(panels.x > 0.0, panels.x, 1.0)[:, :, None]
            lap = (lap - self.A**2 * panels.D / u) / (4.0 * u**2)
        if flow.ring:
            lap = lap + self.A**2 * panels.D / panels.x[:, :, None]
        if self.model == "ngf":
            return self._solve(flow, panels, lap, size, size * target, target)
        signed = np.where(mu > self.law.yield_ratio, -size, size)
        b = self.law.stress_ratio(np.zeros_like(mu))[1]
        with np.errstate(divide="ignore"):
            drag = b * mu * self.I0 / np.sqrt(P)
        g = np.full_like(mu, 2.0 * target.max())
        for _ in range(100):
            new = self._solve(flow, panels, lap, signed + 2.0 * drag * g, drag * g**2, target)
            change, g = np.abs(new - g).max(), new
            # Newton's method squares the error, but only halves it towards rest.
            if change <= 1e-9 * np.abs(g).max() or np.abs(g).max() < 1e-9 * target.max():
                break
        else:
            raise ValueError(f"the fluidity still changes by {change:.1e} gdot0")
        return np.zeros_like(g) if np.abs(g).max() < 1e-6 * target.max() else g

    def _solve(self, flow, panels, lap, k, source, target):
        """Solve lap g = k g - source with the conditions at panel ends; return g (m, n)."""
        m, n = panels.x.shape
        matrix, right = np.zeros((m, n, m, n)), -source.copy()
        for p in range(m):
            matrix[p, :, p] = lap[p] - np.diag(k[p])
            if p:  # continuity of g and g'
                matrix[p, 0], right[p, 0] = 0.0, 0.0
                matrix[p, 0, p, 0], matrix[p, 0, p - 1, -1] = 1.0, -1.0
                matrix[p - 1, -1], right[p - 1, -1] = 0.0, 0.0
                scale = 1.0 / np.abs(panels.D[p, 0, 0])
                matrix[p - 1, -1, p - 1] = -scale * panels.D[p - 1, -1]
                matrix[p - 1, -1, p] = scale * panels.D[p, 0]
        for end, is_wall in zip((0, -1), flow.walls):
            matrix[end, end] = 0.0
            if is_wall and flow.wall != "natural":
                matrix[end, end, end, end] = 1.0
                right[end, end] = target[end, end] if flow.wall == "local" else 0.0
            elif not is_wall:  # g = a + b u^2 + ..., and no flux says b = 0
                second = (panels.D[end] @ panels.D[end])[end]
                matrix[end, end, end] = second / np.abs(second).max()
                right[end, end] = 0.0
            else:
                matrix[end, end, end] = panels.D[end, end] / np.abs(panels.D[end, end, end])
                right[end, end] = 0.0
        return np.linalg.solve(matrix.reshape(m * n, m * n), right.ravel()).reshape(m, n)

    def velocity(self, flow, panels, g):
        """Return v (m, n): zero at the left end, in a ring and on a slope at the right one."""
        rate = g * flow.mu(panels.x)
        if flow.depth is not None:
            v = panels.integral(-2.0 * panels.x * rate)
            return v - v[-1, -1]
        if not flow.ring:
            return panels.integral(rate)
        angular = panels.integral(-rate / panels.x)
        return panels.x * (angular - angular[-1, -1])

    def profile(self, flow, constant=None):
        """Return the `Profile` of a flow on the panels as they are."""
        answers = []
        for n in (POINTS, POINTS + MORE):
            panels = self.panels(flow, n)
            g = self.fluidity(flow, panels)
            answers.append((panels, g, self.velocity(flow, panels, g)))
        (coarse, *less), (fine, *more) = answers
        errors = [np.abs(coarse.at(a, fine.x) - b).max() / (np.abs(b).max() or 1.0)
                  for a, b in zip(less, more)]
        return Profile(fine, *more, flow, constant, max(errors))

    def speed(self, flow):
        """Return the speed of the moving wall that a flow makes, d gdot0."""
        panels = self.panels(flow, POINTS)
        v = self.velocity(flow, panels, self.fluidity(flow, panels))
        return v[0, 0] if flow.ring else v[-1, -1]


def split(start, end, cuts=()):
    """Return ends of panels from ``start`` to ``end`` that include the ``cuts`` within."""
    inner = [cut for cut in cuts if start + 1e-12 * end < cut < end * (1.0 - 1e-12)]
    stops = np.unique([start, *inner, end])
    parts = [np.linspace(a, b, 1 + max(1, int(np.ceil((b - a) / LONGEST))))
             for a, b in zip(stops, stops[1:])]
    return np.unique(np.concatenate(parts))


def root(function, low, high):
    """Return where a function changes sign between ``low`` and ``high``, to rounding.

    Raises ValueError where it has the same sign at both.
    """
    from scipy.optimize import brentq  # slow to import, and only profiles need it

    return brentq(function, low, high, xtol=1e-15, rtol=4.0 * np.finfo(float).eps)


def _driven(rheology, make, speed):
    """Return the `Profile` whose wall has a speed; ``make(mu)`` is the flow of a largest mu."""
    law = rheology.law
    limit = float(law.stress_ratio(np.asarray(1e12))[0])
    span = min(limit, 1e3) - law.yield_ratio

    def miss(position):
        mu = law.yield_ratio + span * np.exp(position) / (1.0 + np.exp(position))
        return np.log(max(rheology.speed(make(mu)), TINY * speed) / speed)

    low = high = 0.0
    while miss(low) > 0.0:
        low -= 3.0
    while miss(high) < 0.0:
        high += 3.0
        if high > 34.0:
            raise ValueError("the law cannot bear flow of this speed")
    position = root(miss, low, high)
    mu = law.yield_ratio + span * np.exp(position) / (1.0 + np.exp(position))
    return rheology.profile(make(mu), float(mu))


def planar_shear(law, model, A, I0, height, gravity=0.0, wall="natural"):
    """Return the `Profile` of planar shear; its constant is tau_w. See `pgran.cases`."""
    def make(tau):
        cuts = [height - (tau / law.yield_ratio - 1.0) / gravity] if gravity else []
        return StressProfile(lambda x: tau / (1.0 + gravity * (height - x)),
                    lambda x: 1.0 + gravity * (height - x),
                    split(0.0, height, cuts), (True, True), wall)

    rheology = Rheology(law, model, A, I0)
    return rheology.refined(lambda: _driven(rheology, make, height))


def vertical_chute(law, model, A, I0, width, gravity, wall="natural"):
    """Return the `Profile` of the chute; its velocity points down."""
    reach = law.yield_ratio / gravity
    cuts = [width / 2.0 - reach, width / 2.0, width / 2.0 + reach]
    # Downward speed: positive rate on the left, negative on the right.
    flow = StressProfile(lambda x: gravity * (width / 2.0 - x), np.ones_like,
                split(0.0, width, cuts), (True, True), wall)
    rheology = _Chute(law, model, A, I0)
    return rheology.refined(lambda: rheology.profile(flow))


class _Chute(Rheology):
    """The chute, whose shear changes sign in the middle: ``flow.mu`` carries the sign."""

    def fluidity(self, flow, panels):
        unsigned = StressProfile(lambda x: np.abs(flow.mu(x)), flow.P,
                                 flow.ends, flow.walls, flow.wall)
        return super().fluidity(unsigned, panels)


def annular_shear(law, model, A, I0, inner, outer, wall="natural", density=0.0):
    """Return the `Profile` of the ring over the radius; its constant is mu_i.

    With a ``density`` phi I0^2 the pressure is P_w + integral of density v^2/r outward of r, and
    P and v are found in turn.
    """
    if not outer > inner:
        raise ValueError(f"outer radius {outer:g}: allowed is more than the inner one, {inner:g}")
    pressure, found = np.ones_like, None
    rheology = Rheology(law, model, A, I0)

    def make(mu_i):
        top = mu_i * pressure(np.array(inner))

        def mu(r):
            return top * (inner / r)**2 / pressure(r)

        if density:
            cut = root(lambda r: law.yield_ratio - mu(np.array(r)), inner, 1e3 * outer)
        else:
            cut = inner * np.sqrt(mu_i / law.yield_ratio)
        return StressProfile(mu, pressure, split(inner, outer, [cut]), (True, True), wall, True)

    for _ in range(60):
        before, found = found, rheology.refined(lambda: _driven(rheology, make, inner))
        if not density:
            return found
        panels, v = found.panels, found.v
        rise = panels.integral(density * v**2 / panels.x)
        level = 1.0 - rise[-1, -1] + rise
        pressure = lambda r, p=panels, values=level: p.at(values, r)  # noqa: E731
        if before and abs(found.constant - before.constant) < 1e-13:
            return found
    raise ValueError("pressure and speed of the ring do not settle")


def inclined_plane(law, model, A, I0, height, slope, wall="zero"):
    """Return the `Profile` of the slope, in degrees, over the height above the base."""
    angle = np.radians(slope)
    mu = float(np.tan(angle))
    if not mu < float(law.stress_ratio(np.asarray(1e12))[0]):
        raise ValueError(f"slope {slope:g}: no steady flow, as the law bears less")
    flow = StressProfile(lambda u: np.full_like(u, mu), lambda u: np.cos(angle) * u**2,
                np.sqrt(split(0.0, height)), (False, True), wall, depth=height)
    rheology = Rheology(law, model, A, I0)
    return rheology.refined(lambda: rheology.profile(flow))


# Heights and times

def stopping_height(law, A, slope):
    """Return H_stop = (pi/2) xi, d, of the primitive form on a slope in degrees; inf below yield.

    The base has g = 0 and the surface no flux.
    """
    mu = np.tan(np.radians(slope))
    if mu <= law.yield_ratio:
        return np.inf
    return float(np.pi / 2.0 * A / np.sqrt(law.inverse_length_squared(np.asarray(mu))[0]))


def slope_rate(law, I0, phi, height, slope):
    """Return the rate (< 0), gdot0, at which LI flow on a slope approaches Bagnold's profile.

    Of a small disturbance v', phi I0^2 dv'/dt = (eta v'')' with eta = mu_loc'(I) I0 sqrt(P). It
    is zero at the base and free at the surface, so that over the depth z

        v' = z^(1/4) J_(-1/3)((4/3) sqrt(q) z^(3/4)),   rate = -q mu_loc' sqrt(cos)/(phi I0).
    """
    from scipy.special import jv

    angle = np.radians(slope)
    I = law.inertial_number(np.asarray(np.tan(angle)))[0]
    zero = root(lambda x: jv(-1.0 / 3.0, x), 1.0, 3.0)
    q = (0.75 * zero)**2 / height**1.5
    return float(-q * law.stress_ratio(I)[1] * np.sqrt(np.cos(angle)) / (phi * I0))


def stopping_time(law, I0, phi, height, slope, velocity, dt, cells=100, rest=1e-6):
    """Return when LI flow on a slope below yield stops, 1/gdot0, from a profile of speed.

    Finite volumes and implicit Euler; the unknowns are shear stresses, for which
    s I_loc(|tau|/P) is monotone, and Newton's method needs no regularisation. The time is that at
    which all speeds lie below ``rest``, interpolated in the last step.

    Parameters
    ----------
    velocity : callable
        Speed (n,) at heights (n,) above the base at the start, d gdot0.
    dt : float
        Time step, 1/gdot0.
    """
    angle, h = np.radians(slope), height / cells
    density, middle = phi * I0**2, (np.arange(cells) + 0.5) * h
    P = np.cos(angle) * (height - np.arange(cells) * h)  # at the lower face of each cell
    s, v = np.sqrt(P) / I0, velocity(middle)
    spacing = np.full(cells, h)
    spacing[0] = h / 2.0  # from the wall to the first centre
    down = np.eye(cells) - np.eye(cells, k=-1)  # v_i - v_(i-1), the wall at rest
    coupling = dt / density * (down / spacing[:, None]) @ (down.T / h)
    tau, time = np.sin(angle) * (height - np.arange(cells) * h), 0.0
    limit = law.stress_ratio(np.full(cells, 1e12))[0]
    for _ in range(10**6):
        forced = down @ (v + dt / density * np.sin(angle)) / spacing
        for _ in range(100):
            I, slope_of_I = law.inertial_number(np.abs(tau) / P)
            miss = s * I * np.sign(tau) + coupling @ tau - forced
            change = np.linalg.solve(np.diag(s * slope_of_I / P) + coupling, miss)
            new = tau - change
            beyond = np.abs(new) >= limit * P  # half-way to what the law bears
            tau = np.where(beyond, 0.5 * (tau + np.sign(new) * limit * P), new)
            if np.abs(change).max() < 1e-10 * np.abs(P).max():  # the next one is below rounding
                break
        else:
            raise ValueError("the stress of the flow that stops does not settle")
        before, v = np.abs(v).max(), v + dt / density * (np.sin(angle) - down.T @ tau / h)
        time, now = time + dt, np.abs(v).max()
        if now < rest:
            return time - dt * (rest - now) / (before - now)
    raise ValueError("the flow does not stop")
