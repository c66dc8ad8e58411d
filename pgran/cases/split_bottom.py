"""Shear in a cell whose floor is split: the split-bottom cell.

    mpiexec -n 2 python -m pgran -options_file options/split_bottom.opts

As `annular_cell`, but the rough floor turns at gdot0 for r < R_s and is at rest for r > R_s. The
node at R_s has half of its velocity. On the surface the angular velocity is an error function of
(r - R_c)/W.
"""

import numpy as np

from ..options import ParameterError
from . import ROUNDING, _fixed
from .annular_cell import AnnularCell, cell_options


class SplitBottom(AnnularCell):
    """A cell with a floor of which the inner part turns."""

    options = (*cell_options(1e-3, 20.0, 80.0, 20.0, 0.0),
               _fixed.size("split_radius", 50.0, "radius R_s at which the floor is split"))
    walls = ("left", "right", "bottom")

    def __init__(self, parameters):
        super().__init__(parameters)
        p = parameters
        distance = p.split_radius - p.inner_radius
        if not 0.0 < distance < self.gap:
            raise ParameterError("split_radius", f"{p.split_radius:g}", "must lie between "
                                 f"@inner_radius {p.inner_radius:g} and @outer_radius "
                                 f"{p.outer_radius:g}")
        corners = self.coordinates(*np.array([[2 * n, 0] for n in range(self.shape[0] + 1)]).T)[0]
        if np.abs(corners - p.split_radius).min() > ROUNDING * p.split_radius:
            raise ParameterError("split_radius", f"{p.split_radius:g}", "must lie between two "
                                 f"elements; with @element_size {p.element_size:g} the closest "
                                 f"is {corners[np.abs(corners - p.split_radius).argmin()]:g}")

    def hold_floor(self, values, r, floor):
        split = self.parameters.split_radius
        turning = np.where(np.abs(r - split) < ROUNDING * split, 0.5, r < split)
        values[:2, floor] = 0.0
        values[2, floor] = (turning * r)[floor]

    def turning(self, r, z):
        """Return angular velocity and shear rate of a harmonic flow between planes above a split.

        The function -cos(pi (x + i z)/L) maps the strip between the walls to the upper half-plane.
        """
        p, scale = self.parameters, np.pi / self.gap
        place, split = (scale * (part - p.inner_radius) for part in (r + 1j * z, p.split_radius))
        distance = np.cos(split) - np.cos(place)
        least = 0.5 * scale * p.element_size * np.sin(split)
        size = np.maximum(np.abs(distance), least)
        return np.angle(distance) / np.pi, r * scale / np.pi * (0.02 + np.abs(np.sin(place))) / size

    def observe(self, flow):
        """Return the torque of the turning parts on the material, stress d^3."""
        return {"torque": flow.torque("left") + flow.torque("bottom")}
