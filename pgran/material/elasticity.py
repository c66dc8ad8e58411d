"""Time integration of the stiff Maxwell element, and strain measures; numpy only."""

import numpy as np


def stress_rate(dt, stress, previous_dt=None, previous=None):
    """Return the factor f and the stress S of d(sigma')/dt = f (sigma' - S)/dt.

    The scheme is BDF2 with variable steps, and backward Euler in the first step. ``stress`` and
    ``previous`` are the deviators (m, ...) one and two steps ago, rotated with the material.
    """
    if previous_dt is None:
        return 1.0, stress
    ratio = dt / previous_dt
    factor = (1.0 + 2.0 * ratio) / (1.0 + ratio)
    return factor, ((1.0 + ratio) * stress - ratio**2 / (1.0 + ratio) * previous) / factor


def strain_fields(kinematics, velocity_gradient, deformation_gradient=None):
    """Return strain rate (m, ...), spin (...), strain (m, ...) and det F - 1, {name: ndarray}.

    The arguments are d v_i/d x_j and F_ij = d x_i/d X_j since the start, (2, 2, ...). Tensors have
    tensor components.
    """
    found = {"strain_rate_tensor": kinematics.tensor(kinematics.strain_rate(velocity_gradient)),
             "spin": kinematics.spin(velocity_gradient)[0]}
    if deformation_gradient is not None:
        (f11, f12), (f21, f22) = deformation_gradient
        found["strain_tensor"] = logarithmic_strain(deformation_gradient)
        found["volume_change"] = f11 * f22 - f12 * f21 - 1.0
    return found


def logarithmic_strain(gradient):
    """Return Hencky's strain ln V (3, ...) of a deformation gradient F = V R, (2, 2, ...).

    With b = F F^T, m = tr b/2 and half the difference r of the principal values of b,
    ln V = ln(m^2 - r^2)/4 1 + atanh(r/m)/(2 r) (b - m 1). det F must be positive.
    """
    (f11, f12), (f21, f22) = gradient
    b11, b22, b12 = f11**2 + f12**2, f21**2 + f22**2, f11 * f21 + f12 * f22
    mean, half = (b11 + b22) / 2.0, (b11 - b22) / 2.0
    ratio = np.hypot(half, b12) / mean
    safe = np.where(ratio > 0.0, ratio, 0.5)
    slope = np.where(ratio > 0.0, np.arctanh(safe) / safe, 1.0) / (2.0 * mean)
    volume = np.log(f11 * f22 - f12 * f21) / 2.0
    return np.array([volume + slope * half, volume - slope * half, slope * b12])

COMPONENTS = 3  # TEMPORARY
