"""Perturbations whose wave vector turns with the flow (appendix A): numpy only.

Times are dimensionless, A^2 d^2 phi rho_s/eta0, as in (A 6), and wave vectors and growth rates are
those of `pgran.theory.waves`.
"""

import numpy as np

from . import waves


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
        raise ValueError(f"base flow {np.asarray(gradient).tolist()}: neither diagonalisable nor "
                          "nilpotent; allowed is either")
    return sum(np.multiply.outer(np.asarray(time)**n, term) for n, term in enumerate(terms))


def amplitude(k, N, coefficients, gradient, convection, end, tolerance=1e-8):
    """Return times (m,), wave vectors (m, n) and ln |v| (m,) of the fastest perturbation.

    Solves (A 4) along the turning wave vector: dv/dt = A(k(t)) v, v(0) the mode that
    `waves.modes` puts first, |v(0)| = 1, to dimensionless time ``end``. The steps are halved
    until the logarithm of the amplitude changes by less than ``tolerance`` of its range.
    In the plane v = a n with n normal to k, so that d(ln a)/dt = n.A n is a quadrature.
    """
    k = np.asarray(k, dtype=float)
    _, vectors = waves.modes(k, N, coefficients, convection, gradient)
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
    raise ValueError(f"end time {end}: the amplitude does not settle to {tolerance}")


def _quadrature(k, v, N, coefficients, gradient, convection, end, steps):
    """The logarithm of the amplitude of a plane perturbation, three Gauss points a step."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    time, h = np.linspace(0.0, end, steps + 1), end / steps
    inner = (time[:-1, None] + h * (nodes + 1.0) / 2.0).ravel()
    path = turning_wave_vector(k, gradient, convection, inner)
    rate = waves.growth_rates(path, N, coefficients, convection, gradient)[:, 0].real
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
    A, _ = waves.tensor(path, N, *coefficients.r_q((path * path).sum(-1)), convection, gradient)
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
        return waves.growth_rates(turned, N, coefficients, convection, gradient)[0, 0].real

    found = [(0.0, 0.0), (float(logarithm[-1]), float(end))]
    rates = waves.growth_rates(path, N, coefficients, convection, gradient)[:, 0].real
    for number in np.flatnonzero((rates[:-1] > 0.0) & (rates[1:] <= 0.0)):
        low, high = time[number], time[number + 1]
        for _ in range(40):
            middle = (low + high) / 2.0
            low, high = (middle, high) if rate(middle) > 0.0 else (low, middle)
        rest = _quadrature(path[number], None, N, coefficients, gradient, convection,
                           low - time[number], 16)[1][-1]
        found.append((float(logarithm[number] + rest), float(low)))
    return max(found)
