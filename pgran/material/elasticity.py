"""Stiff Maxwell element and strain; symmetric tensors (3, ...) have components 11, 22 and 12."""

import numpy as np

#: Number of components of a plane symmetric tensor.
COMPONENTS = 3


def rotate(stress, angle):
    """Return a stress deviator (3, ...), rotated counterclockwise by an angle (...) in rad."""
    mean, half = (stress[0] + stress[1]) / 2.0, (stress[0] - stress[1]) / 2.0
    cos, sin = np.cos(2.0 * angle), np.sin(2.0 * angle)
    rotated = half * cos - stress[2] * sin
    return np.array([mean + rotated, mean - rotated, half * sin + stress[2] * cos])


def stress_rate(dt, stress, previous_dt=None, previous=None):
    """Return the factor f and the stress S of d(sigma')/dt = f (sigma' - S)/dt.

    The scheme is BDF2 with variable steps, and backward Euler in the first step. ``stress`` and
    ``previous`` are the deviators (3, ...) one and two steps ago, rotated with the material.
    """
    if previous_dt is None:
        return 1.0, stress
    ratio = dt / previous_dt
    factor = (1.0 + 2.0 * ratio) / (1.0 + ratio)
    return factor, ((1.0 + ratio) * stress - ratio**2 / (1.0 + ratio) * previous) / factor


def strain_fields(velocity_gradient, deformation_gradient=None):
    """Return strain rate sym L (3, ...), spin (L21 - L12)/2, strain and det F - 1, {name: ndarray}.

    L_ij = d v_i/d x_j and F_ij = d x_i/d X_j, since the start, have the shape (2, 2, ...).
    """
    (l11, l12), (l21, l22) = velocity_gradient
    found = {"strain_rate_tensor": np.array([l11, l22, (l12 + l21) / 2.0]),
             "spin": (l21 - l12) / 2.0}
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
