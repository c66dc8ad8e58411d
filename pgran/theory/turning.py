"""Perturbations whose wave vector turns with the flow, in the units of (A 6)."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from . import waves


def turning_wave_vector(k, gradient, convection, time):
    """Return k(t) = exp(-convection L0^T t) k, (m, n), at times (m,); see `amplitude`."""
    generator = -convection * np.asarray(gradient, dtype=float).T
    return expm(np.multiply.outer(np.asarray(time, dtype=float), generator)) @ np.asarray(k, float)


def amplitude(k, N, coefficients, gradient, convection, end):
    """Return times (m,) and ln |v| (m,) of the fastest perturbation, with dv/dt = A(k(t)) v (A 4).

    k (n,) is the wave vector at time 0, ``end`` is the last time, and the other arguments are
    those of `pgran.theory.waves.modes`, whose first mode is v(0). The times include all maxima.
    """
    k = np.asarray(k, dtype=float)
    _, vectors = waves.modes(k, N, coefficients, convection, gradient)
    start = vectors[0].real / np.linalg.norm(vectors[0].real)

    def slope(time, state):  # of v/|v| and ln |v|
        turned, u = turning_wave_vector(k, gradient, convection, time), state[:-1]
        u = u - (turned @ u) / (turned @ turned) * turned  # removes drift by rounding
        u = u / np.linalg.norm(u)
        A, _ = waves.tensor(turned, N, *coefficients.r_q(turned @ turned), convection, gradient)
        change = A @ u
        return np.append(change - (u @ change) * u, u @ change)

    def maximum(time, state):
        return slope(time, state)[-1]

    maximum.direction = -1.0
    found = solve_ivp(slope, (0.0, end), np.append(start, 0.0), method="LSODA", events=maximum,
                      rtol=1e-10, atol=1e-11)
    if not found.success:
        raise ValueError(f"end time {end}: the integration fails: {found.message}")
    time = np.append(found.t, found.t_events[0])
    logarithm = np.append(found.y[-1], [state[-1] for state in found.y_events[0]])
    order = np.argsort(time, kind="stable")
    return time[order], logarithm[order]
