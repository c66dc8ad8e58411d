"""Reference implementation of `pgran.space.weakform` by loops over elements and points.

For NGF and LI, without storage.
"""

import numpy as np


def velocity_gradients(kinematics, value, slope, r):
    """Tensors (velocities, nodes, 3, 3) of d v_i/d x_j of each shape function of each velocity.

    ``value`` (nodes,) and ``slope`` (dim, nodes) belong to a point with the radius ``r``.
    """
    L = np.zeros((kinematics.velocities, value.size, 3, 3))
    for c in range(kinematics.velocities):
        L[c, :, c, :kinematics.dim] = slope.T
    if kinematics.axisymmetric:  # e_r and e_t turn with the angle
        L[0, :, 2, 2] = value / r
        if kinematics.velocities == 3:
            L[2, :, 0, 2] = -value / r
    return L


def element_arrays(form, local, increment, e):
    """Forces (n,) and tangent (n, n) of element ``e``, unknowns as in ``element_unknowns``."""
    grid, material, kinematics = form.grid, form.material, form.kinematics
    table, unknowns = grid.element, grid.element_unknowns[:, e]
    nodal, n = local[unknowns], unknowns.size
    first = kinematics.velocities * table.nodes  # of g
    x = increment.x[:, grid.element_nodes[:, e]]
    law = material.law.weakened(form.case.yield_factor(*grid.elements.index[:, [e]]))
    base = np.zeros((3, 3))
    base[:kinematics.velocities, :kinematics.dim] = form.case.base_gradient
    if kinematics.axisymmetric:
        base[2, 2] = base[0, 0]
    forces, tangent = np.zeros(n), np.zeros((n, n))
    for q in range(table.points):
        jacobian = table.slope[:, q] @ x.T  # d x_i / d xi_r, (r, i)
        slope = np.linalg.solve(jacobian, table.slope[:, q])
        weight = table.weights[q] * np.linalg.det(jacobian)
        r = table.shape[q] @ x[0]
        if kinematics.axisymmetric:
            weight *= r
        # Strain rates (n, 3, 3) of the unknowns, and pressures (n,).
        L, corners = np.zeros((n, 3, 3)), np.zeros(n)
        L[:first] = velocity_gradients(kinematics, table.shape[q], slope, r).reshape(-1, 3, 3)
        B = 0.5 * (L + L.swapaxes(1, 2))
        corners[-table.corners:] = table.corner_shape[q]
        D = np.tensordot(nodal, B, 1) + 0.5 * (base + base.T)
        S, d = np.zeros((3, 3)), len(kinematics.directions)
        S[:d, :d] = kinematics.matrix(increment.stress[:, q, e])
        effective = D + increment.theta / 2.0 * S
        gdot = np.sqrt(2.0 * (effective**2).sum())
        P = corners @ nodal
        s = material.inverse_time(P)
        direction = 2.0 * effective / gdot if gdot > 0.0 else np.zeros((3, 3))
        gdot_rate = np.tensordot(B, direction, 2)  # d gdot~ / d unknowns
        g, fluidities = np.zeros(n), np.zeros((kinematics.dim, n))
        if grid.has_fluidity:
            span = slice(first, first + table.nodes)
            g[span], fluidities[:, span] = table.shape[q], slope
        found = material.model.response(law, *(np.array([part]) for part in (
            s, gdot, P, g @ nodal)), increment.theta)
        viscosity, divergence = found.viscosity, np.trace(B, axis1=1, axis2=2)
        stress = 2.0 * viscosity.value * effective - P * np.eye(3)
        change = 2.0 * viscosity.value * B + np.multiply.outer(
            viscosity.rate * gdot_rate + viscosity.pressure * corners + viscosity.fluidity * g,
            2.0 * effective) - np.multiply.outer(corners, np.eye(3))
        forces += weight * (np.tensordot(B, stress, 2) - corners * np.trace(D))
        tangent += weight * (np.einsum("aij,bij->ab", B, change) - np.outer(corners, divergence))
        if grid.has_fluidity:
            diffusion, source = material.model.diffusion, found.source
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
