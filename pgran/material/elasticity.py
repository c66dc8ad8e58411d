"""The stiff Maxwell element in time, and strain: tensors as components 11, 22, 12; numpy only."""

import numpy as np

#: Components of a plane symmetric tensor: 11, 22 and 12.
COMPONENTS = 3


def rotate(stress, angle):
    """Return a stress deviator turned counterclockwise.

    Parameters
    ----------
    stress : ndarray, (3, ...)
        Components 11, 22 and 12.
    angle : ndarray, (...) or float
        Angle in rad.
    """
    mean, half = (stress[0] + stress[1]) / 2.0, (stress[0] - stress[1]) / 2.0
    cos, sin = np.cos(2.0 * angle), np.sin(2.0 * angle)
    turned = half * cos - stress[2] * sin
    return np.array([mean + turned, mean - turned, half * sin + stress[2] * cos])


def stress_rate(dt, stress, earlier_dt=None, earlier=None):
    """Return the factor f and the stress S of d(sigma')/dt = f (sigma' - S)/dt.

    It is that of BDF2 over the last two steps, or of backward Euler in the first one.

    Parameters
    ----------
    dt, earlier_dt : float
        Size of the step and of the one before it (None in the first step), 1/gdot0.
    stress, earlier : ndarray, (3, ...)
        Deviators one and two steps ago, both turned to where the material is now.
    """
    if earlier_dt is None:
        return 1.0, stress
    ratio = dt / earlier_dt
    factor = (1.0 + 2.0 * ratio) / (1.0 + ratio)
    return factor, ((1.0 + ratio) * stress - ratio**2 / (1.0 + ratio) * earlier) / factor


def strain_fields(velocity_gradient, deformation_gradient=None):
    """Return strain rate, spin, strain and volume change, {name: ndarray}.

    Parameters
    ----------
    velocity_gradient : ndarray, (2, 2, ...)
        L_ij = d v_i/d x_j, gdot0.
    deformation_gradient : ndarray, (2, 2, ...), optional
        F_ij = d x_i/d X_j since the start, of a positive determinant.

    Returns
    -------
    dict
        ``strain_rate_tensor`` (3, ...), sym L with the components 11, 22 and 12, gdot0; ``spin``
        (...), (L21 - L12)/2, gdot0. With F also ``strain_tensor`` (3, ...), `logarithmic_strain`,
        and ``volume_change`` (...), det F - 1.
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
    """Return ln V of a deformation gradient F = V R, Hencky's strain, (3, ...): 11, 22, 12.

    With b = F F^T, its mean m = tr b/2 and the half difference r of its principal values,
    ln V = ln(m^2 - r^2)/4 1 + atanh(r/m)/(2 r) (b - m 1).

    Parameters
    ----------
    gradient : ndarray, (2, 2, ...)
        F, of a positive determinant.
    """
    (f11, f12), (f21, f22) = gradient
    b11, b22, b12 = f11**2 + f12**2, f21**2 + f22**2, f11 * f21 + f12 * f22
    mean, half = (b11 + b22) / 2.0, (b11 - b22) / 2.0
    share = np.hypot(half, b12) / mean
    some = np.where(share > 0.0, share, 0.5)
    slope = np.where(share > 0.0, np.arctanh(some) / some, 1.0) / (2.0 * mean)
    volume = np.log(f11 * f22 - f12 * f21) / 2.0
    return np.array([volume + slope * half, volume - slope * half, slope * b12])
