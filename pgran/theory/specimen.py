"""Growth rates of the homogeneous specimen between slipping plates, by an analytical solution.

The specimen is L wide and H high. It flows with v = (x1/2, -x2/2), and its mesh moves with the
material. The lateral faces carry the normal stress sigma_1 and have no flux of fluidity, and the
plates are free of friction. Disturbances separate: with k = n pi/H

    v1, P, g ~ cos(k x2),     v2, sigma_12 ~ sin(k x2)

satisfies every condition at the plates. A linear system with constant coefficients remains across
x1. Let D be the disturbance of the strain rate, w = (v1,2 - v2,1)/2, eta0 = mu P0 and tau = mu P:

    v1,1 + v2,2 = 0                                                                     (2.9)
    sigma_11,1 + sigma_12,2 = phi rho_s (r + 1/2) v1                                    (2.2)
    sigma_12,1 + sigma_22,2 = phi rho_s (r - 1/2) v2
    D11 = (g tau/P)'/2 + r tau'/(2 G),      sigma_11 = tau' - P',  sigma_22 = -tau' - P'
    D12 = sigma_12/(2 eta0) + (r sigma_12 + 2 eta0 w)/(2 G)                             (2.3)
    A^2 d^2 lap g' = (A^2 d^2/xi^2) (g' - g_loc'),      g_loc = s I_loc(mu)/mu          (2.5)

G is the modulus of the Maxwell element, and 2 eta0 w is the Jaumann rate of the stress of the
base flow. LI replaces the last equation by g' = g_loc'. Dynamic NGF adds t0 r g' to the right-hand
side of the last equation. The load rotates with a face that is displaced by zeta:

    sigma_11 = 0,    g',1 = 0,    sigma_12 = -2 mu P0 zeta,2,    r zeta = zeta/2 + v1

The base flow stretches the displacement at the rate 1/2. Both faces are displaced in the same
direction ('sway', v1 even in x1) or in opposite directions ('barrel', v1 odd). r is the growth
rate of the amplitude at material points, while the material shortens the wave. The specimen may
move along the plates. If a solver holds a corner, r is the same without inertia; with inertia the
corner couples the waves and changes r.

The solutions are exponentials exp(+-sqrt(q) x1). With lengths in 1/k, R+ = phi rho_s (r + 1/2) and
m = 1/(1 + r eta0/G), the amplitudes of v1,1, eta0 g', sigma_11 and sigma_12 are 2 q, F/(m mu),
2 (W + R+) and -2 sqrt(q) W, where q are the three roots (two for LI) of the characteristic
polynomial. `_Across.polynomials` defines it, W and F. The conditions at one face determine the
weights of the roots.

`column_growth_rate` is the long-wave limit, a creeping column. Units: d, |sigma_1| and 1/gdot0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import matrix_power
from numpy.polynomial import Polynomial, chebyshev
from scipy.linalg import expm
from scipy.sparse.csgraph import connected_components

from . import check_relaxation_time, inverse_length_squared

MODELS = "ngf", "ngf_primitive", "li"
#: The faces are displaced in the same direction, or in opposite directions.
PARITIES = "sway", "barrel"
#: Roots whose exponents over half a width differ by less than this form a block.
CLOSE = 1.0
#: Largest relative difference between the growth rates of secant method and collocation.
TRUST = 0.01


@dataclass
class Specimen:
    """A specimen and a wave, the arguments of `growth_rate` and `column_growth_rate`.

    The other attributes are mu_loc(I0) (``mu``), mu_loc'(I0) (``slope``), ``viscosity`` eta0 =
    mu P0 in |sigma_1|/gdot0, and ``wave_number`` k = n pi/H in 1/d.
    """

    law: object
    model: str
    inertial_number: float
    #: L and H, d.
    width: float
    height: float
    #: Number n of half waves over the height.
    half_waves: int = 1
    parity: str = "sway"
    #: Non-local amplitude A.
    amplitude: float = 0.48
    #: phi rho_s = phi I0^2 P0, |sigma_1|/(d gdot0)^2; 0 for quasi-static flow.
    density: float = 0.0
    #: G, |sigma_1|; infinite for a rigid-viscous material.
    shear_modulus: float = np.inf
    #: t0 of ngf_primitive, 1/gdot0; None for other models.
    relaxation_time: object = None

    def __post_init__(self):
        for name, choices in (("model", MODELS), ("parity", PARITIES)):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} {getattr(self, name)}: expected one of: "
                                 f"{', '.join(choices)}")
        for name in ("inertial_number", "width", "height", "amplitude", "half_waves"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name)}: must be a number > 0")
        check_relaxation_time(self.model, self.relaxation_time)
        self.mu, self.slope = (float(part) for part in self.law.stress_ratio(
            np.asarray(float(self.inertial_number))))
        where = f"inertial_number {self.inertial_number}"
        if not 0.0 < self.mu < 1.0:
            raise ValueError(f"{where}: mu_loc(I0) is {self.mu:.4g}; plane-strain compression "
                             "requires a value between 0 and 1 (3.19)")
        if not 0.0 < self.slope < np.inf:
            raise ValueError(f"{where}: mu_loc'(I0) is {self.slope:.4g}; the theory requires a "
                             "number > 0")
        self.viscosity = self.mu / (1.0 - self.mu)
        self.wave_number = self.half_waves * np.pi / self.height
        if not self.shear_modulus > self.viscosity:
            # With the Jaumann rate, elastic waves along x2 then have no real speed.
            raise ValueError(f"shear_modulus {self.shear_modulus}: must be a number > mu P0 = "
                             f"{self.viscosity:.4g}")


def growth_rate(law, model, **specimen):
    """Return the growth rate of one sine wave along the specimen.

    The arguments are attributes of `Specimen`. Rigid-viscous quasi-static flow has one growth rate
    per wave and parity. Inertia, elasticity and t0 add more; the result is the one with the largest
    real part. Chebyshev collocation finds all of them, and the exact solution corrects the largest
    one. Without inertia, elastic stress also relaxes in arbitrarily short waves, at rates that
    accumulate at -(1 - mu) G/(mu P0); these rates are ignored. The result r, gdot0, is complex,
    with a positive imaginary part, if the mode oscillates.
    """
    across = _Across(Specimen(law, model, **specimen))
    if not (across.density or across.softness or across.relaxation):
        return float(across.response(0.0).real)
    if across.softness and not across.density:
        # The growth rate is infinite if the load exceeds the elastic buckling load.
        fast = 1e9 / across.softness
        if across.response(fast).real >= fast:
            raise ValueError("the shear modulus is so small that the specimen buckles elastically")
    for start in across.spectrum():
        r = across.exact_rate(start)
        if r is not None:
            return complex(r) if r.imag else float(r.real)
        if across.density or start.real > 0.0:  # not a relaxation of elastic stress
            break
    raise RuntimeError(f"the exact solution does not confirm the growth rate {start:.6g} of "
                       "the collocation")


def column_growth_rate(law, model, **specimen):
    """Return the growth rate of the specimen as a creeping column that sways.

    The arguments are attributes of `Specimen`; parity and shear modulus have no effect. With the
    load N beyond the lateral stress and the tangent viscosity E of the axial stress::

        phi rho_s L r^2 + E (L^3/12) k^4 r - N k^2 = 0,    N = (|sigma_2| - |sigma_1|) L = 2 mu P0 L
        E = 4 M P0^2/|sigma_1|,    M = I0 mu_loc'(I0) + A^2 d^2 (12/L^2 + k^2) + t0 r

    The layers of thickness A d/sqrt(mu) at the faces of NGF add 12/L^2 to bending; LI has no term
    with A. The result, the positive root r in gdot0, is accurate for H >= 3 L.
    """
    p = Specimen(law, model, **specimen)
    P, L, k, M = 1.0 / (1.0 - p.mu), p.width, p.wave_number, p.inertial_number * p.slope
    if model != "li":
        M = M + p.amplitude**2 * (12.0 / L**2 + k**2)
    stiffness, load = 4.0 * P**2 * L**3 / 12.0 * k**4, 2.0 * p.mu * P * L * k**2
    bending, delay = M * stiffness, p.density * L + (p.relaxation_time or 0.0) * stiffness
    # This form of the positive root is valid without inertia and t0.
    return float(2.0 * load / (bending + np.sqrt(bending**2 + 4.0 * delay * load)))


class _Across:
    """The linear system across a `Specimen`, with lengths in 1/k: density is phi rho_s/k^2."""

    def __init__(self, p):
        self.k, self.mu, self.viscosity = p.wave_number, p.mu, p.viscosity
        self.beta = p.mu / (p.inertial_number * p.slope) - 1.0
        self.spread = self.relaxation = 0.0  # of LI
        if p.model != "li":
            inverse = float(inverse_length_squared(p.law, np.asarray(p.mu))[0])
            self.spread = (p.amplitude * self.k)**2 / inverse  # xi^2 k^2
            self.relaxation = (p.relaxation_time or 0.0) / inverse
        self.density = p.density / self.k**2
        self.softness = p.viscosity / p.shear_modulus
        self.half = self.k * p.width / 2.0
        self.sways = p.parity == "sway"

    def polynomials(self, r):
        """W, W + R+, F/(m mu) and the characteristic polynomial in q."""
        q, m = Polynomial([0.0, 1.0]), 1.0 / (1.0 + self.softness * r)
        viscosity, local, beta = m * self.viscosity, m * self.mu, m * self.beta
        above, below = self.density * (r + 0.5), self.density * (r - 0.5)  # R+ and R-
        W = viscosity * ((1.0 + self.softness) * q + 1.0 - self.softness)
        N = (q - 1.0) * W - below * q - above
        F = 2.0 * q * (2.0 * viscosity - W + below) + (1.0 + local) * N
        characteristic = ((1.0 + beta - self.spread * (q - 1.0) + self.relaxation * r) * F
                          - local * (0.5 - beta * self.softness * r) * N
                          - 4.0 * beta * viscosity * q)
        return W, W + above, F / local, characteristic

    def response(self, r):
        """Growth rate v1/zeta + 1/2 of a face, for disturbances with the growth rate r.

        The solutions are scaled by a common factor, which prevents the overflow of exponentials.
        """
        W, normal, F, characteristic = self.polynomials(r)
        roots = _roots(characteristic)
        exponents = np.sqrt(roots) * self.half
        differences, sums = exponents[:, None] - exponents, exponents[:, None] + exponents
        count, labels = connected_components(
            np.minimum(np.abs(differences), np.abs(sums)) < CLOSE)
        blocks = []
        for label in range(count):
            block = roots[labels == label]
            # The first row of a function of this matrix consists of the divided differences of
            # the function at the roots. They remain independent where roots coincide.
            K = np.diag(block) + np.diag(np.ones(len(block) - 1), 1) / self.half**2
            # The exponential of [[0, 1], [K, 0]] half consists of cosh(sqrt(K) half) and
            # sinh(sqrt(K) half)/sqrt(K).
            one = np.eye(len(block))
            fastest = np.sqrt(block).real.max() * np.eye(2 * len(block))
            exponential = expm(self.half * (np.block([[0.0 * K, one], [K, 0.0 * K]]) - fastest))
            cosh, sinh = np.hsplit(exponential[:len(block)], 2)
            # Solutions proportional to v1,1/q and to v1 at the face.
            rate, v1 = (sinh, cosh) if self.sways else (cosh, K @ sinh)
            normal_K, W_K, F_K = (
                sum(c * matrix_power(K, n) for n, c in enumerate(part.coef))
                for part in (normal, W, F))
            blocks.append([part[0] for part in (
                2.0 * normal_K @ rate, -2.0 * W_K @ v1, F_K @ v1, 2.0 * v1)])
        face = np.concatenate(blocks, axis=1)  # sigma_11, sigma_12, eta0 g',1 and v1
        conditions = face[:len(roots)]
        columns = np.abs(conditions).max(axis=0)
        conditions = conditions / columns
        rows = np.abs(conditions).max(axis=1)
        load = np.zeros(len(rows))
        load[1] = 2.0 * self.viscosity  # -2 mu P0 zeta,2 = 2 mu P0 sin(x2)
        weights = np.linalg.solve(conditions / rows[:, None], load / rows) / columns
        return (face @ weights)[3] + 0.5

    def exact_rate(self, start):
        """Root of response(r) = r, or None if it is not close to ``start``."""
        from scipy.optimize import newton  # slow to import

        def excess(r):
            found = self.response(r) - r
            return found if start.imag else found.real

        first = start if start.imag else start.real
        r, secant = newton(excess, first, x1=first * (1.0 + 1e-5) + 1e-8, rtol=1e-8, tol=1e-12,
                           full_output=True, disp=False)
        near = abs(r - start) <= TRUST * (1.0 + abs(start))
        return r if secant.converged and near else None

    def spectrum(self):
        """Growth rates (m,) of a collocation over half the width, largest real part first.

        Of a complex pair only the rate with positive imaginary part is included.
        """
        layer = np.sqrt(max(1.0, (1.0 + self.beta) / self.spread)) if self.spread else 1.0
        count = 24 + int(self.half + 2.0 * np.sqrt(self.half * layer))
        values = self._collocated(count, 0.0)
        rates = values - self._collocated(count, 1.0)
        scale = np.abs(values).max(axis=1, keepdims=True)
        inverse = np.linalg.eigvals(np.linalg.solve(values / scale, rates / scale))
        inverse = inverse[np.abs(inverse) > 1e-9 * np.abs(inverse).max()]
        found = 1.0 / inverse
        found = np.where(np.abs(found.imag) <= 1e-9 * np.abs(found), found.real, found)
        found = found[found.imag >= 0.0]
        return found[np.argsort(-found.real)]

    def _collocated(self, count, r):
        """Matrix, linear in r, of equations at ``count`` points between middle and face."""
        mu, eta, softness, X = self.mu, self.viscosity, self.softness, self.half
        positions = np.append(np.cos((np.arange(count) + 0.5) * np.pi / (2 * count)), 1.0)
        points, face = slice(count), slice(count, None)
        # normal and shear are sigma_11 and sigma_12, deviator tau' = normal + P', fluidity eta0 g';
        # v2 = -v1,1. The last unknown is the displacement of the face.
        fields = v1, normal, shear, deviator, g = "v1", "normal", "shear", "deviator", "fluidity"
        columns, tables, total = {}, {}, 0
        for name in fields:
            size = count + (name in (normal, shear) or name == g and self.spread > 0.0)
            even = self.sways == (name in (v1, shear))
            series = np.eye(2 * size)[:, (0 if even else 1)::2]
            tables[name] = [chebyshev.chebval(positions, chebyshev.chebder(series, m)).T / X**m
                            for m in range(3)]
            columns[name], total = slice(total, total + size), total + size

        def equation(where, terms, displacement=0.0):
            """Terms are {(field, order of the derivative): coefficient}."""
            rows = np.zeros((count + 1, total + 1))
            for (name, order), coefficient in terms.items():
                rows[:, columns[name]] += coefficient * tables[name][order]
            rows[:, -1] = displacement
            return rows[where]

        # eta0 g_loc' = P'/2 + (beta/mu) (tau' - mu P'), and 2 eta0 D11 = mu eta0 g' + tau' - mu P'
        # + softness r tau'.
        rows = [
            equation(points, {(normal, 1): 1.0, (shear, 0): 1.0,
                              (v1, 0): -self.density * (r + 0.5)}),
            equation(points, {(shear, 1): 1.0, (deviator, 0): 2.0, (normal, 0): -1.0,
                              (v1, 1): self.density * (r - 0.5)}),
            equation(points, {(v1, 2): -eta * (1.0 + softness), (v1, 0): eta * (softness - 1.0),
                              (shear, 0): -1.0 - softness * r}),
            equation(points, {(deviator, 0): 0.5 - self.beta + self.beta / mu,
                              (normal, 0): self.beta - 0.5, (g, 2): self.spread,
                              (g, 0): -self.spread - 1.0 - self.relaxation * r}),
            equation(points, {(v1, 1): 2.0 * eta, (deviator, 0): mu - 1.0 - softness * r,
                              (normal, 0): -mu, (g, 0): -mu}),
            equation(face, {(normal, 0): 1.0}),
            equation(face, {(shear, 0): 1.0}, -2.0 * eta),
            equation(face, {(v1, 0): 1.0}, 0.5 - r)]
        if self.spread:
            rows.append(equation(face, {(g, 1): 1.0}))
        return np.concatenate(rows)


def _roots(polynomial):
    """Complex roots (2,) or (3,) of a polynomial.

    The largest root of a cubic is corrected and divided out, so that sum and product of the other
    two are accurate even if these nearly coincide.
    """
    polynomial = polynomial / polynomial.coef[-1]
    (product, total, *_), largest = polynomial.coef, []
    if polynomial.degree() == 3:
        root = max(polynomial.roots(), key=abs) + 0.0j
        for _ in range(3):
            slope = polynomial.deriv()(root)
            root = root - polynomial(root) / slope if slope else root
        product, largest = -product / root, [root]
        total = (product - total) / root
    split = np.sqrt(total * total - 4.0 * product + 0.0j)
    first = -(total + (split if (np.conj(total) * split).real >= 0.0 else -split)) / 2.0
    return np.array([first, product / first, *largest])
