"""Growth rates of the homogeneous specimen between slipping plates, by an analytical solution.

The specimen is L wide and H high. It flows with v = (x1/2, -x2/2), its mesh moves with the
material, its lateral faces carry the normal stress sigma_1 and let no fluidity through, and its
plates let it slip. A disturbance of it separates: with k = n pi/H

    v1, P, g ~ cos(k x2),     v2, sigma_12 ~ sin(k x2)

satisfies every condition at the plates. Across x1 a linear system with constant coefficients
remains, in which D is the disturbance of the strain rate, w = (v1,2 - v2,1)/2, eta0 = mu P0 and
tau = mu P:

    v1,1 + v2,2 = 0                                                                     (2.9)
    sigma_11,1 + sigma_12,2 = phi rho_s (r + 1/2) v1                                    (2.2)
    sigma_12,1 + sigma_22,2 = phi rho_s (r - 1/2) v2
    D11 = (g tau/P)'/2 + r tau'/(2 G),      sigma_11 = tau' - P',  sigma_22 = -tau' - P'
    D12 = sigma_12/(2 eta0) + (r sigma_12 + 2 eta0 w)/(2 G)                             (2.3)
    A^2 d^2 lap g' = (A^2 d^2/xi^2) (g' - g_loc'),      g_loc = s I_loc(mu)/mu          (2.5)

G is the modulus of the Maxwell element, and 2 eta0 w is the Jaumann rate of the stress of the
base flow. LI has g' = g_loc' instead of the last equation, and the primitive form of NGF adds
t0 r g' to its right-hand side. A face that is displaced by zeta turns its load with it:

    sigma_11 = 0,    g',1 = 0,    sigma_12 = -2 mu P0 zeta,2,    r zeta = zeta/2 + v1

The base flow stretches the displacement at the rate 1/2. Both faces are displaced the same way
('sway', v1 even in x1) or opposite ways ('barrel', v1 odd). The rate r is that at which the
amplitude of the wave grows at points of the material, while the material shortens the wave. The
specimen is free to move along the plates. A solver that holds a corner does not change r without
inertia; with inertia the held corner couples the waves and changes r.

The solutions are exponentials exp(+-sqrt(q) x1). With lengths in 1/k and m = 1/(1 + r eta0/G),
the amplitudes (v1,1, P', eta0 g') are (2 q, N, F/(m mu)) with

    W = m eta0 [(1 + eta0/G) q + 1 - eta0/G],       R+- = phi rho_s (r +- 1/2)
    N = (q - 1) W - R- q - R+,                      F = 2 q (2 m eta0 - W + R-) + (1 + m mu) N

where q are the three roots, for LI two, of

    (1 + m beta) F - m mu (1/2 - m beta r eta0/G) N - 4 m^2 beta eta0 q
        - [A^2 d^2 (q - 1) - t0 r] F/(A^2 d^2/xi^2) = 0,    beta = mu/(I0 mu_loc'(I0)) - 1

and sigma_11 = 2 (W + R+), sigma_12 = -2 sqrt(q) W. The conditions at one face fix the weights of
the roots.

`column_growth_rate` is the formula that explains: the long-wave limit for a creeping column.
Units: d, |sigma_1| and 1/gdot0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from scipy.linalg import expm

MODELS = "ngf", "ngf_primitive", "li"
#: Both faces displaced the same way, or opposite ways.
PARITIES = "sway", "barrel"
#: Roots whose exponentials differ over half a width by less than this exponent share a block.
CLOSE = 1.0
#: The secant method ends when the growth rate changes by less than the first, relatively, or by
#: less than the second and no less than in the step before.
TOLERANCE, ROUNDING = 1e-12, 1e-8
#: How far the secant method may take a growth rate from the collocated one, relatively.
TRUST = 0.01


def growth_rate(law, model, *, inertial_number, width, height, half_waves=1, parity="sway",
                amplitude=0.48, density=0.0, shear_modulus=None, relaxation_time=None):
    """Return the growth rate of one sine wave along the specimen.

    Rigid-viscous quasi-static flow has one growth rate for each wave and parity. Inertia,
    elasticity and t0 add others; this is the one with the largest real part. Chebyshev collocation
    finds it among all of them and the exact solution corrects it. Without inertia, elastic stress
    also relaxes in ever shorter waves, at rates that accumulate at -(1 - mu) G/(mu P0); these do
    not count.

    Parameters
    ----------
    law : object
        It has ``stress_ratio(I)``, which returns mu_loc and its derivative, and, for both forms
        of NGF, ``inverse_length_squared(mu)``, which returns A^2 d^2/xi^2 and its derivative.
    model : str
        One of `MODELS`.
    inertial_number : float
        I0 of the homogeneous flow.
    width, height : float
        L and H, d.
    half_waves : int
        Number n of half waves over the height: k = n pi/H.
    parity : str
        sway or barrel.
    amplitude : float
        Non-local amplitude A.
    density : float
        phi rho_s = phi I0^2 P0, |sigma_1|/(d gdot0)^2; 0 is quasi-static flow.
    shear_modulus : float or None
        G, |sigma_1|; None or infinity is rigid.
    relaxation_time : float or None
        t0 of ngf_primitive, 1/gdot0; None for the other models.

    Returns
    -------
    float or complex
        r, gdot0; complex, with a positive imaginary part, if the mode oscillates.

    Raises
    ------
    ValueError
        If an argument is out of bounds, or the specimen buckles elastically, at once.
    RuntimeError
        If the exact solution does not confirm the collocated growth rate.
    """
    return _Across.of(law, model, inertial_number, width, height, half_waves, parity, amplitude,
                      density, shear_modulus, relaxation_time).growth_rate()


@dataclass(frozen=True)
class Mode:
    """A mode across the specimen, for a right face that is displaced by cos(k x2) times 1 d.

    Attributes
    ----------
    growth_rate : float or complex
        r, gdot0.
    velocity : ndarray, shape (2, ...)
        Factors of cos(k x2) in v1 and of sin(k x2) in v2, d gdot0.
    pressure, fluidity : ndarray, shape (...)
        Factors of cos(k x2) in P', |sigma_1|, and in g', gdot0.
    """

    growth_rate: object
    velocity: np.ndarray
    pressure: np.ndarray
    fluidity: np.ndarray


def mode(x1, law, model, **specimen):
    """Return the `Mode` that has the growth rate of `growth_rate`.

    Parameters
    ----------
    x1 : ndarray
        Distances from the middle of the specimen, between -L/2 and L/2, d.
    law, model, **specimen
        As for `growth_rate`, which also tells what is raised.

    Returns
    -------
    Mode
        Disturbances at fixed places. The arrays have the shape of ``x1`` and are complex if the
        growth rate is.
    """
    arguments = {"half_waves": 1, "parity": "sway", "amplitude": 0.48, "density": 0.0,
                 "shear_modulus": None, "relaxation_time": None, **specimen}
    across = _Across.of(law, model, **arguments)
    x1 = np.asarray(x1, dtype=float)
    if not (np.abs(x1) <= across.half * across.length * (1.0 + 1e-12)).all():
        raise ValueError("x1: allowed are numbers between -L/2 and L/2")
    r = across.growth_rate()
    v1, v2, P, g = across.fields(r, x1 / across.length)
    if not np.iscomplexobj(r):
        v1, v2, P, g = v1.real, v2.real, P.real, g.real
    k = 1.0 / across.length
    return Mode(r, np.array([v1, v2]), k * P, k * g / across.viscosity)


def column_growth_rate(law, model, *, inertial_number, width, height, half_waves=1,
                       amplitude=0.48, density=0.0, relaxation_time=None):
    """Return the growth rate at which a specimen sways as a column does that creeps.

    It leans in ``half_waves`` n half sine waves, k = n pi/H. The plates press with N beyond the
    lateral stress; E is the tangent viscosity of the axial stress::

        phi rho_s L r^2 + E (L^3/12) k^4 r - N k^2 = 0,    N = (|sigma_2| - |sigma_1|) L = 2 mu P0 L
        E = 4 M P0^2/|sigma_1|,    M = I0 mu_loc'(I0) + A^2 d^2 (12/L^2 + k^2) + t0 r

    For NGF a fluidity that varies across the width ends at faces without flux, in layers of
    A d/sqrt(mu), and this adds the 12/L^2 to bending. LI has no such term. t0, which only
    the primitive form has, delays growth as inertia does. The formula is good for H >= 3 L.

    Parameters
    ----------
    law, model, inertial_number, width, height, half_waves, amplitude, density, relaxation_time
        As for `growth_rate`.

    Returns
    -------
    float
        The positive root r, gdot0.

    Raises
    ------
    ValueError
        If an argument is out of bounds.
    """
    _check(model, inertial_number, width, height, half_waves, amplitude, density, relaxation_time)
    mu, slope = _stress_ratio(law, inertial_number)
    P, L, k = 1.0 / (1.0 - mu), width, half_waves * np.pi / height
    M = inertial_number * slope
    if model != "li":
        M = M + amplitude**2 * (12.0 / L**2 + k**2)
    stiffness, load = 4.0 * P**2 * L**3 / 12.0 * k**4, 2.0 * mu * P * L * k**2
    bending, delay = M * stiffness, density * L + (relaxation_time or 0.0) * stiffness
    # The positive root, in the form that needs neither inertia nor t0.
    return float(2.0 * load / (bending + np.sqrt(bending**2 + 4.0 * delay * load)))


def _check(model, inertial_number, width, height, half_waves, amplitude, density, relaxation_time):
    """Raise `ValueError` for an argument out of bounds."""
    if model not in MODELS:
        raise ValueError(f"model {model}: allowed is {' | '.join(MODELS)}")
    for name, value in (("inertial number", inertial_number), ("width", width),
                        ("height", height), ("amplitude", amplitude)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"{name} {value}: allowed is a number > 0")
    if half_waves < 1 or half_waves != int(half_waves):
        raise ValueError(f"half waves {half_waves}: allowed is an integer >= 1")
    if not 0.0 <= density < np.inf:
        raise ValueError(f"density {density}: allowed is a number >= 0")
    if (model == "ngf_primitive") != (relaxation_time is not None):
        raise ValueError(f"relaxation time: the model {model} "
                         f"{'needs one' if relaxation_time is None else 'has none'}")
    if relaxation_time is not None and not 0.0 < relaxation_time < np.inf:
        raise ValueError(f"relaxation time {relaxation_time}: allowed is a number > 0")


def _stress_ratio(law, inertial_number):
    """Return mu_loc(I0) and its derivative, two floats. Raises `ValueError` where P0 is missing."""
    mu, slope = (float(part) for part in law.stress_ratio(np.asarray(float(inertial_number))))
    if not 0.0 < mu < 1.0:
        raise ValueError(f"inertial number {inertial_number}: mu_loc(I0) is {mu:.4g}, and "
                         "plane-strain compression needs it between 0 and 1 (3.19)")
    if not 0.0 < slope < np.inf:
        raise ValueError(f"inertial number {inertial_number}: mu_loc'(I0) is {slope:.4g}; the "
                         "theory needs a law that rises")
    return mu, slope


@dataclass(frozen=True)
class _Across:
    """The linear system across the specimen, with lengths in 1/k.

    Attributes
    ----------
    mu, viscosity, beta : float
        mu, eta0 = mu P0 and mu/(I0 mu_loc'(I0)) - 1.
    spread : float or None
        xi^2 k^2; None for LI.
    relaxation : float
        t0 over A^2 d^2/xi^2, 1/gdot0; 0 but for the primitive form.
    density : float
        phi rho_s/k^2, |sigma_1|/gdot0^2.
    softness : float
        eta0/G, 1/gdot0; 0 is rigid.
    half : float
        k L/2.
    sways : bool
        Whether v1 is even in x1.
    length : float
        1/k, d.
    """

    mu: float
    viscosity: float
    beta: float
    spread: object
    relaxation: float
    density: float
    softness: float
    half: float
    sways: bool
    length: float

    @classmethod
    def of(cls, law, model, inertial_number, width, height, half_waves, parity, amplitude, density,
           shear_modulus, relaxation_time):
        """Return the system for the arguments of `growth_rate`. Raises `ValueError`."""
        _check(model, inertial_number, width, height, half_waves, amplitude, density,
               relaxation_time)
        if parity not in PARITIES:
            raise ValueError(f"parity {parity}: allowed is {' | '.join(PARITIES)}")
        mu, slope = _stress_ratio(law, inertial_number)
        k, viscosity = half_waves * np.pi / height, mu / (1.0 - mu)
        spread, relaxation = None, 0.0
        if shear_modulus is not None and not shear_modulus > viscosity:
            # With the Jaumann rate, elastic waves along x2 then have no real speed.
            raise ValueError(f"shear modulus {shear_modulus}: allowed is a number above mu P0, "
                             f"{viscosity:.4g}, or None")
        if model != "li":
            if getattr(law, "inverse_length_squared", None) is None:
                raise ValueError(f"the law {type(law).__name__} has no cooperativity length, so "
                                 "that NGF is not defined with it; allowed is the model li")
            inverse = float(law.inverse_length_squared(np.asarray(mu))[0])
            spread, relaxation = (amplitude * k)**2 / inverse, (relaxation_time or 0.0) / inverse
        softness = 0.0 if shear_modulus is None else viscosity / shear_modulus
        return cls(mu, viscosity, mu / (inertial_number * slope) - 1.0, spread, relaxation,
                   density / k**2, softness, k * width / 2.0, parity == "sway", 1.0 / k)

    # The exact solution at one growth rate

    def polynomials(self, r):
        """Return W, W + R+, N, F/(m mu) and the characteristic polynomial in q, ascending."""
        m = 1.0 / (1.0 + self.softness * r)
        viscosity, local = m * self.viscosity, m * self.mu
        above, below = self.density * (r + 0.5), self.density * (r - 0.5)
        W = viscosity * np.array([1.0 - self.softness, 1.0 + self.softness])
        N = polynomial.polysub(polynomial.polymul(W, [-1.0, 1.0]), [above, below])
        F = (2.0 * polynomial.polymul([0.0, 1.0],
                                      polynomial.polysub([2.0 * viscosity + below], W))
             + (1.0 + local) * N)
        beta = m * self.beta
        characteristic = ((1.0 + beta) * F - local * (0.5 - beta * self.softness * r) * N
                          - np.array([0.0, 4.0 * beta * viscosity, 0.0]))
        if self.spread is not None:
            characteristic = polynomial.polysub(
                characteristic, polynomial.polymul(
                    [-self.spread - self.relaxation * r, self.spread], F))
        return W, polynomial.polyadd(W, [above]), N, F / local, characteristic

    def blocks(self, r, x):
        """Return the solutions of the parity at places ``x`` (...), and at the face.

        Returns
        -------
        list of (ndarray, ndarray)
            For each block of roots the amplitudes of v1, v2, P', eta0 g' at ``x``,
            (4, ..., size), and those of sigma_11, sigma_12, eta0 g',1 and v1 at the face,
            (4, size). They carry one factor that keeps large exponentials in bounds.
        """
        W, normal, N, F, characteristic = self.polynomials(r)
        found = []
        for roots in _blocks(_roots(characteristic), self.half):
            # The first row of a function of this matrix holds the divided differences of the
            # function at the roots: solutions that stay apart where roots meet.
            K = np.diag(roots) + np.diag(np.ones(len(roots) - 1), 1) / self.half**2
            normal_K, W_K, N_K, F_K = (_polynomial_of(part, K) for part in (normal, W, N, F))
            # Solutions that go like v1,1, and those that go like v1, at the face and at x.
            rate, v1 = self._waves(K, np.asarray(self.half))
            rate_x, v1_x = self._waves(K, x)
            face = [2.0 * normal_K @ rate, -2.0 * W_K @ v1, F_K @ v1, 2.0 * v1]
            inner = [2.0 * v1_x, -2.0 * K @ rate_x, N_K @ rate_x, F_K @ rate_x]
            found.append(tuple(np.array([part[..., 0, :] for part in parts])
                               for parts in (inner, face)))
        return found

    def _waves(self, K, x):
        """Return the functions of K, (..., size, size), that go like v1,1/q and like v1."""
        cosh, sinh = _cosh_sinh(K, x, self.half)
        return (sinh, cosh) if self.sways else (cosh, K @ sinh)

    def fields(self, r, x):
        """Return v1, v2, P' and eta0 g' at ``x`` (...) for a face displaced by 1, (4, ...)."""
        blocks = self.blocks(r, x)
        face = np.concatenate([part for _, part in blocks], axis=1)
        conditions = face[[0, 1]] if self.spread is None else face[:3]
        columns = np.abs(conditions).max(axis=0)
        conditions = conditions / columns
        rows = np.abs(conditions).max(axis=1)
        load = np.zeros(len(rows))
        load[1] = 2.0 * self.viscosity  # -2 mu P0 zeta,2 = 2 mu P0 sin(x2)
        weights = np.linalg.solve(conditions / rows[:, None], load / rows) / columns
        return np.concatenate([part for part, _ in blocks], axis=-1) @ weights

    def response(self, r):
        """Return what a face displaced by 1 that grows at the rate r would make it grow at."""
        return self.fields(r, np.asarray(self.half))[0] + 0.5

    # Its growth rate

    def growth_rate(self):
        """Return r, as `growth_rate` does."""
        if not (self.density or self.softness or self.relaxation):
            return float(self.response(0.0).real)
        if self.softness and not self.density:
            # An elastic specimen under more than its critical load moves faster than any rate.
            fast = 1e9 / self.softness
            if self.response(fast).real >= fast:
                raise ValueError("the shear modulus is so small that the specimen buckles "
                                 "elastically, at once")
        for start in self.spectrum():
            r = self._secant(start)
            if r is not None:
                return complex(r) if r.imag else float(r.real)
            if self.density or start.real > 0.0:  # not one of those that relax
                break
        raise RuntimeError(f"the exact solution does not confirm the growth rate {start:.6g} of "
                           "the collocation")

    def _secant(self, start):
        """Return the root of response(r) = r near ``start``, or None where it is far."""
        real = not start.imag
        before, r, step = start, start * (1.0 + 1e-5) + 1e-8, np.inf
        excess = self.response(before) - before
        for _ in range(50):
            now = self.response(r) - r
            if now == excess:
                break
            last, step = step, now * (r - before) / (now - excess)
            before, excess, r = r, now, r - step
            if real:
                r = r.real + 0.0j
            # Rounding ends the decrease of the steps of a slender specimen.
            if abs(step) <= TOLERANCE * abs(r) or abs(last) <= abs(step) <= ROUNDING * abs(r):
                break
        else:
            return None
        return r if abs(r - start) <= TRUST * (1.0 + abs(start)) else None

    def spectrum(self):
        """Return all growth rates of a Chebyshev collocation, (m,), largest real part first.

        Of a pair the one with the positive imaginary part is there. Collocation takes half the
        width, on polynomials of the parity of each field.
        """
        layer = 1.0 if self.spread is None else np.sqrt(max(1.0, (1.0 + self.beta) / self.spread))
        count = 24 + int(self.half + 2.0 * np.sqrt(self.half * layer))
        rates, values = self._collocated(count)
        scale = np.abs(values).max(axis=1, keepdims=True)
        inverse = np.linalg.eigvals(np.linalg.solve(values / scale, rates / scale))
        inverse = inverse[np.abs(inverse) > 1e-9 * np.abs(inverse).max()]
        found = 1.0 / inverse
        found = np.where(np.abs(found.imag) <= 1e-9 * np.abs(found), found.real, found)
        found = found[found.imag >= 0.0]
        return found[np.argsort(-found.real)]

    def _collocated(self, count):
        """Return matrices B and A of r B y = A y on ``count`` points between middle and face."""
        mu, eta, softness, X = self.mu, self.viscosity, self.softness, self.half
        places = np.append(np.cos((np.arange(count) + 0.5) * np.pi / (2 * count)), 1.0)
        points, face = slice(0, count), slice(count, count + 1)
        even = {"v1": self.sways, "normal": not self.sways, "shear": self.sways,
                "deviator": not self.sways}
        sizes = {"v1": count, "normal": count + 1, "shear": count + 1, "deviator": count}
        if self.spread is not None:
            even["fluidity"], sizes["fluidity"] = not self.sways, count + 1
        starts = dict(zip(sizes, np.cumsum([0, *sizes.values()])))
        total = sum(sizes.values()) + 1  # the last unknown is the displacement of the face
        tables = {}
        for name, size in sizes.items():
            series = np.eye(2 * size)[:, (0 if even[name] else 1)::2]
            tables[name] = [chebyshev.chebval(places, chebyshev.chebder(series, m)).T / X**m
                            for m in range(3)]
        left, right = [], []

        def equation(where, rates, values, displacement=(0.0, 0.0)):
            """Add rates r = values; a term is (field, order of the derivative): coefficient."""
            height = places[where].size
            for rows, terms, last in ((left, rates, displacement[0]),
                                      (right, values, displacement[1])):
                row = np.zeros((height, total))
                for (name, order), coefficient in terms.items():
                    columns = slice(starts[name], starts[name] + sizes[name])
                    row[:, columns] += coefficient * tables[name][order][where]
                row[:, -1] = last
                rows.append(row)

        # normal and shear are sigma_11 and sigma_12, deviator tau' = normal + P', fluidity eta0 g';
        # v2 = -v1,1.
        v1, normal, shear, deviator, g = "v1", "normal", "shear", "deviator", "fluidity"
        equation(points, {(v1, 0): self.density},
                 {(normal, 1): 1.0, (shear, 0): 1.0, (v1, 0): -0.5 * self.density})
        equation(points, {(v1, 1): -self.density},
                 {(shear, 1): 1.0, (deviator, 0): 2.0, (normal, 0): -1.0,
                  (v1, 1): -0.5 * self.density})
        equation(points, {(shear, 0): softness},
                 {(v1, 2): -eta * (1.0 + softness), (v1, 0): eta * (softness - 1.0),
                  (shear, 0): -1.0})
        # eta0 g_loc' = P'/2 + (beta/mu) (tau' - mu P'), and 2 eta0 D11 = mu eta0 g' + tau' - mu P'
        # + softness r tau'.
        local = {(deviator, 0): 0.5 - self.beta + self.beta / mu, (normal, 0): self.beta - 0.5}
        flow = {(v1, 1): 2.0 * eta, (deviator, 0): mu - 1.0, (normal, 0): -mu}
        if self.spread is None:
            for term, coefficient in local.items():
                flow[term] -= mu * coefficient
        else:
            equation(points, {(g, 0): self.relaxation},
                     {(g, 2): self.spread, (g, 0): -self.spread - 1.0, **local})
            equation(face, {}, {(g, 1): 1.0})
            flow[g, 0] = -mu
        equation(points, {(deviator, 0): softness}, flow)
        equation(face, {}, {(normal, 0): 1.0})
        equation(face, {}, {(shear, 0): 1.0}, (0.0, -2.0 * eta))
        equation(face, {}, {(v1, 0): 1.0}, (1.0, 0.5))
        return np.concatenate(left), np.concatenate(right)


def _roots(coefficients):
    """Return the roots (2,) or (3,) of a polynomial given in ascending order, complex.

    Of a cubic the largest one is corrected and divided out, so that sum and product of the
    others, however close, keep their digits.
    """
    coefficients = np.asarray(coefficients) / coefficients[-1]
    largest = []
    if coefficients.size == 4:
        found = np.roots(coefficients[::-1])
        root, slopes = found[np.argmax(np.abs(found))] + 0.0j, polynomial.polyder(coefficients)
        for _ in range(3):
            slope = polynomial.polyval(root, slopes)
            root = root - polynomial.polyval(root, coefficients) / slope if slope else root
        product = -coefficients[0] / root
        coefficients, largest = [product, (product - coefficients[1]) / root], [root]
    product, total = coefficients[0], coefficients[1]
    split = np.sqrt(total * total - 4.0 * product + 0.0j)
    first = -(total + (split if (np.conj(total) * split).real >= 0.0 else -split)) / 2.0
    return np.array([first, product / first, *largest])


def _blocks(roots, half):
    """Return lists of roots whose exponentials are close to each other over the length half."""
    blocks = []
    for root in roots:
        near = [block for block in blocks if any(
            min(abs(np.sqrt(root) - np.sqrt(other)), abs(np.sqrt(root) + np.sqrt(other))) * half
            < CLOSE for other in block)]
        blocks = [block for block in blocks if block not in near] + [sum(near, []) + [root]]
    return blocks


def _polynomial_of(coefficients, K):
    """Return a polynomial, given in ascending order, of a square matrix."""
    value = np.zeros_like(K)
    for coefficient in coefficients[::-1]:
        value = value @ K + coefficient * np.eye(len(K))
    return value


def _cosh_sinh(K, x, half):
    """Return cosh(sqrt(K) x) and sinh(sqrt(K) x)/sqrt(K), both times exp(-fastest half).

    Parameters
    ----------
    K : ndarray, shape (size, size)
        Upper triangular.
    x : ndarray, shape (...)
        Places with |x| <= ``half``.
    half : float

    Returns
    -------
    ndarray, ndarray
        Shapes (..., size, size). They are blocks of the exponential of x [[0, 1], [K, 0]].
    """
    size, x = len(K), np.asarray(x, dtype=float)[..., None, None]
    fastest, one = np.sqrt(np.diag(K)).real.max(), np.eye(len(K))
    generator = np.block([[0.0 * one, one], [K, 0.0 * one]])
    found = expm(x * generator - fastest * half * np.eye(2 * size))
    return found[..., :size, :size], found[..., :size, size:]
