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


def strain_fields(kinematics, rates, stretches=None):
    """Return strain rate (m, ...), spin, strain (m, ...) and det F - 1, {name: ndarray}.

    ``rates`` are d v_c/d x_k and v_c/r, and ``stretches`` d x_c/d X_k and x_c/R since the start, as
    from `pgran.space.grid.Grid.gradient`. Tensors have tensor components. The spin has one value
    (...) if only two directions turn, and one per pair otherwise.
    """
    spin = kinematics.spin(*rates)
    found = {"strain_rate_tensor": kinematics.tensor(kinematics.strain_rate(*rates)),
             "spin": spin if len(spin) > 1 else spin[0]}
    if stretches is not None:
        F = kinematics.deformation_gradient(*stretches)
        found["strain_tensor"] = kinematics.tensor(kinematics.of_matrix(logarithmic_strain(F)))
        found["volume_change"] = np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1))) - 1.0
    return found


def logarithmic_strain(F):
    """Return Hencky's strain ln V = ln(F F^T)/2 of deformation gradients F = V R, (d, d, ...)."""
    b = np.moveaxis(np.einsum("ik...,jk...->ij...", F, F), (0, 1), (-2, -1))
    squares, axes = np.linalg.eigh(b)
    strain = (axes * (0.5 * np.log(squares))[..., None, :]) @ axes.swapaxes(-2, -1)
    return np.moveaxis(strain, (-2, -1), (0, 1))

