"""Reference implementation of the forces of `pgran.space.weakform` by loops, without storage."""

import numpy as np

from pgran.space import element


def element_forces(form, local, increment, e):
    """Forces (n,) of element ``e``, unknowns as in ``element_unknowns``."""
    grid, material = form.grid, form.material
    nodal = local[grid.element_unknowns[:, e]]
    x = increment.x[:, grid.element_nodes[:, e]]
    law = material.law.weakened(form.case.yield_factor(grid.element_i[[e]], grid.element_j[[e]]))
    base, n = form.case.base_gradient, nodal.size
    forces = np.zeros(n)
    for q in range(9):
        slopes = element.SHAPE_SLOPE[:, q]
        map_ = slopes @ x.T  # d x_i / d xi_r, (r, i)
        slope, weight = np.linalg.solve(map_, slopes), element.WEIGHTS[q] * np.linalg.det(map_)
        # Rows of B take the unknowns to D11, D22, D12.
        B, corners, g = np.zeros((3, n)), np.zeros(n), np.zeros(n)
        B[0, :9], B[1, 9:18] = slope
        B[2, :9], B[2, 9:18] = slope[1] / 2.0, slope[0] / 2.0
        corners[-4:] = element.CORNER_SHAPE[q]
        D = B @ nodal + [base[0, 0], base[1, 1], (base[0, 1] + base[1, 0]) / 2.0]
        effective = D + increment.theta / 2.0 * increment.stress[:, q, e]
        gdot = np.sqrt(2.0 * (effective[0]**2 + effective[1]**2) + 4.0 * effective[2]**2)
        P, fluidities = corners @ nodal, np.zeros((2, n))
        if grid.has_fluidity:
            g[18:27], fluidities[:, 18:27] = element.SHAPE[q], slope
        r = material.model.response(law, *(np.array([part]) for part in (
            material.inverse_time(P), gdot, P, g @ nodal)), increment.theta)
        stress = 2.0 * r.viscosity.value * effective - [P, P, 0.0]
        forces += weight * (B.T @ ([1.0, 1.0, 2.0] * stress) - corners * (D[0] + D[1]))
        if grid.has_fluidity:
            forces += weight * (material.model.diffusion * fluidities.T @ (fluidities @ nodal)
                                + g * r.source.value)
    return forces


def residual(form, local, increment):
    """Residual (n_local,), complete in owned rows."""
    grid, held = form.grid, form.held
    values, local = local, np.where(held, increment.prescribed, local)
    forces = np.zeros(grid.n_local)
    for e in range(grid.n_elements):
        with np.errstate(invalid="ignore", divide="ignore"):
            np.add.at(forces, grid.element_unknowns[:, e],
                      element_forces(form, local, increment, e))
    grid.split(forces)[0][:] -= increment.load
    forces[held] = (values - increment.prescribed)[held]
    return forces
