"""Flow through a vertical pipe under gravity.

    mpiexec -n 2 python -m pgran -options_file options/pipe.opts

The coordinates are r and z. On the axis v_r = 0. The rough wall r = R prevents motion along z, and
its pressure is P_w. The pipe is periodic along z, and the weight of the material, `-pgran_gravity`
P_w/d, points along -z. The unit of time is d sqrt(rho_s/P_w). Steady flow has P = P_w and
mu = gravity r/2.
"""

import numpy as np

from ..kinematics import AXISYMMETRIC
from . import _fixed


class Pipe(_fixed.Falling):
    """Material that falls through a pipe."""

    options = (
        _fixed.GRAINS_RATE,
        _fixed.size("radius", 10.0, "radius R of the pipe"),
        _fixed.size("height", 1.0, "length of the periodic pipe"),
        _fixed.gravity(0.1, "weight of the material, phi rho_s G d/P_w; the stress ratio at the "
                       "wall is mu = gravity R/2"),
        *_fixed.options())
    kinematics, span, symbol = AXISYMMETRIC, "radius", "R"
    periodic = False, True
    walls = ("right",)

    @property
    def shape(self):
        return self.elements_along("radius"), self.elements_along("height")

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        values[0, self.on("left", i, j)] = 0.0
        values[1, self.on("right", i, j)] = 0.0
        return values

    def reference(self, x):
        p = self.parameters
        velocity, fluidity, level = super().reference(x)
        velocity[1] = -0.25 * self.fluidity * p.gravity * (p.radius**2 - x[0]**2)
        return velocity, fluidity, level

    def observe(self, flow):
        """Return the mean shear stress of the wall, P_w, and the mean downward speed."""
        area = 2.0 * np.pi * self.parameters.radius * self.parameters.height
        return {"shear_stress": flow.reaction("right")[1] / area,
                "mean_speed": -flow.mean_velocity()[1]}
