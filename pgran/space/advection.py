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

from .element import DIM, GAUSS_TO_NODES, POINTS, SHAPE, SHAPE_SLOPE, SIDES, WEIGHTS, Geometry

#: Largest number of elements that material crosses in a substep. The limit of stability is 0.209
#: for quadratic elements and third-order Runge-Kutta (Cockburn and Shu, 2001).
SUBSTEP = 0.16
#: The sides of an element as (name, reference direction across, outward sign). The side opposite
#: to number f is number f ^ 1.
FACES = ("left", 0, -1), ("right", 0, 1), ("bottom", 1, -1), ("top", 1, 1)
#: Values on the sides, (sides, side points, points), of the biquadratic through the Gauss points.
TRACE = np.array([SIDES[name].from_gauss for name, _, _ in FACES])
#: Its derivatives along the reference directions at the Gauss points, then its `TRACE`, in rows.
TABLE = np.concatenate([*(slope @ GAUSS_TO_NODES for slope in SHAPE_SLOPE), *TRACE])
#: What the values at the Gauss points contribute to the mean of an element.
MEAN = WEIGHTS / WEIGHTS.sum()


def _inflow(name, axis, sign, velocity, x):
    """The weighted inflow (side points, m) through a side of m elements, d^2 gdot0."""
    rule = SIDES[name]
    (v1, v2), (t1, t2) = rule.shape @ velocity, rule.slope[1 - axis] @ x
    along = (v1 * t2 - v2 * t1) * (1, -1)[axis]
    return rule.weights[:, None] * np.maximum(-sign * along, 0.0)


class Advection:
    """Advects fields at the Gauss points with a flow through a fixed mesh. Collective.

    Material that enters the domain has the mean value of the element that it enters. ``velocity``,
    d gdot0, and ``x``, d, are (2, n_nodes). ``rate`` is the largest number of elements that
    material crosses per time, along i plus along j, gdot0.
    """

    def __init__(self, grid, velocity, x):
        self.grid, cells = grid, grid.elements
        nodes = grid.element_nodes[:, cells.owned]
        x, velocity = x[:, nodes], velocity[:, nodes]
        geometry = Geometry(x)
        self._weight = geometry.weight
        # Velocity along the reference directions; an element has the length 2.
        self._speed = np.einsum("irqe,iqe->rqe", geometry.inverse, SHAPE @ velocity)
        crossed = np.abs(self._speed).sum(axis=0).max(initial=0.0) / 2.0
        self.rate = grid.comm.tompi4py().allreduce(crossed, MPI.MAX)
        self._inflow = np.array([_inflow(*face, velocity, x) for face in FACES])
        self._at_wall = np.array([
            (grid.layer(name)[cells.owned] == 0) & (not grid.periodic[axis])
            for name, axis, _ in FACES])

    def advect(self, fields, dt):
        """Return fields (k, points, n) after a time ``dt``, 1/gdot0. Collective."""
        count = max(1, math.ceil(self.rate * dt / SUBSTEP))
        h, values = dt / count, fields[..., self.grid.elements.owned]
        for _ in range(count):
            middle = values + h / 3.0 * self._slope(values)
            middle = values + h / 2.0 * self._slope(middle)
            values = values + h * self._slope(middle)
        return self.grid.with_ghost_elements(values)

    def _slope(self, values):
        """ds/dt (k, points, m) of values at the Gauss points of the m owned elements."""
        table = TABLE @ values
        k, _, m = table.shape
        inner = table[:, DIM * POINTS:].reshape(k, len(FACES), -1, m)
        outer = self._across(inner)
        mean = (MEAN @ values)[:, None, None]
        jump = inner - np.where(self._at_wall[:, None], mean, outer)
        lifted = TRACE.reshape(-1, POINTS).T @ (self._inflow * jump).reshape(k, -1, m)
        slopes = table[:, :DIM * POINTS].reshape(k, DIM, POINTS, m)
        return -(self._speed * slopes).sum(axis=1) - lifted / self._weight

    def _across(self, inner):
        """The values on the other side of each side, shaped as ``inner`` (k, sides, points, m)."""
        ring, outer = self.grid.element_ring(inner), np.empty_like(inner)
        for number, (_, axis, sign) in enumerate(FACES):
            i, j = (slice(1 + shift, ring.shape[-1 - other] - 1 + shift) for other, shift in
                    enumerate((sign * (axis == 0), sign * (axis == 1))))
            outer[:, number] = ring[:, number ^ 1, :, j, i].reshape(outer[:, number].shape)
        return outer
