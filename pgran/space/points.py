"""Strain rate and response of the material at quadrature points of a batch of elements.

Arrays are (points, n): point first, element last.
"""

import numpy as np

from ..material.models import WithDerivatives
from .element import Geometry, sum_arrays


def secant(slope, curvature, change):
    """Return the slope of the secant over which a function F changes by ``change``, (points, n).

    With ``slope`` F' and ``curvature`` F'', change/F' improved to second order has the secant::

        (F' + sign(F') sqrt(F'^2 + 2 F'' change))/2

    The result is never steeper than the tangent, and F'/2 where the parabola has no root. At the
    close roots mu = mu_s and g = g_loc of the source it converges faster than the tangent.
    """
    below = np.minimum(2.0 * curvature * change, 0.0)
    root = np.sqrt(np.maximum(slope**2 + below, 0.0))
    return (slope + np.copysign(root, slope)) / 2.0


def _add_decay(source, decay, g):
    """Add ``decay`` times the fluidity ``g`` to a source F."""
    source.value = source.value + decay * g
    source.fluidity = source.fluidity + decay


class BatchPoints:
    """Strain rate and `Response` at the Gauss points of a batch of elements.

    Attributes
    ----------
    gradients : list of list
        gradients[c][k] = d v_c/d x_k, (points, n), base flow included.
    over_r : ndarray or None
        v_c/r, (c, points, n), with rotational symmetry.
    nodal : ndarray, (rows, n)
        Unknowns of the elements, block by block; ``nodal_g`` (nodes, n) are the fluidities or None.
    rate : ndarray, (m, points, n)
        Effective strain rate D~ = D + theta S/2 in Mandel notation.
    gdot, P, divergence : ndarray, (points, n)
        The magnitude of D~, the pressure, and div v.
    """

    def __init__(self, form, local, increment, number):
        grid, batch = form.grid, form.batches[number]
        self.element, self.kinematics = grid.element, grid.kinematics
        self.nodal = nodal = local[grid.element_unknowns[:, batch]]
        self.elements = nodal.shape[1]
        self.geometry = geometry = increment.geometry[batch]
        self.nodes, self._x = grid.element_nodes[:, batch], increment.x
        self._base, theta = form.case.base_gradient, increment.theta
        self._nodal_velocity = [nodal[grid.blocks[name]] for name in grid.velocities]
        self.gradients = [geometry.gradient(part) + np.reshape(row, (-1, 1, 1))
                          for part, row in zip(self._nodal_velocity, self._base)]
        self.over_r = None
        if geometry.over_r is not None:
            self.over_r = self.total_velocity * geometry.over_r
        self.rate = self.kinematics.strain_rate(self.gradients, self.over_r)
        self.divergence = sum_arrays(self.rate[m] for m in self.kinematics.normal)
        self.rate += increment.stress[:, :, batch] * (theta / 2.0)
        self.gdot = np.sqrt(2.0 * (self.rate**2).sum(axis=0))
        self.P = self.element.corner_shape @ nodal[grid.blocks["P"]]
        self.nodal_g = nodal[grid.blocks["g"]] if grid.has_fluidity else None
        fluidity = self.element.shape @ self.nodal_g if grid.has_fluidity else None
        self._material, self._law = form.material, form.laws[number]
        self.response = form.material.model.response(
            self._law, form.material.inverse_time(self.P), self.gdot, self.P, fluidity, theta)
        self.decay = increment.decay
        if self.decay:
            _add_decay(self.response.source, self.decay, fluidity)

    @property
    def nodal_x(self):
        """Coordinates of the nodes, (dim, nodes, n)."""
        return self._x[:, self.nodes]

    @property
    def x(self):
        """Coordinates of the points, (dim, points, n)."""
        return self.element.shape @ self.nodal_x

    @property
    def velocity(self):
        """Velocity at the points without the base flow, (c, points, n)."""
        return np.array([self.element.shape @ part for part in self._nodal_velocity])

    @property
    def total_velocity(self):
        """Velocity at the points with the base flow, (c, points, n), d gdot0."""
        return self.velocity + np.tensordot(self._base, self.x, 1)

    def deviator(self):
        """Return sigma' = 2 viscosity D~, (m, points, n)."""
        return 2.0 * self.response.viscosity.value * self.rate

    def stress(self):
        """Return sigma = sigma' - P 1, (m, points, n)."""
        stress = self.deviator()
        for m in self.kinematics.normal:
            stress[m] -= self.P
        return stress

    def operators(self):
        """Return the `pgran.kinematics.Kinematics.operators` S at the points."""
        return self.kinematics.operators(self.geometry.inverse, self.geometry.over_r)

    def spurious_root(self):
        """Return `Model.spurious_root` at the points, (points, n)."""
        return self._material.model.spurious_root(
            self._law, self.response.stress_ratio, self.response.inertial_number)

    def stress_ratio_slopes(self):
        """Return mu = viscosity gdot~/P as `WithDerivatives` of arrays (points, n)."""
        viscosity, mu = self.response.viscosity, self.response.stress_ratio
        return WithDerivatives(mu, rate=(viscosity.value + viscosity.rate * self.gdot) / self.P,
                               pressure=(viscosity.pressure * self.gdot - mu) / self.P,
                               fluidity=viscosity.fluidity * self.gdot / self.P)

    def secant_source(self, defect):
        """Return F, with the slope in mu of the `secant` over which it falls by a defect."""
        source, mu = self.response.source, self.stress_ratio_slopes()
        slope = source.rate / mu.rate
        curvature = self._material.model.curvature(
            self._law, self._material.inverse_time(self.P), mu.value, self.P,
            self.response.fluidity)
        change = secant(slope, curvature, -defect) - slope
        return WithDerivatives(source.value, *(
            getattr(source, name) + change * getattr(mu, name)
            for name in ("rate", "pressure", "fluidity")))

    def direction(self):
        """Return n = 2 D~/gdot~, 0 at rest, (m, points, n)."""
        return self.rate * (2.0 / np.where(self.gdot > 0.0, self.gdot, np.inf))


def contracted(operators, tensor):
    """Return sum_m S[c][m] T_m for each c, [(slots, points, n)], of a tensor T (m, points, n)."""
    return [sum_arrays(S * (tensor[m] if factor == 1.0 else factor * tensor[m])
                  for m, (factor, S) in parts.items()) for parts in operators]


class RulePoints:
    """Points of another quadrature rule in the ``chosen`` elements (m,) of a batch.

    mu is the biquadratic through its values at the Gauss points, where it satisfies equilibrium.
    The local strain rate would be divided by a fluidity or a pressure that may vanish. A subclass
    sets the integrand ``value``, `WithDerivatives` with respect to mu, P and g. Its integral
    belongs to the ``nodes`` (k,) of an element, with shape functions ``tests`` (rule points, k).
    """

    def __init__(self, form, p, rule, chosen, law, nodes):
        self.rule, self.chosen, self.nodes = rule, chosen, np.array(nodes)
        self.tests, blocks = rule.shape[:, self.nodes], form.grid.blocks
        self.weight = Geometry(p.nodal_x[..., chosen], rule, p.kinematics.axisymmetric).weight
        P = rule.corner_shape @ p.nodal[blocks["P"]][:, chosen]
        self.arguments = (law, form.material.inverse_time(P),
                          rule.from_gauss @ p.response.stress_ratio[:, chosen], P,
                          rule.shape @ p.nodal_g[:, chosen])


class WallPoints(RulePoints):
    """The condition g - g_loc = 0 at the Gauss points of the sides of elements on a wall."""

    def __init__(self, form, p, side, chosen, law):
        super().__init__(form, p, p.element.side_rules[side], chosen, law,
                         p.element.side_nodes[side])
        self.value = form.material.model.fluidity_excess(*self.arguments)


class SurfacePoints(RulePoints):
    """The source F near a free surface, where s and thus F may be singular.

    With a ``defect`` (n_nodes,) the slope in mu is the slope of the `secant`.
    """

    def __init__(self, form, p, rule, chosen, law, defect=None):
        super().__init__(form, p, rule, chosen, law, range(p.element.nodes))
        model = form.material.model
        self.value = model.source(*self.arguments)
        if p.decay:
            _add_decay(self.value, p.decay, self.arguments[-1])
        if defect is not None:
            self.value.rate = secant(self.value.rate, model.curvature(*self.arguments),
                                     -(rule.shape @ defect[p.nodes[:, chosen]]))
