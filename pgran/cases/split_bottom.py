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
        """Return angular velocity and shear rate of a column r < R_s with a blurred boundary."""
        width = 0.5 * (1.0 + z)
        u = (r - self.parameters.split_radius) / width
        slope = 0.5 / np.cosh(np.minimum(np.abs(u), 300.0))**2 / width
        return 0.5 * (1.0 - np.tanh(u)), r * slope * np.hypot(1.0, 0.5 * u)

    def observe(self, flow):
        """Return the torque of the turning parts on the material, stress d^3."""
        return {"torque": flow.torque("left") + flow.torque("bottom")}
