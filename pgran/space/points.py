"""Kinematics and response of the material at quadrature points of a batch of elements.

Arrays are (points, n): point first, element last.
"""

import numpy as np

from ..material.models import WithDerivatives
from . import element
from .element import DIM, NODES


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
    """Kinematics and `Response` at the Gauss points of a batch of elements.

    Attributes
    ----------
    gradients : list
        gradients[i][j] = d v_i/d x_j, (points, n), base flow included.
    nodal : ndarray, (rows, n)
        Unknowns of the elements, block by block; ``nodal_g`` (nodes, n) are the fluidities or None.
    d11, d22, d12, gdot, P, divergence : ndarray, (points, n)
        Effective strain rate D~ = D + theta S/2 and its magnitude, pressure, and div v.
    """

    def __init__(self, form, local, increment, number):
        grid, batch = form.grid, form.batches[number]
        self.nodal = nodal = local[grid.element_unknowns[:, batch]]
        self.elements = nodal.shape[1]
        self.geometry = increment.geometry[batch]
        self._base, theta = form.case.base_gradient, increment.theta
        self._nodal_velocity = [nodal[grid.blocks[name]] for name in grid.velocities]
        self.gradients = [self.geometry.gradient(part) + np.reshape(row, (DIM, 1, 1))
                          for part, row in zip(self._nodal_velocity, self._base)]
        (l11, l12), (l21, l22) = self.gradients
        s11, s22, s12 = increment.stress[:, :, batch] * (theta / 2.0)
        self.divergence = l11 + l22
        self.d11, self.d22, self.d12 = l11 + s11, l22 + s22, (l12 + l21) / 2.0 + s12
        self.gdot = np.sqrt(2.0 * (self.d11**2 + self.d22**2) + 4.0 * self.d12**2)
        self.P = element.CORNER_SHAPE @ nodal[grid.blocks["P"]]
        self.nodes, self._x = grid.element_nodes[:, batch], increment.x
        self.nodal_g = nodal[grid.blocks["g"]] if grid.has_fluidity else None
        fluidity = element.SHAPE @ self.nodal_g if grid.has_fluidity else None
        self._material, self._law = form.material, form.laws[number]
        self.response = form.material.model.response(
            self._law, form.material.inverse_time(self.P), self.gdot, self.P, fluidity, theta)
        self.decay = increment.decay
        if self.decay:
            _add_decay(self.response.source, self.decay, fluidity)

    @property
    def nodal_x(self):
        """Coordinates of the nodes, (2, nodes, n)."""
        return self._x[:, self.nodes]

    @property
    def x(self):
        """Coordinates of the points, (2, points, n)."""
        return element.SHAPE @ self.nodal_x

    @property
    def velocity(self):
        """Velocity at the points without the base flow, (2, points, n)."""
        return np.array([element.SHAPE @ part for part in self._nodal_velocity])

    @property
    def total_velocity(self):
        """Velocity at the points with the base flow, (2, points, n), d gdot0."""
        return self.velocity + np.tensordot(self._base, self.x, 1)

    def deviator(self):
        """Return sigma' = 2 viscosity D~, (3, points, n): 11, 22, 12."""
        return 2.0 * self.response.viscosity.value * np.array([self.d11, self.d22, self.d12])

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

    def direction_pulled_back(self):
        """Return sum_k n_ik d xi_r/d x_k with n = 2 D~/gdot~ (0 at rest), (2, 2, points, n)."""
        scale = 2.0 / np.where(self.gdot > 0.0, self.gdot, np.inf)
        n11, n22, n12 = scale * self.d11, scale * self.d22, scale * self.d12
        inverse = self.geometry.inverse
        return np.array([n11 * inverse[0] + n12 * inverse[1],
                         n12 * inverse[0] + n22 * inverse[1]])


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
        self.weight = element.Geometry(p.nodal_x[..., chosen], rule).weight
        P = rule.corner_shape @ p.nodal[blocks["P"]][:, chosen]
        self.arguments = (law, form.material.inverse_time(P),
                          rule.from_gauss @ p.response.stress_ratio[:, chosen], P,
                          rule.shape @ p.nodal_g[:, chosen])


class WallPoints(RulePoints):
    """The condition g - g_loc = 0 at the Gauss points of the sides of elements on a wall."""

    def __init__(self, form, p, side, chosen, law):
        super().__init__(form, p, element.SIDES[side], chosen, law, element.SIDE_NODES[side])
        self.value = form.material.model.fluidity_excess(*self.arguments)


class SurfacePoints(RulePoints):
    """The source F near a free surface, where s and thus F may be singular.

    With a ``defect`` (n_nodes,) the slope in mu is the slope of the `secant`.
    """

    def __init__(self, form, p, rule, chosen, law, defect=None):
        super().__init__(form, p, rule, chosen, law, range(NODES))
        model = form.material.model
        self.value = model.source(*self.arguments)
        if p.decay:
            _add_decay(self.value, p.decay, self.arguments[-1])
        if defect is not None:
            self.value.rate = secant(self.value.rate, model.curvature(*self.arguments),
                                     -(rule.shape @ defect[p.nodes[:, chosen]]))
