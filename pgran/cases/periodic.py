"""A periodic cell around homogeneous pure shear (3.20).

The unknown velocity is the departure from v = (x1/2, -x2/2); velocity, pressure
and fluidity are periodic over width and height, with ``-pgran_cell_elements``
elements each way. The pressure of one corner is held at P0, which fixes the
level that a closed incompressible cell leaves open; without inertia so is the
velocity of one node. Side and element size are independent of
``-pgran_element_size``. Inertia is that of the paper's section 3, phi rho_s dv'/dt for
the departure v' alone: the convective L0 v' is left out, A^2 phi I0^2/mu_loc of it.
"""

import numpy as np

from ..options import OptionError
from . import BaseCase


class Case(BaseCase):
    """The cell of ``-pgran_width`` and ``-pgran_height``. Raises `OptionError` below 2 elements."""

    periodic = True, True
    base_gradient = np.array([[0.5, 0.0], [0.0, -0.5]])

    def __init__(self, settings, material):
        super().__init__(settings, material)
        n = settings.cell_elements
        if n < 2:
            raise OptionError(f"-pgran_cell_elements {n}: a periodic cell needs at least 2")
        self.shape = n, n

    def coordinates(self, i, j):
        nx, ny = self.shape
        return np.array([i * self.settings.width / (2 * nx), j * self.settings.height / (2 * ny)])

    def prescribed(self, time, i, j):
        values = np.full((2, i.size), np.nan)
        if not self.settings.inertia:
            nx, ny = self.shape
            values[:, (i % (2 * nx) == 0) & (j % (2 * ny) == 0)] = 0.0
        return values

    def prescribed_pressure(self, time, i, j):
        nx, ny = self.shape
        return np.where((i % nx == 0) & (j % ny == 0), self.start_pressure(), np.nan)

    def start_pressure(self):
        return self.material.pressure

    def yield_factor(self, i, j):
        nx, ny = self.shape
        return np.where((i % nx == nx // 2) & (j % ny == ny // 2),
                        self.settings.imperfection, 1.0)
