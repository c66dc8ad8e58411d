"""A periodic cell of homogeneous pure shear (3.20).

The unknown velocity is the deviation v' from v = (x1/2, -x2/2). Velocity, pressure and fluidity are
periodic over width and height. One corner has the pressure P0, because the equations determine the
pressure except for a constant. Without inertia the velocity of one node is prescribed for the same
reason. Inertia is phi rho_s dv'/dt as in section 3; the convective term L0 v' is smaller by
A^2 phi I0^2/mu_loc and neglected.
"""

import numpy as np

from ..options import Option
from . import PureShear


class Periodic(PureShear):
    """A cell of homogeneous material without boundaries."""

    options = (
        *PureShear.SIZE,
        Option("cell_elements", "int", 16, "", "elements in each direction", low=2),
        Option("imperfection", "float", 0.99, "", "yield value of the central element over mu_s; "
               "1: no imperfection", low=0.0, open_low=True, high=1.0),
    )
    periodic = True, True
    base_gradient = np.array([[0.5, 0.0], [0.0, -0.5]])

    @classmethod
    def resolve(cls, parameters, names):
        super().resolve(parameters, names)
        super(PureShear, cls).resolve(parameters, names)

    @classmethod
    def with_wave(cls, parameters, k):
        width, height = 2.0 * np.pi / np.abs(k)
        return parameters.replace(width=float(width), height=float(height))

    @property
    def shape(self):
        return (self.parameters.cell_elements,) * 2

    def coordinates(self, i, j):
        p = self.parameters
        return np.array([i * p.width, j * p.height]) / (2 * p.cell_elements)

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        n = self.parameters.cell_elements
        if not self.parameters.inertia:
            values[:, (i % (2 * n) == 0) & (j % (2 * n) == 0)] = 0.0
        return values

    def prescribed_pressure(self, time, i, j):
        n = self.parameters.cell_elements
        return np.where((i % n == 0) & (j % n == 0), self.pressure, np.nan)

    def yield_factor(self, i, j):
        n = self.parameters.cell_elements
        centre = (i % n == n // 2) & (j % n == n // 2)
        return np.where(centre, self.parameters.imperfection, 1.0)
