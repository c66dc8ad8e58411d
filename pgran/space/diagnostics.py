"""Fields at the nodes, energy, and integrals of a solution of a `WeakForm`."""

import numpy as np

from ..material.elasticity import strain_fields

#: A nodal pressure below this fraction of the mean pressure of the elements around it is only
#: discretisation error.
VANISHING = 1e-3


def nodal_strains(form, velocity, x):
    """Return the `strain_fields` at the nodes, {name: (..., n_nodes)}.

    The strain since the start belongs to moving meshes only. ``velocity`` (c, n_nodes) is in
    d gdot0, and the nodes ``x`` (dim, n_nodes) are in d.
    """
    grid, stretches = form.grid, None
    if form.case.moving:
        stretches = grid.gradient(x, form.case.coordinates(*grid.nodes.index))
    found = strain_fields(form.kinematics, grid.gradient(velocity, x), stretches)
    return {name: grid.at_nodes(values) for name, values in found.items()}


def nodal_fields(form, local, increment):
    """Return ``fluidity``, ``pressure``, ``inertial_number`` and ``stress_ratio`` at the nodes.

    Arrays (n_nodes,), complete at owned nodes. For NGF g is nodal and I = g mu/s. mu, and for LI
    and where the nodal pressure vanishes also I and g, come from the Gauss points.
    """
    grid = form.grid
    _, fluidity, corners = grid.split(local)
    pressure = grid.corner_field(corners)
    values = form.collect(local, increment, lambda p: np.array([
        p.response.stress_ratio, p.response.inertial_number, p.response.fluidity,
        np.broadcast_to(p.P.mean(axis=0), p.P.shape)]))
    mu, I, smooth_fluidity, mean_pressure = grid.at_nodes(values)
    if grid.has_fluidity:
        chosen = pressure > VANISHING * mean_pressure
        I[chosen] = (fluidity * mu)[chosen] / form.material.inverse_time(pressure[chosen])
    else:
        fluidity = smooth_fluidity
    return {"fluidity": fluidity, "pressure": pressure, "inertial_number": I, "stress_ratio": mu}


def power(form, local, forces, increment):
    """Return the power that the material receives and the power that it dissipates. Collective.

    ::

        received   = sum over held nodes f.v + <t, v> + (b, v) + (sigma, L_0)
        dissipated = (sigma', D_p) = (g mu, mu P)

    ``forces`` (n_local,) come from `WeakForm.forces`. The received power is the sum of the
    dissipated power and the rate of the stored energy, in stress d^2 gdot0 per unit depth.
    """
    grid, case = form.grid, form.case
    base = case.base_gradient
    base_rate = form.kinematics.strain_rate(base, base[:, 0])  # v_r/r is d v_r/d r
    velocity = grid.split(np.where(form.held, increment.prescribed, local))[0]
    reactions = grid.split(np.where(form.held, forces, 0.0))[0]
    received = ((reactions + increment.load) * velocity)[:, grid.nodes.owned].sum()

    def densities(p):
        dissipated = p.response.fluidity * p.response.stress_ratio**2 * p.P
        inside = np.zeros_like(dissipated)
        if np.any(base):
            inside += np.tensordot(base_rate, p.stress(), 1)
        if case.body_force is not None:
            inside += (case.body_force(p.x) * p.velocity).sum(axis=0)
        return np.array([inside, dissipated])

    inside, dissipated = _over_elements(
        grid, increment.geometry.weight * form.collect(local, increment, densities))
    return form.kinematics.circumference * grid.comm.tompi4py().allreduce(
        np.array([received + inside, dissipated]))


def stored_energy(form, local, stress, geometry):
    """Return the stored energy and the volume, stress d^dim and d^dim. Collective.

    The energy is sigma':sigma'/(4 G) and, with inertia, phi rho_s v^2/2.
    """
    energy = (stress**2).sum(axis=0) / (4.0 * form.material.G)
    density = form.storage["velocity"]
    if density:
        nodal = form.grid.split(local)[0][:, form.grid.element_nodes]
        energy = energy + 0.5 * density * sum((form.element.shape @ part)**2 for part in nodal)
    sums = _over_elements(form.grid, geometry.weight * np.array([energy, np.ones_like(energy)]))
    return form.kinematics.circumference * form.grid.comm.tompi4py().allreduce(sums)


def integrals(grid, nodal, geometry):
    """Return the integrals (k + 1,) of Q2 fields (k, n_nodes) and 1 over this rank's elements."""
    nodal = np.array([*nodal, np.ones(nodal.shape[1])])
    values = grid.element.shape @ nodal[:, grid.element_nodes]
    return _over_elements(grid, geometry.weight * values)


def side_integrals(grid, nodal, x, side):
    """Return the integrals (k + 1,) of the same along a side of this rank's elements."""
    elements, rule = grid.side_elements(side), grid.element.side_rules[side]
    elements = np.intersect1d(elements, grid.elements.owned)
    area = np.linalg.norm(grid.geometry(x, elements, rule).area(side), axis=0)
    nodal = np.array([*nodal, np.ones(nodal.shape[1])])
    values = rule.shape @ nodal[:, grid.element_nodes[:, elements]]
    return (area * values).sum(axis=(1, 2))


def reaction(grid, forces, side):
    """Return the force (c,) of a side on the owned nodes, from `WeakForm.forces`."""
    nodes = np.intersect1d(grid.side_nodes(side), grid.nodes.owned)
    return grid.kinematics.circumference * grid.split(forces)[0][:, nodes].sum(axis=1)


def _over_elements(grid, values):
    """Sums (k,) of values (k, points, n) over the elements that this rank owns."""
    return values[..., grid.elements.owned].sum(axis=(1, 2))
