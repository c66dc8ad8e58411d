"""A periodic cell around homogeneous pure shear (3.20).

The unknown velocity is the departure from v = (x1/2, -x2/2). Velocity, pressure and fluidity are
periodic over width and height, with ``cell_elements`` elements each way. The pressure of one
corner is held at P0, which fixes the level that a closed incompressible cell leaves open. Without
inertia the velocity of one node is held as well. Inertia is that of the paper's section 3,
phi rho_s dv'/dt for the departure v': the convective L0 v' is left out, which is A^2 phi
I0^2/mu_loc of it.
"""

import numpy as np

from ..options import Option
from . import PureShear


class Periodic(PureShear):
    """A cell of homogeneous material without boundary."""

    options = (
        *PureShear.SIZE,
        Option("cell_elements", "int", 16, "", "elements each way", low=2),
        Option("imperfection", "float", 0.99, "", "yield value of the central element over mu_s; 1 "
               "leaves it out", low=0.0, open_low=True, high=1.0),
    )
    periodic = True, True
    base_gradient = np.array([[0.5, 0.0], [0.0, -0.5]])

    @classmethod
    def resolve(cls, parameters, given):
        """Fill in the height, and the end among the snapshots."""
        super().resolve(parameters, given)
        super(PureShear, cls).resolve(parameters, given)

    @classmethod
    def with_wave(cls, parameters, k):
        """Return the parameters of a cell of one wavelength of ``k`` (2,), 1/d, each way."""
        width, height = 2.0 * np.pi / np.abs(k)
        return parameters.replace(width=float(width), height=float(height))

    @property
    def shape(self):
        """Return the number of elements along x1 and x2."""
        return (self.parameters.cell_elements,) * 2

    def coordinates(self, i, j):
        """Return the initial coordinates (2, n) of nodes, d."""
        nx, ny = self.shape
        p = self.parameters
        return np.array([i * p.width / (2 * nx), j * p.height / (2 * ny)])

    def prescribed_velocity(self, time, i, j):
        """Return zero at one node without inertia; not numbers where free."""
        values = np.full((2, i.size), np.nan)
        if not self.parameters.inertia:
            nx, ny = self.shape
            values[:, (i % (2 * nx) == 0) & (j % (2 * ny) == 0)] = 0.0
        return values

    def prescribed_pressure(self, time, i, j):
        """Return P0 at one corner."""
        nx, ny = self.shape
        return np.where((i % nx == 0) & (j % ny == 0), self.pressure, np.nan)

    def yield_factor(self, i, j):
        """Return mu_s of elements over its nominal value, (n,)."""
        nx, ny = self.shape
        return np.where((i % nx == nx // 2) & (j % ny == ny // 2),
                        self.parameters.imperfection, 1.0)
