"""Closed-form linear stability of homogeneous flow (sections 3, 5, appendix A): numpy alone.

    python -m pgran.stability -wave_vector k1,k2 [-pgran_... options] [-json]
    python -m pgran.stability -cutoff [-base_flow pure_shear|simple_shear] [-convection] [-json]

prints the growth rate of one wave vector, or the cut-off, the fastest-growing wave
vector, the unstable directions and the critical inertial numbers. With -wave_vector,
-convection adds the terms of (A 7), and -amplification [-end t] follows the wave vector
as the flow turns it, to time t (1/gdot0): the largest ln(|v|/|v0|), when, and the last.
-base_flow also takes L0 as 4 or 9 numbers, row by row, and then -wave_vector 2 or 3.

Wave vectors are dimensionless, A d k (NGF, LI) or sqrt(nu_I) d k (IG), and growth
rates those of the paper, A^2 d^2 phi rho_s lambda/eta0 (NGF, LI) or nu_I d^2 phi
rho_s lambda/eta0 (IG), unless a name says otherwise. Arrays of wave vectors have
shape (..., n) with n = 2 or 3; inertial numbers broadcast against (...).

Why closed forms suffice: an incompressible perturbation has v.k = 0, and there the
tensor (3.16) is symmetric of rank one but for -|k|^2, so that the largest growth is

    |k|^2 (2 r |P N k^|^2 / (1 - sqrt(2) q k^.N k^) - 1),     P = 1 - k^ k^.

For a given k^.N k^ the numerator is largest in the plane of the extreme principal
directions of N, so every extremum over directions is one of a quadratic in
m = k^.N k^, in two dimensions as in three; and r and q of NGF are linear in
x = 1/(1 + nu xi^2 |k|^2), so the cut-off is a root of a quadratic in x.
"""

import json
import sys
from dataclasses import dataclass

import numpy as np

from . import options, rheology
from .options import OptionError

ROOT_2 = np.sqrt(2.0)
#: Velocity gradients over gdot0, by name: (3.20) and (A 8).
BASE_FLOWS = {"pure_shear": np.array([[0.5, 0.0], [0.0, -0.5]]),
              "simple_shear": np.array([[0.0, 1.0], [0.0, 0.0]])}


@dataclass(frozen=True)
class Coefficients:
    """mu_loc(I0), nu of (3.6) and nu xi^2/(A d)^2 at base-state inertial numbers.

    The last one stays finite at I0 = 0, where it is 1/mu_s: xi0 = A d/sqrt(b I0)
    (appendix B).
    """

    model: str
    mu: np.ndarray
    nu: np.ndarray
    spread: np.ndarray

    @classmethod
    def of(cls, law, model, I0):
        """Return the coefficients of a law of `rheology` at ``I0`` >= 0, an array or a number."""
        if model not in ("ngf", "li", "ig"):
            raise OptionError(f"-pgran_model {model}: allowed is ngf | li | ig")
        I0 = np.asarray(I0, dtype=float)
        if not np.all(I0 >= 0.0):
            raise OptionError(f"-pgran_inertial_number {I0}: allowed is a number >= 0")
        mu, slope = law.stress_ratio(I0)
        return cls(model, mu, I0 * slope / mu, slope / (law.b * mu))

    def share(self, square):
        """Return x = 1/(1 + nu xi^2 |k|^2), by which non-locality weighs nu; 1 for LI."""
        return 1.0 / (1.0 + self.spread * square) if self.model == "ngf" else np.ones_like(square)

    def r_q(self, square):
        """Return r0 and q0 of (3.13), (5.3) or their local limit, at ``square`` = |k|^2."""
        if self.model == "ig":
            return 1.0 - self.nu - square, self.mu * (1.0 - self.nu / 2.0 - square / 2.0)
        x = self.share(square)
        return (1.0 - self.nu) * x, self.mu * (1.0 - self.nu * x / 2.0)


def viscous_rate(mu, A, phi, I0):
    """Return eta0/(A^2 d^2 phi rho_s gdot0) = mu_loc/(A^2 phi I0^2).

    The paper's growth rates times this are in units of gdot0; its inverse is the weight of
    convection in (A 7).
    """
    return mu / (A**2 * phi * np.square(I0))


def flow_direction(gradient):
    """Return N (n, n), symmetric, deviatoric and of unit norm, of a velocity gradient L0 (n, n).

    Raises `OptionError` where L0 is not square, not finite, has divergence or is at rest.
    """
    gradient = np.asarray(gradient, dtype=float)
    if gradient.shape not in ((2, 2), (3, 3)) or not np.isfinite(gradient).all():
        raise OptionError(f"base flow {gradient.tolist()}: allowed is a 2 x 2 or 3 x 3 matrix")
    size = np.abs(gradient).max()
    if abs(np.trace(gradient)) > 1e-12 * size:
        raise OptionError(f"base flow {gradient.tolist()}: its divergence is "
                          f"{np.trace(gradient):.3g}; allowed is 0")
    D = (gradient + gradient.T) / 2.0
    norm = np.sqrt((D * D).sum())
    if not norm > 1e-12 * size:
        raise OptionError(f"base flow {gradient.tolist()}: it does not deform")
    return D / norm


def limit_of_stress_ratio(N):
    """Return the bound of (3.19) on mu_loc(I0): 1/(sqrt(2) n_max), 1 for plane flow."""
    return 1.0 / (ROOT_2 * np.linalg.eigvalsh(N)[-1])


def tensor(k, N, r, q, convection=0.0, gradient=None):
    """Return A_ik of (3.16) and the denominator |k|^2 - sqrt(2) q k.N k over |k|^2.

    ``k`` (..., n), ``r`` and ``q`` (...); with ``convection`` = A^2 phi I0^2/mu_loc and
    ``gradient`` = L0/gdot0 (n, n), (A 7). Shapes (..., n, n) and (...). Where the
    denominator vanishes the tensor is not a number. Raises `OptionError` for k = 0.
    """
    k = np.asarray(k, dtype=float)
    square = (k * k).sum(axis=-1)
    if not np.all(square > 0.0):
        raise OptionError("-wave_vector: allowed is any but the zero vector")
    r, q = np.broadcast_arrays(r, q)
    Nk = k @ N
    kNk = (k * Nk).sum(axis=-1)
    denominator = square - ROOT_2 * q * kNk
    singular = np.abs(denominator) <= 1e-12 * (square + np.abs(q * kNk))
    safe = np.where(singular, np.nan, denominator)
    ray = (k - ROOT_2 * q[..., None] * Nk) / safe[..., None]
    left = 2.0 * r[..., None] * (Nk - kNk[..., None] * ray)
    result = left[..., :, None] * Nk[..., None, :] - square[..., None, None] * np.eye(k.shape[-1])
    if gradient is not None:
        gradient = np.asarray(gradient, dtype=float)
        result = result - convection * (
            gradient - 2.0 * ray[..., :, None] * (k @ gradient)[..., None, :])
    return result, denominator / square


def growth_rates(k, N, coefficients, convection=0.0, gradient=None):
    """Return the eigenvalues (..., n - 1) of `tensor` on v.k = 0, largest real part first.

    ``k`` (..., n). Complex with convection alone. Not numbers where the denominator
    vanishes.
    """
    return modes(k, N, coefficients, convection, gradient)[0]


def modes(k, N, coefficients, convection=0.0, gradient=None):
    """Return growth rates (..., n - 1) and velocity modes (..., n - 1, n), as `growth_rates`."""
    k = np.asarray(k, dtype=float)
    A, _ = tensor(k, N, *coefficients.r_q((k * k).sum(axis=-1)), convection, gradient)
    basis = transverse_basis(k)
    reduced = basis @ A @ np.swapaxes(basis, -1, -2)
    lost = ~np.isfinite(reduced).all(axis=(-1, -2))
    values, vectors = np.linalg.eig(np.where(lost[..., None, None], 0.0, reduced))
    values = np.where(lost[..., None], np.nan, values)
    order = np.argsort(-values.real, axis=-1)
    values = np.take_along_axis(values, order, axis=-1)
    vectors = np.take_along_axis(vectors, order[..., None, :], axis=-1)
    if np.isrealobj(values) or not np.abs(values.imag).any():
        values, vectors = values.real, vectors.real
    return values, np.swapaxes(vectors, -1, -2) @ basis


def transverse_basis(k):
    """Return n - 1 orthonormal rows (..., n - 1, n) that span the plane v.k = 0."""
    if k.shape[-1] == 2:
        unit = k / np.linalg.norm(k, axis=-1, keepdims=True)
        return np.stack([unit[..., 1], -unit[..., 0]], axis=-1)[..., None, :]
    # The Householder reflection that takes k to an axis takes the other axes to the plane.
    axis = np.argmax(np.abs(k), axis=-1)
    size = np.linalg.norm(k, axis=-1)
    e = np.eye(3)[axis]
    w = k + np.sign(np.take_along_axis(k, axis[..., None], -1)) * size[..., None] * e
    H = np.eye(3) - 2.0 * w[..., :, None] * w[..., None, :] / (w * w).sum(-1)[..., None, None]
    others = np.stack([(axis + 1) % 3, (axis + 2) % 3], axis=-1)
    return np.take_along_axis(H, others[..., None], axis=-2)


def pure_shear_growth(k1, k2, coefficients):
    """Return the growth rate (3.22) in pure shear, not a number where its denominator vanishes."""
    square = k1**2 + k2**2
    r, q = coefficients.r_q(square)
    denominator = square - q * (k1**2 - k2**2)
    singular = np.abs(denominator) <= 1e-12 * (square + np.abs(q) * square)
    numerator = square**2 - q * square * (k1**2 - k2**2) - 4.0 * r * k1**2 * k2**2
    return -numerator / np.where(singular, np.nan, denominator)


def asymptotic_r_q(square, coefficients):
    """Return r0 and q0 for |k| -> infinity: (3.17) for NGF, the |k|^2 terms of (5.3) for IG."""
    if coefficients.model == "ngf":
        return ((1.0 - coefficients.nu) / (coefficients.spread * square),
                coefficients.mu + 0.0 * square)
    if coefficients.model == "ig":
        return -square, -coefficients.mu * square / 2.0
    return coefficients.r_q(square)


def asymptotic_tensor(k, N, coefficients):
    """Return A_ik (..., n, n) for |k| -> infinity: (3.18) for NGF, (5.4) for IG."""
    k = np.asarray(k, dtype=float)
    square = (k * k).sum(axis=-1)
    identity = square[..., None, None] * np.eye(k.shape[-1])
    if coefficients.model == "ngf":
        return -identity
    if coefficients.model == "li":
        return tensor(k, N, *coefficients.r_q(square))[0]
    Nk = k @ N
    kNk = (k * Nk).sum(axis=-1)
    left = k - (square / np.where(kNk == 0.0, np.nan, kNk))[..., None] * Nk
    factor = 2.0 * ROOT_2 / np.asarray(coefficients.mu)
    return factor[..., None, None] * left[..., :, None] * Nk[..., None, :] - identity


#: N of pure shear (3.20).
PURE_SHEAR = flow_direction(BASE_FLOWS["pure_shear"])


# Extrema over wave vectors (NGF and LI): m = k^.N k^ = centre + y between the extreme
# principal values of N, half of whose distance is ``reach``.

def _extremes(N):
    """Centre and half distance of the extreme principal values of N."""
    values = np.linalg.eigvalsh(N)
    return (values[-1] + values[0]) / 2.0, (values[-1] - values[0]) / 2.0


def _posed(coefficients, N, values):
    """``values``, not numbers where mu_loc violates (3.19) and the criteria say nothing."""
    return np.where(coefficients.mu < limit_of_stress_ratio(N), values, np.nan)


def long_wave_excess(coefficients, N=PURE_SHEAR):
    """Return q^2 + 8 r^2 reach^2 - 4 r (1 - sqrt(2) q centre) at |k| = 0.

    Positive where some wave vector grows; in pure shear q^2 - 4 r (1 - r).
    """
    centre, reach = _extremes(N)
    r, q = coefficients.r_q(np.zeros_like(coefficients.mu))
    return q**2 + 8.0 * r**2 * reach**2 - 4.0 * r * (1.0 - ROOT_2 * q * centre)


def cutoff(coefficients, N=PURE_SHEAR):
    """Return the cut-off wave number, 0 where all are stable and inf for unstable LI.

    Not a number where (3.19) is violated. Raises `OptionError` for IG, which has none.

    The largest root x of 8 r^2 reach^2 + q^2 = 4 r (1 - sqrt(2) q centre), with r and
    q linear in x (see the module), gives |k|^2 = (1/x - 1)/(nu xi^2).
    """
    _no_ig(coefficients)
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
    return _posed(coefficients, N, np.where(unstable, size, 0.0))


def _ridge(square, coefficients, centre, reach):
    """Largest growth over directions at |k|^2 = ``square``, and the y where it occurs."""
    r, q = coefficients.r_q(square)
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    root = e + np.sqrt(e**2 - (p * reach)**2)
    return square * (4.0 * r * reach**2 / root - 1.0), p * reach**2 / root


def fastest(coefficients, N=PURE_SHEAR, tolerance=1e-12):
    """Return wave number, growth rate and m = k^.N k^ of the fastest-growing wave vector.

    Not numbers where all wave vectors are stable, and for LI, which grows without bound.
    Raises `OptionError` for IG. The maximum
    along the ridge of `_ridge` is the root of its slope, bisected to ``tolerance``.
    """
    centre, reach = _extremes(N)
    top = cutoff(coefficients, N)
    low, high = np.zeros_like(top), np.where(np.isfinite(top), top, np.nan)**2
    unstable = np.isfinite(high) & (top > 0.0)
    for _ in range(int(np.ceil(np.log(tolerance) / np.log(0.5))) + 2):
        middle = (low + high) / 2.0
        rising = _ridge_slope(middle, coefficients, centre, reach) > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    square = np.where(unstable, (low + high) / 2.0, np.nan)
    rate, y = _ridge(square, coefficients, centre, reach)
    return np.sqrt(square), rate, centre + y


def _ridge_slope(square, coefficients, centre, reach):
    """Derivative of `_ridge` with respect to |k|^2."""
    r, q = coefficients.r_q(square)
    x = coefficients.share(square)
    dx = -coefficients.spread * x**2
    dr, dq = (1.0 - coefficients.nu) * dx, -coefficients.mu * coefficients.nu * dx / 2.0
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    dp, de = ROOT_2 * dq, -ROOT_2 * dq * centre
    inner = np.sqrt(e**2 - (p * reach)**2)
    root = e + inner
    droot = de + (e * de - reach**2 * p * dp) / inner
    return (4.0 * r * reach**2 / root - 1.0
            + square * 4.0 * reach**2 * (dr / root - r * droot / root**2))


def unstable_directions(coefficients, N=PURE_SHEAR):
    """Return the range (m_low, m_high) of k^.N k^ that is unstable for |k| -> 0.

    Roots of 2 r (reach^2 - y^2) - 1 + sqrt(2) q (centre + y), which bound the unstable
    directions of LI at any |k| and contain those of NGF. Not numbers where stable.
    """
    _no_ig(coefficients)
    centre, reach = _extremes(N)
    r, q = coefficients.r_q(np.zeros_like(coefficients.mu))
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    discriminant = p**2 + 8.0 * r * (2.0 * r * reach**2 - e)
    root = _posed(coefficients, N, np.sqrt(np.where(discriminant > 0.0, discriminant, np.nan)))
    return centre + (p - root) / (4.0 * r), centre + (p + root) / (4.0 * r)


def direction_angle(m, N):
    """Return the angle (degrees, 0 to 90) with x1 of a plane wave vector with k^.N k^ = ``m``.

    Of the two directions, mirror images about the principal axis, that with the
    smaller angle.
    """
    values, vectors = np.linalg.eigh(N)
    axis = np.degrees(np.arctan2(vectors[1, -1], vectors[0, -1]))
    centre, reach = _extremes(N)
    half = np.degrees(np.arccos(np.clip((np.asarray(m) - centre) / reach, -1.0, 1.0))) / 2.0
    both = np.abs((np.stack([axis - half, axis + half]) + 90.0) % 180.0 - 90.0)
    return both.min(axis=0)


def critical_inertial_numbers(law, I_range=(1e-6, 1e2), N=PURE_SHEAR):
    """Return the inertial numbers at which instability of any wave vector begins or ends.

    Sign changes of `long_wave_excess`, bracketed over ``I_range`` and bisected to
    relative 1e-12.
    """
    def excess(I):
        return long_wave_excess(Coefficients.of(law, "li", I), N)

    I = np.geomspace(*I_range, 2001)
    values = excess(I)
    start = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    low, high = I[start], I[start + 1]
    sign = np.sign(values[start])
    for _ in range(60):
        middle = np.sqrt(low * high)
        same = np.sign(excess(middle)) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    roots = np.sqrt(low * high)
    # Beyond mu_loc = 1 (3.19) the criterion says nothing.
    return roots[law.stress_ratio(roots)[0] < limit_of_stress_ratio(N)]


def _no_ig(coefficients):
    if coefficients.model == "ig":
        raise OptionError("-pgran_model ig: its growth has no bound, so neither a cut-off nor a "
                          "fastest wave vector; allowed is ngf | li")


# Appendix A, in time

def turning_wave_vector(k, gradient, convection, time):
    """Return k(t) (m, n) with dk/dt = -convection L0^T k, at dimensionless times (m,).

    Time in A^2 d^2 phi rho_s/eta0 as in (A 6), ``k`` (n,) at time 0, ``gradient`` L0/gdot0.
    """
    generator = -convection * np.asarray(gradient, dtype=float).T
    values, vectors = np.linalg.eig(generator.astype(complex))
    if np.linalg.cond(vectors) < 1e8:
        weights = np.linalg.solve(vectors, np.asarray(k, dtype=complex))
        return ((np.exp(np.multiply.outer(time, values)) * weights) @ vectors.T).real
    terms = [np.asarray(k, dtype=float)]  # defective (simple shear): nilpotent, the series ends
    while np.abs(terms[-1]).max() > 0.0 and len(terms) <= 3:
        terms.append(generator @ terms[-1] / len(terms))
    if np.abs(terms[-1]).max() > 0.0:
        raise OptionError(f"base flow {np.asarray(gradient).tolist()}: neither diagonalisable nor "
                          "nilpotent; allowed is either")
    return sum(np.multiply.outer(np.asarray(time)**n, term) for n, term in enumerate(terms))


def amplitude(k, N, coefficients, gradient, convection, end, tolerance=1e-8):
    """Return times (m,), wave vectors (m, n) and ln |v| (m,) of the fastest perturbation.

    Solves (A 4) along the turning wave vector: dv/dt = A(k(t)) v, v(0) the mode that
    `modes` puts first, |v(0)| = 1, to dimensionless time ``end``. The steps are halved
    until the logarithm of the amplitude changes by less than ``tolerance`` of its range.
    In the plane v = a n with n normal to k, so that d(ln a)/dt = n.A n is a quadrature.
    """
    k = np.asarray(k, dtype=float)
    _, vectors = modes(k, N, coefficients, convection, gradient)
    start = vectors[0].real / np.linalg.norm(vectors[0].real)
    solve = _quadrature if k.size == 2 else _gauss_legendre
    before = None
    for doubling in range(6, 18):
        time, logarithm = solve(k, start, N, coefficients, gradient, convection, end, 2**doubling)
        coarse = logarithm[::2**(doubling - 6)]
        if before is not None and (np.abs(coarse - before).max()
                                   < tolerance * max(1.0, np.abs(coarse).max())):
            return time, turning_wave_vector(k, gradient, convection, time), logarithm
        before = coarse
    raise OptionError(f"end time {end}: the amplitude does not settle to {tolerance}")


def _quadrature(k, v, N, coefficients, gradient, convection, end, steps):
    """The logarithm of the amplitude of a plane perturbation, three Gauss points a step."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    time, h = np.linspace(0.0, end, steps + 1), end / steps
    inner = (time[:-1, None] + h * (nodes + 1.0) / 2.0).ravel()
    path = turning_wave_vector(k, gradient, convection, inner)
    rate = growth_rates(path, N, coefficients, convection, gradient)[:, 0].real
    pieces = h / 2.0 * (rate.reshape(steps, 3) @ weights)
    return time, np.concatenate([[0.0], np.cumsum(pieces)])


def _gauss_legendre(k, v, N, coefficients, gradient, convection, end, steps):
    """The same in space, by Gauss-Legendre steps of order four."""
    n, h = k.size, end / steps
    shift = np.sqrt(3.0) / 6.0
    weights = np.array([[0.25, 0.25 - shift], [0.25 + shift, 0.25]])
    time = np.linspace(0.0, end, steps + 1)
    inner = (time[:-1, None] + h * np.array([0.5 - shift, 0.5 + shift])).ravel()
    path = turning_wave_vector(k, gradient, convection, inner)
    A, _ = tensor(path, N, *coefficients.r_q((path * path).sum(-1)), convection, gradient)
    A = A.reshape(steps, 2, n, n)
    system = np.eye(2 * n) - h * np.einsum("ab,saij->saibj", weights, A).reshape(
        steps, 2 * n, 2 * n)
    stages = np.linalg.solve(system, A.reshape(steps, 2 * n, n))
    steppers = np.eye(n) + h / 2.0 * (stages[:, :n] + stages[:, n:])
    logarithm = np.zeros(steps + 1)
    for number, stepper in enumerate(steppers):  # a product of matrices has an order
        v = stepper @ v
        size = np.linalg.norm(v)
        v, logarithm[number + 1] = v / size, logarithm[number] + np.log(size)
    return time, logarithm


def largest_amplification(k, N, coefficients, gradient, convection, end, tolerance=1e-8):
    """Return the largest ln(|v|/|v(0)|) over the time of `amplitude`, and its dimensionless time.

    In the plane the maximum lies where the growth rate along the turning wave vector
    passes zero, which is bisected to relative 1e-12; in space on the grid of times.
    """
    time, path, logarithm = amplitude(k, N, coefficients, gradient, convection, end, tolerance)
    if path.shape[1] == 3:
        best = int(np.argmax(logarithm))
        return float(logarithm[best]), float(time[best])

    def rate(t):
        turned = turning_wave_vector(k, gradient, convection, np.array([t]))
        return growth_rates(turned, N, coefficients, convection, gradient)[0, 0].real

    found = [(0.0, 0.0), (float(logarithm[-1]), float(end))]
    rates = growth_rates(path, N, coefficients, convection, gradient)[:, 0].real
    for number in np.flatnonzero((rates[:-1] > 0.0) & (rates[1:] <= 0.0)):
        low, high = time[number], time[number + 1]
        for _ in range(40):
            middle = (low + high) / 2.0
            low, high = (middle, high) if rate(middle) > 0.0 else (low, middle)
        rest = _quadrature(path[number], None, N, coefficients, gradient, convection,
                           low - time[number], 16)[1][-1]
        found.append((float(logarithm[number] + rest), float(low)))
    return max(found)


# The command

def _command_line(arguments):
    """Split ``arguments`` into pgran's options and this command's; raises `OptionError`."""
    given, own = {}, {}
    flags = {"cutoff", "convection", "amplification", "json", "help"}
    values = {"wave_vector", "base_flow", "end"}
    position = 0
    while position < len(arguments):
        name = arguments[position].lstrip("-")
        position += 1
        if name in flags:
            own[name] = True
            continue
        if name not in values and not name.startswith(options.PREFIX):
            raise OptionError(f"{arguments[position - 1]}: no such option; allowed are -pgran_..., "
                              + ", ".join(f"-{n}" for n in sorted(flags | values)))
        if position == len(arguments):
            raise OptionError(f"-{name}: a value is missing")
        (own if name in values else given)[name] = arguments[position]
        position += 1
    return given, own


def read_numbers(name, text, counts):
    """Return the numbers (n,) of a list; `OptionError` where n is not among ``counts``."""
    try:
        found = np.array([float(part) for part in text.split(",")])
    except ValueError:
        found = np.empty(0)
    if found.size not in counts or not np.isfinite(found).all():
        raise OptionError(f"-{name} {text}: allowed is {' or '.join(map(str, counts))} numbers")
    return found


def read_wave_vector(text, dimension=2):
    """Return the wave vector (dimension,) of a text; raises `OptionError` where it is not one."""
    k = read_numbers("wave_vector", text, (dimension,))
    if not k.any():
        raise OptionError(f"-wave_vector {text}: allowed is any but the zero vector")
    return k


def read_base_flow(text):
    """Return L0/gdot0 (n, n) of a name of `BASE_FLOWS`, or of 4 or 9 numbers, row by row.

    Raises `OptionError` where it is neither.
    """
    if text in BASE_FLOWS:
        return BASE_FLOWS[text]
    if any(letter.isalpha() and letter not in "eE" for letter in text):
        raise OptionError(f"-base_flow {text}: allowed is {' | '.join(BASE_FLOWS)}, or 4 or 9 "
                          "numbers")
    found = read_numbers("base_flow", text, (4, 9))
    size = 2 if found.size == 4 else 3
    gradient = found.reshape(size, size)
    flow_direction(gradient)  # refuses what is no base flow
    D = (gradient + gradient.T) / 2.0
    return gradient / (ROOT_2 * np.sqrt((D * D).sum()))


def analyse(settings, own):
    """Return the answer to a command line as a dictionary; `OptionError` where it is not one."""
    law = rheology.law_of(settings)
    coefficients = Coefficients.of(law, settings.model, settings.inertial_number)
    name = own.get("base_flow", "pure_shear")
    gradient = read_base_flow(name)
    N = flow_direction(gradient)
    limit = limit_of_stress_ratio(N)
    answer = {"model": settings.model, "law": settings.law, "base_flow": name,
              "inertial_number": settings.inertial_number,
              "stress_ratio": float(coefficients.mu), "stress_ratio_limit": float(limit),
              "well_posed_pressure": bool(coefficients.mu < limit)}
    rate = float(viscous_rate(coefficients.mu, settings.A, settings.phi,
                              settings.inertial_number))
    if "wave_vector" in own:
        k = read_wave_vector(own["wave_vector"], len(N))
        convection = 1.0 / rate if own.get("convection") else 0.0
        value = growth_rates(k, N, coefficients, convection,
                             gradient if own.get("convection") else None)[0]
        _, denominator = tensor(k, N, *coefficients.r_q(k @ k))
        answer.update(wave_vector=k.tolist(), convection=bool(own.get("convection")),
                      denominator=float(denominator), growth_rate=_number(value.real))
        if settings.model != "ig":
            answer["growth_rate_gdot0"] = _number(value.real * rate)
        if own.get("amplification"):
            end = float(read_numbers("end", own.get("end", "1"), (1,))[0])
            if not end > 0.0:
                raise OptionError(f"-end {own['end']}: allowed is a number > 0")
            largest, when = largest_amplification(k, N, coefficients, gradient, 1.0 / rate,
                                                  end * rate)
            _, _, last = amplitude(k, N, coefficients, gradient, 1.0 / rate, end * rate)
            answer.update(end=end, largest_log_amplification=largest,
                          largest_amplification_time=when / rate,
                          final_log_amplification=float(last[-1]))
    elif own.get("cutoff"):
        if own.get("convection"):
            raise OptionError("-convection: allowed with -wave_vector alone")
        k_cut = float(cutoff(coefficients, N))
        k, value, m = (float(part) for part in fastest(coefficients, N))
        low, high = unstable_directions(coefficients, N)
        angles = sorted(float(direction_angle(part, N)) for part in (low, high))
        answer.update(
            k_cut=_number(k_cut),
            cutoff_wavelength=_number(2.0 * np.pi * settings.A / k_cut if k_cut else np.inf),
            fastest_growth_rate=_number(value), fastest_growth_rate_gdot0=_number(value * rate),
            fastest_wave_number=_number(k), fastest_angle=_number(direction_angle(m, N)),
            unstable_angles=[_number(angle) for angle in angles],
            critical_inertial_numbers=critical_inertial_numbers(law, N=N).tolist())
    else:
        raise OptionError("-wave_vector k1,k2 or -cutoff: one of them says what is asked")
    return answer


def _number(value):
    """A float for JSON, None where it is not a finite number."""
    return float(value) if np.isfinite(value) else None


def main(arguments):
    """Answer the command line ``arguments``; return the exit code."""
    try:
        given, own = _command_line(arguments)
        if own.get("help") or not arguments:
            print(f"{__doc__}\nOptions:\n{options.help_text()}")
            return 0
        answer = analyse(options.read(given), own)
    except OptionError as error:
        print(f"pgran.stability: error: {error}", file=sys.stderr)
        return 1
    if own.get("json"):
        print(json.dumps(answer))
        return 0
    for key, value in answer.items():
        text = "not a number: the denominator vanishes, growth is unbounded, or all is stable" \
            if value is None else f"{value:.10g}" if isinstance(value, float) else value
        print(f"{key:28} {text}")
    if not answer["well_posed_pressure"]:
        print("warning: mu_loc(I0) violates (3.19): the denominator of (3.16) changes sign")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
