"""Plane-strain compression of a rectangular specimen (section 4, figure 3(a)).

The bottom carries v2 = 0, its left corner also v1 = 0; the top moves down at
v2 = D2 H exp(D2 t) and slides freely; the lateral faces carry the normal stress
sigma_1 = -1, which follows the deformed normal; the fluidity has no flux through
any face. The element to the upper right of the centre has a lower yield value; how large
the weak square is, whether it lies to the left, and whether the plates hold the specimen are
options.
"""

import numpy as np

from ..options import elements_along
from . import BaseCase


class Case(BaseCase):
    """The specimen; raises `OptionError` where elements do not divide width and height."""

    side_stresses = {"left": -1.0, "right": -1.0}
    plate = "top"

    def __init__(self, settings, material):
        super().__init__(settings, material)
        self.shape = tuple(elements_along(name, getattr(settings, name), settings.element_size)
                           for name in ("width", "height"))
        self._weak = 1 if settings.imperfection_size is None else elements_along(
            "imperfection_size", settings.imperfection_size, settings.element_size)

    def coordinates(self, i, j):
        half = self.settings.element_size / 2.0
        return np.array([i * half, j * half])

    def prescribed(self, time, i, j):
        values = np.full((2, i.size), np.nan)
        values[1, j == 0] = 0.0
        values[0, (i == 0) & (j == 0)] = 0.0
        if not self.settings.plates_slip:
            ends = (j == 0) | (j == 2 * self.shape[1])
            x1 = self.coordinates(i, j)[0, ends]  # of the material, before it moved
            values[0, ends] = 0.5 * x1 * np.exp(0.5 * time)
        values[1, j == 2 * self.shape[1]] = -0.5 * self.settings.height * np.exp(-0.5 * time)
        return values

    def start(self, x):
        return np.array([0.5 * x[0], -0.5 * x[1]])

    def yield_factor(self, i, j):
        nx, ny = self.shape
        if self.settings.imperfection_mirrored:
            i = nx - 1 - i
        weak = ((nx // 2 <= i) & (i < nx // 2 + self._weak)
                & (ny // 2 <= j) & (j < ny // 2 + self._weak))
        return np.where(weak, self.settings.imperfection, 1.0)
