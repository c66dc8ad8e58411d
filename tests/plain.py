"""Reference implementation of `pgran.space.weakform` by loops over elements and points.

For NGF and LI, without storage.
"""

import numpy as np

from pgran.space import element


def element_arrays(form, local, increment, e):
    """Forces (n,) and tangent (n, n) of element ``e``, unknowns as in ``element_unknowns``."""
    grid, material = form.grid, form.material
    unknowns = grid.element_unknowns[:, e]
    nodal, n = local[unknowns], unknowns.size
    x = increment.x[:, grid.element_nodes[:, e]]
    law = material.law.weakened(form.case.yield_factor(grid.element_i[[e]], grid.element_j[[e]]))
    base = form.case.base_gradient
    forces, tangent = np.zeros(n), np.zeros((n, n))
    for q in range(9):
        jacobian = element.SHAPE_SLOPE[:, q] @ x.T  # d x_i / d xi_r, (r, i)
        slope = np.linalg.solve(jacobian, element.SHAPE_SLOPE[:, q])
        weight = element.WEIGHTS[q] * np.linalg.det(jacobian)
        # Rows of B take the unknowns to D11, D22, D12.
        B, corners = np.zeros((3, n)), np.zeros(n)
        B[0, :9], B[1, 9:18] = slope
        B[2, :9], B[2, 9:18] = slope[1] / 2.0, slope[0] / 2.0
        corners[-4:] = element.CORNER_SHAPE[q]
        D = B @ nodal + [base[0, 0], base[1, 1], (base[0, 1] + base[1, 0]) / 2.0]
        effective = D + increment.theta / 2.0 * increment.stress[:, q, e]
        gdot = np.sqrt(2.0 * (effective[0]**2 + effective[1]**2) + 4.0 * effective[2]**2)
        P = corners @ nodal
        s = material.inverse_time(P)
        trace, twice = np.array([1.0, 1.0, 0.0]), np.array([1.0, 1.0, 2.0])
        direction = 2.0 * effective / gdot if gdot > 0.0 else np.zeros(3)
        gdot_rate = (direction * twice) @ B          # d gdot~ / d unknowns
        g, fluidities = np.zeros(n), np.zeros((2, n))
        if grid.has_fluidity:
            g[18:27], fluidities[:, 18:27] = element.SHAPE[q], slope
        r = material.model.response(law, *(np.array([part]) for part in (s, gdot, P, g @ nodal)),
                                    increment.theta)
        viscosity = r.viscosity
        stress = 2.0 * viscosity.value * effective
        change = (2.0 * viscosity.value * B + np.outer(2.0 * effective, (
            viscosity.rate * gdot_rate + viscosity.pressure * corners + viscosity.fluidity * g)))
        forces += weight * (B.T @ (twice * (stress - P * trace)) - corners * (D[0] + D[1]))
        tangent += weight * (B.T @ (twice[:, None] * (change - np.outer(trace, corners)))
                             - np.outer(corners, trace @ B))
        if grid.has_fluidity:
            diffusion, source = material.model.diffusion, r.source
            forces += weight * (diffusion * fluidities.T @ (fluidities @ nodal) + g * source.value)
            tangent += weight * (diffusion * fluidities.T @ fluidities + np.outer(g, (
                source.rate * gdot_rate + source.pressure * corners + source.fluidity * g)))
    return forces, tangent


def assembled(form, local, increment):
    """Residual (n_local,) and dense Jacobian (n_local, n_local), complete in owned rows."""
    grid, held = form.grid, form.held
    values, local = local, np.where(held, increment.prescribed, local)
    forces, tangent = np.zeros(grid.n_local), np.zeros((grid.n_local, grid.n_local))
    for e in range(grid.n_elements):
        unknowns = grid.element_unknowns[:, e]
        with np.errstate(invalid="ignore", divide="ignore"):
            part, block = element_arrays(form, local, increment, e)
        np.add.at(forces, unknowns, part)
        np.add.at(tangent, np.ix_(unknowns, unknowns), block)
    grid.split(forces)[0][:] -= increment.load
    forces[held] = (values - increment.prescribed)[held]
    tangent[held], tangent[:, held] = 0.0, 0.0
    tangent[held, held] = 1.0
    return forces, tangent
