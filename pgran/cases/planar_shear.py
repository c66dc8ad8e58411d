"""Shear between two plates, with or without gravity.

    mpiexec -n 2 python -m pgran -options_file options/planar_shear.opts

The layer 0 <= x2 <= H is periodic along x1. The bottom plate does not move. The top plate moves
along x1 with the speed V = gdot0 H and the pressure P_w. Stresses are in P_w, and the weight of the
material is `-pgran_gravity` P_w/d.
"""

import numpy as np

from ..options import BOTH, positive
from ..theory import profiles
from . import _fixed, pressure


class PlanarShear(_fixed.Layer):
    """A layer under a plate that shears and compresses it."""

    options = (
        positive("inertial_number", 0.01, "", "I0 = gdot0 d sqrt(rho_s/P_w), with gdot0 = V/H",
                 "(1.1)", shared=BOTH),
        _fixed.size("width", 4.0, "length of the periodic layer"),
        _fixed.size("height", 20.0, "height H of the layer"),
        _fixed.gravity(0.0, "weight of the material, phi rho_s G d/P_w"),
        *_fixed.options())
    stress_unit = "P_w"
    walls = "bottom", "top"
    observables = {"shear_stress": "stress"}

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        values[0, self.on("top", i, j)] = self.parameters.height
        return values

    def tractions(self, time):
        return {"top": pressure(1.0)}

    def reference(self, x):
        p = self.parameters
        P = 1.0 + p.gravity * (p.height - x[1])
        speed, rate = x[1], 1.0
        if p.gravity:
            total = np.log1p(p.gravity * p.height)
            speed = p.height * (1.0 - np.log(P) / total)
            rate = p.height * p.gravity / total
        fluidity = np.full(x.shape[1], rate / self.stress_ratio)
        return np.array([speed, 0.0 * speed]), fluidity, P

    def profile(self):
        p = self.parameters
        return profiles.planar_shear(*self.rheology, p.height, p.gravity, p.wall_fluidity)

    def observe(self, flow):
        """Return the mean shear stress on the top plate, P_w."""
        return {"shear_stress": flow.reaction("top")[0] / self.parameters.width}
