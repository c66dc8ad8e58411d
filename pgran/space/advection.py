"""Transport of fields at the Gauss points through a fixed mesh, ds/dt + v.grad s = 0.

The scheme is the upwind discontinuous Galerkin method with biquadratic elements and the Gauss
points as nodes, whose mass matrix is diagonal::

    (w, ds/dt) = -(w, v.grad s) - <w, max(-v.n, 0) (s - s_upwind)>

The last term is the integral over the sides of an element, n is the outward normal, and s_upwind is
the value on the other side. The third-order Runge-Kutta method takes as many substeps as stability
requires. The order is 3 in space and time, and a uniform field remains uniform to rounding.
"""

import math

import numpy as np
from mpi4py import MPI

from .element import SIDES

#: Largest number of elements that material crosses in a substep. The limit of stability is 0.209
#: for quadratic elements and third-order Runge-Kutta (Cockburn and Shu, 2001).
SUBSTEP = 0.16


class Advection:
    """Advects fields at the Gauss points with a flow through a fixed mesh. Collective.

    Material that enters the domain has the mean value of the element that it enters. ``velocity``
    (c, n_nodes) is in d gdot0, and ``x`` (dim, n_nodes) in d. ``rate`` is the largest number of
    elements that material crosses per time, summed over the axes, gdot0.
    """

    def __init__(self, grid, velocity, x):
        self.grid, self._element, owned = grid, grid.element, grid.elements.owned
        geometry, e = grid.geometry(x, owned), grid.element
        velocity = velocity[:grid.dim, grid.element_nodes[:, owned]]
        self._weight = geometry.weight
        # Velocity along the reference directions; an element has the length 2.
        self._speed = np.einsum("krqe,kqe->rqe", geometry.inverse, e.shape @ velocity)
        crossed = np.abs(self._speed).sum(axis=0).max(initial=0.0) / 2.0
        self.rate = grid.comm.tompi4py().allreduce(crossed, MPI.MAX)
        #: Values on the sides, (sides times side points, points), of the polynomial through the
        #: Gauss points, and its derivatives along the reference directions at the Gauss points.
        self._trace = np.concatenate([rule.from_gauss for rule in e.side_rules.values()])
        self._slopes = np.concatenate([slope @ e.gauss_to_nodes for slope in e.slope])
        # The weighted inflow through the sides, (sides, side points, m).
        self._inflow = np.array([
            np.maximum(-(rule.shape @ velocity * grid.geometry(x, owned, rule).area(side)).sum(
                axis=0), 0.0) for side, rule in e.side_rules.items()])
        self._at_wall = np.array([
            (grid.layer(side)[owned] == 0) & (not grid.periodic[SIDES[side][0]])
            for side in e.side_rules])

    def advect(self, fields, dt):
        """Return fields (k, points, n) after a time ``dt``, 1/gdot0. Collective."""
        count = max(1, math.ceil(self.rate * dt / SUBSTEP))
        h, values = dt / count, fields[..., self.grid.elements.owned]
        for _ in range(count):
            middle = values + h / 3.0 * self._rate_of(values)
            middle = values + h / 2.0 * self._rate_of(middle)
            values = values + h * self._rate_of(middle)
        return self.grid.with_ghost_elements(values)

    def _rate_of(self, values):
        """ds/dt (k, points, m) of values at the Gauss points of the m owned elements."""
        e, (k, _, m) = self._element, values.shape
        inner = (self._trace @ values).reshape(k, len(self._inflow), -1, m)
        outer = self._across(inner)
        mean = (e.weights / e.weights.sum() @ values)[:, None, None]
        jump = inner - np.where(self._at_wall[:, None], mean, outer)
        lifted = self._trace.T @ (self._inflow * jump).reshape(k, -1, m)
        slopes = (self._slopes @ values).reshape(k, e.dim, e.points, m)
        return -(self._speed * slopes).sum(axis=1) - lifted / self._weight

    def _across(self, inner):
        """The values on the other side of each side, shaped as ``inner`` (k, sides, points, m)."""
        ring, outer = self.grid.element_ring(inner), np.empty_like(inner)
        for number, (axis, end) in enumerate(self._element.sides.values()):
            inside = [slice(1, -1)] * self.grid.dim
            inside[-1 - axis] = slice(1 + end, ring.shape[-1 - axis] - 1 + end)
            outer[:, number] = ring[(slice(None), number ^ 1, slice(None), *inside)].reshape(
                outer[:, number].shape)
        return outer
