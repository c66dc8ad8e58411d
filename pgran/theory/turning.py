"""Perturbations whose wave vector turns with the flow (appendix A).

Times are dimensionless, A^2 d^2 phi rho_s/eta0, as in (A 6). Wave vectors and growth rates are
those of `pgran.theory.waves`.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from . import waves

#: Tolerances of the integration, relative and absolute.
TOLERANCES = {"rtol": 1e-10, "atol": 1e-11}


def turning_wave_vector(k, gradient, convection, time):
    """Return k(t) = exp(-convection L0^T t) k, shape (m, n), at dimensionless times (m,).

    Parameters
    ----------
    k : ndarray, (n,)
        Wave vector at time 0.
    gradient : ndarray, (n, n)
        L0/gdot0.
    convection : float
        A^2 phi I0^2/mu_loc.
    time : ndarray, (m,)
    """
    generator = -convection * np.asarray(gradient, dtype=float).T
    return expm(np.multiply.outer(np.asarray(time, dtype=float), generator)) @ np.asarray(k, float)


def _follow(k, N, coefficients, gradient, convection, end):
    """Integrate (A 4) for v = a u, |u| = 1: the solution of `solve_ivp` for (u, ln a).

    Its events are the maxima of ln a.
    """
    k = np.asarray(k, dtype=float)
    _, vectors = waves.modes(k, N, coefficients, convection, gradient)
    start = vectors[0].real / np.linalg.norm(vectors[0].real)

    def slope(time, state):
        turned, u = turning_wave_vector(k, gradient, convection, time), state[:-1]
        u = u - (turned @ u) / (turned @ turned) * turned  # against drift by rounding
        u = u / np.linalg.norm(u)
        A, _ = waves.tensor(turned, N, *coefficients.r_q(turned @ turned), convection, gradient)
        change = A @ u
        return np.append(change - (u @ change) * u, u @ change)

    def crest(time, state):
        return slope(time, state)[-1]

    crest.direction = -1.0
    found = solve_ivp(slope, (0.0, end), np.append(start, 0.0), method="LSODA", events=crest,
                      **TOLERANCES)
    if not found.success:
        raise ValueError(f"end time {end}: the perturbation cannot be followed; {found.message}")
    return found


def amplitude(k, N, coefficients, gradient, convection, end):
    """Return times (m,), wave vectors (m, n) and ln |v| (m,) of the fastest perturbation.

    Solves (A 4) along the turning wave vector, dv/dt = A(k(t)) v, to the dimensionless time
    ``end``. v(0) is the mode that `waves.modes` gives first, with |v(0)| = 1.
    """
    found = _follow(k, N, coefficients, gradient, convection, end)
    return found.t, turning_wave_vector(k, gradient, convection, found.t), found.y[-1]


def largest_amplification(k, N, coefficients, gradient, convection, end):
    """Return the largest ln(|v|/|v(0)|) up to the time ``end``, and its dimensionless time."""
    found = _follow(k, N, coefficients, gradient, convection, end)
    crests = zip(found.y_events[0][:, -1], found.t_events[0]) if found.t_events[0].size else ()
    return max([(0.0, 0.0), (float(found.y[-1, -1]), float(end)),
                *((float(size), float(time)) for size, time in crests)])
