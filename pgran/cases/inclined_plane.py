"""Flow down a rough inclined plane with a free surface.

    mpiexec -n 2 python -m pgran -options_file options/inclined_plane.opts

The layer 0 <= x2 <= H is periodic along x1, which points downhill. The base does not allow slip,
and the surface is free of stress. Stresses are in phi rho_s G d, and the unit of time is
d sqrt(rho_s/(phi rho_s G d)). The pressure vanishes at the surface; it is not limited from below.
"""

import numpy as np

from ..options import Option
from ..theory import profiles
from . import _fixed


class InclinedPlane(_fixed.Layer):
    """A layer that flows down a slope under its weight."""

    options = (
        _fixed.GRAINS_RATE,
        _fixed.size("width", 4.0, "length of the periodic layer"),
        _fixed.size("height", 20.0, "height H of the layer"),
        Option("slope", "float", 25.0, "degrees", "angle between the plane and the horizontal",
               low=0.0, high=90.0, open_high=True, shared=("restart",)),
        *_fixed.options(wall_fluidity="zero"))
    stress_unit = "phi rho_s G d"
    walls = ("bottom",)
    free_surfaces = ("top",)
    observables = {"shear_stress": "stress", "surface_speed": "d gdot0"}

    def __init__(self, parameters):
        super().__init__(parameters)
        self._angle = np.radians(parameters.slope)
        self.refuse_fast("slope", parameters.slope, np.tan(self._angle),
                         np.degrees(np.arctan(self.law.limit)))

    @property
    def why_at_rest(self):
        p = self.parameters
        static = self.static(f"the slope of {p.slope:g} degrees", np.tan(self._angle))
        if static or self.material.model.theory != "ngf_primitive" or p.wall_fluidity != "zero":
            return static
        least = profiles.stopping_height(self.law, p.A, p.slope)
        return None if p.height > least else (
            f"the height of {p.height:g} d does not exceed H_stop = (pi/2) xi = {least:.4g} d: the "
            "material comes to rest")

    @property
    def pressure(self):
        """Pressure at the base, phi rho_s G d."""
        return float(self.parameters.height * np.cos(self._angle))

    @property
    def weight(self):
        return np.sin(self._angle), -np.cos(self._angle)

    def reference(self, x):
        _, fluidity, _ = super().reference(x)
        speed = self.fluidity * np.tan(self._angle) * x[1]
        return (np.array([speed, 0.0 * speed]), fluidity,
                np.cos(self._angle) * (self.parameters.height - x[1]))

    def profile(self):
        p = self.parameters
        return profiles.inclined_plane(*self.rheology, p.height, p.slope, p.wall_fluidity)

    def observe(self, flow):
        """Return the shear stress of the base, phi rho_s G d, and the mean speed of the surface."""
        return {"shear_stress": -flow.reaction("bottom")[0] / self.parameters.width,
                "surface_speed": flow.mean_velocity("top")[0]}
