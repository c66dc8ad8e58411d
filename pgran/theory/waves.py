"""Linear stability of homogeneous flow in closed form (sections 3, 5 and appendix A of the paper).

Wave vectors are dimensionless, A d k (NGF, LI) or sqrt(nu_I) d k (IG), and so are growth rates,
A^2 d^2 phi rho_s lambda/eta0 (NGF, LI) or nu_I d^2 phi rho_s lambda/eta0 (IG). Arrays of wave
vectors have the shape (..., n) with n = 2 or 3. Inertial numbers broadcast against (...).

An incompressible perturbation satisfies v.k = 0. On this subspace the tensor (3.16) is the sum of
-|k|^2 and a symmetric tensor of rank one. The largest growth rate is therefore

    |k|^2 (2 r |P N k^|^2 / (1 - sqrt(2) q k^.N k^) - 1),     P = 1 - k^ k^.

For a given m = k^.N k^ the numerator is largest in the plane of the extreme principal directions
of N, where every extremum over directions is an extremum of a quadratic in m. For NGF, r and q are
linear in x = 1/(1 + nu xi^2 |k|^2), so the cut-off follows from a quadratic equation in x.
"""

from dataclasses import dataclass

import numpy as np

from ..material import laws
from . import check_relaxation_time, inverse_length_squared

ROOT_2 = np.sqrt(2.0)
#: Velocity gradients over gdot0, by name: (3.20) and (A 8).
BASE_FLOWS = {"pure_shear": np.array([[0.5, 0.0], [0.0, -0.5]]),
              "simple_shear": np.array([[0.0, 1.0], [0.0, 0.0]])}
#: Models with a linear theory.
MODELS = "ngf", "ngf_primitive", "li", "ig"


@dataclass(frozen=True)
class Coefficients:
    """mu_loc(I0), nu of (3.6) and the spread nu xi^2/(A d)^2 at inertial numbers of the base state.

    ``spread`` is finite at I0 = 0 (appendix B), and NaN for LI and IG. ``relaxation`` is T, the
    time t0 of dynamic NGF times `viscous_rate`, and 0 for other models.
    """

    model: str
    mu: np.ndarray
    nu: np.ndarray
    spread: np.ndarray
    relaxation: object = 0.0

    @classmethod
    def of(cls, law, model, I0, relaxation=None):
        """Return the coefficients of a `Law` for one of `MODELS` at inertial numbers (...)."""
        if model not in MODELS:
            raise ValueError(f"model {model}: there is no linear theory; expected one of: "
                             f"{', '.join(MODELS)}")
        I0 = np.asarray(I0, dtype=float)
        if not np.all(I0 >= 0.0):
            raise ValueError(f"inertial number {I0}: must be a number >= 0")
        check_relaxation_time(model, relaxation)
        mu, nu = laws.sensitivity(law, I0)
        spread = np.full_like(mu, np.nan)
        if model in ("ngf", "ngf_primitive"):
            # At yield nu and 1/xi^2 are both zero, and their ratio is finite.
            at_yield = mu - law.yield_ratio < 1e-8 * mu
            _, slope = inverse_length_squared(law, np.nextafter(law.yield_ratio + 0.0 * mu, np.inf))
            inverse, _ = law.inverse_length_squared(np.where(at_yield, np.nan, mu))
            spread = np.where(at_yield, 1.0 / (mu * slope), nu / inverse)
        return cls(model, mu, nu, spread, 0.0 if relaxation is None else relaxation)

    @classmethod
    def of_run(cls, parameters):
        """Return the coefficients of the reference flow of `pgran.options.Parameters`."""
        p, theory = parameters, parameters.part("model").theory
        if theory is None:
            raise ValueError(f"the model {p.model} has no linear theory")
        law, relaxation = p.part("law").of(p), None
        if theory == "ngf_primitive":
            mu, _ = law.stress_ratio(np.asarray(p.inertial_number))
            relaxation = p.relaxation_time * viscous_rate(mu, p.A, p.phi, p.inertial_number)
        return cls.of(law, theory, p.inertial_number, relaxation)

    def r_q(self, square):
        """Return r0 and q0 of (3.13), of their local limit, or of (5.3) at ``square`` = |k|^2.

        For ngf_primitive ``square`` is |k|^2 + T lambda, where lambda is the growth rate.
        """
        if self.model == "ig":
            return 1.0 - self.nu - square, self.mu * (1.0 - self.nu / 2.0 - square / 2.0)
        x = np.ones_like(square) if self.model == "li" else 1.0 / (1.0 + self.spread * square)
        return (1.0 - self.nu) * x, self.mu * (1.0 - self.nu * x / 2.0)


def viscous_rate(mu, A, phi, I0):
    """Return eta0/(A^2 d^2 phi rho_s gdot0), the factor of growth rates in units of gdot0."""
    return mu / (A**2 * phi * np.square(I0))


def flow_direction(gradient):
    """Return N (n, n), the strain rate over its norm, for a velocity gradient L0 (n, n)."""
    gradient = np.asarray(gradient, dtype=float)
    where = f"base flow {gradient.tolist()}"
    if gradient.shape not in ((2, 2), (3, 3)) or not np.isfinite(gradient).all():
        raise ValueError(f"{where}: must be a 2 x 2 or 3 x 3 matrix")
    rounding = 1e-12 * np.abs(gradient).max()
    if abs(np.trace(gradient)) > rounding:
        raise ValueError(f"{where}: its divergence is {np.trace(gradient):.3g}; must be 0")
    D = (gradient + gradient.T) / 2.0
    norm = np.linalg.norm(D)
    if not norm > rounding:
        raise ValueError(f"{where}: it does not deform")
    return D / norm


#: N of pure shear (3.20).
PURE_SHEAR = flow_direction(BASE_FLOWS["pure_shear"])


def limit_of_stress_ratio(N):
    """Return the bound of (3.19) on mu_loc(I0): 1/(sqrt(2) n_max), which is 1 for plane flow."""
    return 1.0 / (ROOT_2 * np.linalg.eigvalsh(N)[-1])


# Growth rates of given wave vectors

def tensor(k, N, r, q, convection=0.0, gradient=None):
    """Return A_ik of (3.16), and the denominator |k|^2 - sqrt(2) q k.N k over |k|^2.

    ``k`` is (..., n) and ``N`` (n, n); ``r`` and ``q`` (...) are `Coefficients.r_q` at |k|^2. With
    ``gradient`` L0/gdot0 (n, n) the result is the tensor of (A 7), where ``convection`` is the
    inverse of `viscous_rate`. The tensor (..., n, n) is NaN where the denominator (...) vanishes.
    """
    k = np.asarray(k, dtype=float)
    square = (k * k).sum(axis=-1)
    r, q = np.broadcast_arrays(r, q)
    Nk = k @ N
    kNk = (k * Nk).sum(axis=-1)
    denominator = square - ROOT_2 * q * kNk
    singular = np.abs(denominator) <= 1e-12 * (square + np.abs(q * kNk))
    ray = (k - ROOT_2 * q[..., None] * Nk) / np.where(singular, np.nan, denominator)[..., None]
    left = 2.0 * r[..., None] * (Nk - kNk[..., None] * ray)
    result = left[..., :, None] * Nk[..., None, :] - square[..., None, None] * np.eye(k.shape[-1])
    if gradient is not None:
        result = result - convection * (
            gradient - 2.0 * ray[..., :, None] * (k @ gradient)[..., None, :])
    return result, denominator / square


def _tensor(k, N, coefficients, convection=0.0, gradient=None):
    """`tensor` with the coefficients of a model other than ngf_primitive."""
    _refuse_dynamic(coefficients)
    return tensor(k, N, *coefficients.r_q((k * k).sum(axis=-1)), convection, gradient)[0]


def _eigen(matrices):
    """Eigenvalues, largest real part first, and eigenvectors in columns; NaN if not finite."""
    lost = ~np.isfinite(matrices).all(axis=(-1, -2))
    values, vectors = np.linalg.eig(np.where(lost[..., None, None], 0.0, matrices))
    values = np.where(lost[..., None], np.nan, values)
    order = np.argsort(-values.real, axis=-1)
    return (np.take_along_axis(values, order, axis=-1),
            np.take_along_axis(vectors, order[..., None, :], axis=-1))


def growth_rates(k, N, coefficients, convection=0.0, gradient=None):
    """Return the growth rates (..., n - 1) of incompressible waves, largest real part first.

    They are the eigenvalues of `tensor` on v.k = 0, real without convection, and NaN where the
    denominator vanishes. For ngf_primitive the fluidity adds one rate, (..., n).
    """
    if coefficients.model == "ngf_primitive" and gradient is None:
        return _relaxing_growth_rates(np.asarray(k, dtype=float), N, coefficients)
    return modes(k, N, coefficients, convection, gradient)[0]


def tensor_growth_rates(k, N, coefficients, convection=0.0, gradient=None):
    """Return all eigenvalues (..., n) of `tensor`, largest real part first.

    With convection these are the growth rates of (A 7). Their modes need not satisfy v.k = 0.
    """
    return _eigen(_tensor(np.asarray(k, float), N, coefficients, convection, gradient))[0]


def modes(k, N, coefficients, convection=0.0, gradient=None):
    """Return growth rates (..., n - 1) and velocity modes (..., n - 1, n), as `growth_rates`."""
    k = np.asarray(k, dtype=float)
    A = _tensor(k, N, coefficients, convection, gradient)
    basis = transverse_basis(k)
    values, vectors = _eigen(basis @ A @ np.swapaxes(basis, -1, -2))
    if not values.imag.any():
        values, vectors = values.real, vectors.real
    return values, np.swapaxes(vectors, -1, -2) @ basis


def transverse_basis(k):
    """Return n - 1 orthonormal rows (..., n - 1, n) that span the plane v.k = 0."""
    if k.shape[-1] == 3:
        return np.linalg.svd(k[..., None, :])[2][..., 1:, :]
    unit = k / np.linalg.norm(k, axis=-1, keepdims=True)
    return np.stack([unit[..., 1], -unit[..., 0]], axis=-1)[..., None, :]


def _relaxing_growth_rates(k, N, coefficients):
    """Growth rates (..., n) of dynamic NGF, real within (3.19).

    With y = 1/x = 1 + S (|k|^2 + T lambda), S = nu xi^2/(A d)^2 and m = k^.N k^ the growth rate of
    the module's docstring becomes a quadratic equation in lambda::

        (lambda + |k|^2) (e y + f) = 2 (1 - nu) |P N k|^2
        e = 1 - sqrt(2) mu m,    f = mu nu m/sqrt(2)

    The rates are NaN where e vanishes. In 3D a velocity normal to k and N k has the rate -|k|^2.
    """
    mu, nu, S = coefficients.mu, coefficients.nu, coefficients.spread
    square = (k * k).sum(axis=-1)
    Nk = k @ N
    m = (k * Nk).sum(axis=-1) / square
    e, f = 1.0 - ROOT_2 * mu * m, mu * nu * m / ROOT_2
    e = np.where(np.abs(e) <= 1e-12, np.nan, e)
    drive = 2.0 * (1.0 - nu) * np.maximum((Nk * Nk).sum(axis=-1) / square - m**2, 0.0)
    stored, steady = e * S * coefficients.relaxation, e * (1.0 + S * square) + f
    linear, constant = steady + stored * square, square * (steady - drive)
    root = np.sqrt((stored * square - steady)**2 + 4.0 * stored * square * drive + 0.0j)
    half = -(linear + np.where(linear < 0.0, -1.0, 1.0) * root) / 2.0
    with np.errstate(invalid="ignore"):  # NaN wave vectors, and e = 0
        values = constant / half, half / stored
    if k.shape[-1] == 3:
        values = *values, np.where(np.isnan(values[0]), np.nan, -square)
    values = np.stack(values, axis=-1)
    values = np.take_along_axis(values, np.argsort(-values.real, axis=-1), axis=-1)
    return values if np.nan_to_num(values.imag).any() else values.real


def pure_shear_growth(k1, k2, coefficients):
    """Return the growth rate (3.22) in pure shear, NaN where its denominator vanishes."""
    return growth_rates(np.stack([k1, k2], axis=-1), PURE_SHEAR, coefficients)[..., 0]


def asymptotic_tensor(k, N, coefficients):
    """Return A_ik (..., n, n) for |k| -> infinity: (3.18) for NGF, (5.4) for IG."""
    k = np.asarray(k, dtype=float)
    if coefficients.model == "li":
        return _tensor(k, N, coefficients)
    _refuse_dynamic(coefficients)
    square = (k * k).sum(axis=-1)[..., None, None]
    identity = square * np.eye(k.shape[-1])
    if coefficients.model == "ngf":
        return -identity
    k, Nk = k[..., None], (k @ N)[..., None]
    kNk = (k * Nk).sum(axis=-2, keepdims=True)
    left = k - square / np.where(kNk == 0.0, np.nan, kNk) * Nk
    factor = 2.0 * ROOT_2 / np.asarray(coefficients.mu)[..., None, None]
    return factor * left * np.swapaxes(Nk, -1, -2) - identity


# Extrema over wave vectors (not for IG), with m = k^.N k^ = centre + y and |y| <= reach

def _extremes(N):
    """Centre and half distance (reach) of the extreme principal values of N."""
    values = np.linalg.eigvalsh(N)
    return (values[-1] + values[0]) / 2.0, (values[-1] - values[0]) / 2.0


def _within_limit(coefficients, N, values):
    """``values``, NaN where mu_loc violates (3.19)."""
    return np.where(coefficients.mu < limit_of_stress_ratio(N), values, np.nan)


def long_wave_excess(law, I, N=PURE_SHEAR):
    """Return `pgran.material.laws.ill_posedness`, positive where some long wave grows."""
    return laws.ill_posedness(law, I, *_extremes(N))


def cutoff(coefficients, N=PURE_SHEAR):
    """Return the cut-off wave number, 0 where all waves are stable, infinity for unstable LI.

    The largest root x of 8 r^2 reach^2 + q^2 = 4 r (1 - sqrt(2) q centre), where r and q are
    linear in x, gives |k|^2 = (1/x - 1)/(nu xi^2). NaN where (3.19) is violated.
    """
    _refuse_ig(coefficients)
    centre, reach = _extremes(N)
    mu, nu = coefficients.mu, coefficients.nu
    # r = r1 x, q = mu + q1 x
    r1, q1 = 1.0 - nu, -mu * nu / 2.0
    a = 8.0 * r1**2 * reach**2 + q1**2 + 4.0 * ROOT_2 * centre * r1 * q1
    b = 2.0 * mu * q1 - 4.0 * r1 * (1.0 - ROOT_2 * centre * mu)
    discriminant = b**2 - 4.0 * a * mu**2
    x = (-b + np.sqrt(np.maximum(discriminant, 0.0))) / (2.0 * a)
    unstable = (x < 1.0) | (discriminant < 0.0)
    size = np.inf if coefficients.model == "li" else np.sqrt(
        np.maximum(1.0 / x - 1.0, 0.0) / coefficients.spread)
    return _within_limit(coefficients, N, np.where(unstable, size, 0.0))


def _ridge(u, coefficients, centre, reach):
    """Largest growth over directions, |k|^2 and y, where ``u`` = |k|^2 + T lambda."""
    r, q = coefficients.r_q(u)
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    root = e + np.sqrt(e**2 - (p * reach)**2)
    growth = 4.0 * r * reach**2 / root - 1.0  # lambda/|k|^2
    square = u / (1.0 + coefficients.relaxation * growth)
    return square * growth, square, p * reach**2 / root


def fastest(coefficients, N=PURE_SHEAR):
    """Return wave number, growth rate and m = k^.N k^ of the fastest-growing wave vector.

    Bisection finds where the largest growth over directions has no slope. NaN where all wave
    vectors are stable, and for LI, whose growth is unbounded.
    """
    centre, reach = _extremes(N)
    top = np.asarray(cutoff(coefficients, N) + 0.0 * coefficients.relaxation)
    low, high = np.zeros_like(top), np.where(np.isfinite(top), top, np.nan)**2
    unstable = np.isfinite(high) & (top > 0.0)
    for _ in range(52):
        middle = (low + high) / 2.0
        with np.errstate(invalid="ignore"):  # the imaginary part of f(x + i h) is h f'(x)
            rising = _ridge(middle + 1e-40j, coefficients, centre, reach)[0].imag > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    u = np.where(unstable, (low + high) / 2.0, np.nan)
    rate, square, y = _ridge(u, coefficients, centre, reach)
    return np.sqrt(square), rate, centre + y


def unstable_directions(coefficients, N=PURE_SHEAR):
    """Return the range (m_low, m_high) of k^.N k^ that is unstable for |k| -> 0.

    The bounds are roots of 2 r (reach^2 - y^2) - 1 + sqrt(2) q (centre + y), and NaN where all
    waves are stable.
    """
    _refuse_ig(coefficients)
    centre, reach = _extremes(N)
    r, q = coefficients.r_q(np.zeros_like(coefficients.mu))
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    discriminant = p**2 + 8.0 * r * (2.0 * r * reach**2 - e)
    root = _within_limit(coefficients, N,
                         np.sqrt(np.where(discriminant > 0.0, discriminant, np.nan)))
    return centre + (p - root) / (4.0 * r), centre + (p + root) / (4.0 * r)


def directions(m, N):
    """Return two unit wave vectors (2, ..., n) with k^.N k^ = ``m`` in the extreme plane of N."""
    values, vectors = np.linalg.eigh(N)
    share = np.clip((m - values[0]) / (values[-1] - values[0]), 0.0, 1.0)[..., None]
    along, across = np.sqrt(share) * vectors[:, -1], np.sqrt(1.0 - share) * vectors[:, 0]
    return np.array([along + across, along - across])


def direction_angle(m, N):
    """Return the smaller angle (degrees, 0 to 90) between `directions` and the x1 axis."""
    found = np.abs(directions(m, N))
    across = np.linalg.norm(found[..., 1:], axis=-1)
    return np.degrees(np.arctan2(across, found[..., 0])).min(axis=0)


def critical_inertial_numbers(law, N=PURE_SHEAR):
    """Return the inertial numbers (m,) at which instability of any wave vector begins or ends."""
    roots = laws.sign_changes(lambda I: long_wave_excess(law, I, N), 1e-6, 1e2)
    return roots[law.stress_ratio(roots)[0] < limit_of_stress_ratio(N)]


def ill_posed_ranges(law):
    """Return the ranges (m, 2) of inertial numbers with ill-posed LI in plane flow.

    A range that reaches 1e-12 or 1e4 extends to 0 or infinity.
    """
    ends = 1e-12, 1e4
    edges = laws.sign_changes(lambda I: laws.ill_posedness(law, I), *ends)
    low, high = (int(laws.ill_posedness(law, I) > 0.0) for I in ends)
    return np.concatenate([[0.0] * low, edges, [np.inf] * high]).reshape(-1, 2)


def _refuse_ig(coefficients):
    if coefficients.model == "ig":
        raise ValueError("model ig: its growth rate is unbounded, so there is no cut-off and no "
                         "fastest wave vector; expected one of: ngf, ngf_primitive, li")


def _refuse_dynamic(coefficients):
    if coefficients.model == "ngf_primitive":
        raise ValueError("model ngf_primitive: the theory does not include convection and turning "
                         "wave vectors; expected one of: ngf, li, ig")
