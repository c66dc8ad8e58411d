"""Flow between two vertical walls under gravity.

    mpiexec -n 2 python -m pgran -options_file options/vertical_chute.opts

The walls x1 = 0 and x1 = W prevent motion along x2. The left wall is fixed, and the pressure of the
right wall is P_w. The chute is periodic along x2, and the weight of the material,
`-pgran_gravity` P_w/d, points along -x2. The unit of time is d sqrt(rho_s/P_w).
"""

import numpy as np

from ..theory import profiles
from . import _fixed


class VerticalChute(_fixed.Falling, _fixed.Unidirectional):
    """Material that falls between two walls."""

    options = (
        _fixed.GRAINS_RATE,
        _fixed.size("width", 20.0, "distance W between the walls"),
        _fixed.size("height", 4.0, "length of the periodic chute"),
        _fixed.gravity(0.05, "weight of the material, phi rho_s G d/P_w; the stress ratio at the "
                       "walls is mu = gravity W/2"),
        *_fixed.options())
    span, symbol, periodic = "width", "W", (False, True)
    walls = "left", "right"

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        values[:, self.on("left", i, j)] = 0.0
        values[1, self.on("right", i, j)] = 0.0
        return values

    def reference(self, x):
        p = self.parameters
        _, fluidity, level = super().reference(x)
        speed = 0.5 * self.fluidity * p.gravity * x[0] * (p.width - x[0])
        return np.array([0.0 * speed, -speed]), fluidity, level

    def profile(self):
        p = self.parameters
        return profiles.vertical_chute(*self.rheology, p.width, p.gravity, p.wall_fluidity)

    def along(self, x):
        one, zero = np.ones_like(x[0]), np.zeros_like(x[0])
        return x[0], np.array([zero, -one]), np.array([one, zero])

    def observe(self, flow):
        """Return the mean shear stress of the walls, P_w, and the mean downward speed."""
        up = sum(flow.reaction(side)[1] for side in self.walls) / (2.0 * self.parameters.height)
        return {"shear_stress": up, "mean_speed": -flow.mean_velocity()[1]}
