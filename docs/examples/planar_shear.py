"""Planar shear between two rough plates, as a user-defined case.

    mpiexec -n 2 python -m pgran -options_file options/own_case.opts

The bottom plate does not move. The top plate moves along x1 with the speed V = gdot0 H and has the
pressure P_w. The flow is periodic along x1. Lengths are in d, stresses in P_w and times in 1/gdot0.
"""

import numpy as np

from pgran.cases import Case, pressure
from pgran.options import BOTH, positive


class PlanarShear(Case):
    """A layer of height H under a plate that shears and compresses it."""

    options = (
        positive("inertial_number", 0.01, "", "I0 = gdot0 d sqrt(rho_s/P_w)", shared=BOTH),
        positive("width", 4.0, "d", "length of the periodic layer", shared=BOTH),
        positive("height", 20.0, "d", "height H of the layer", shared=BOTH),
        positive("element_size", 1.0, "d", "side of an element", shared=("restart",)),
    )
    periodic = True, False
    moving = False
    stress_unit = "P_w"
    observables = {"shear_stress": "stress"}

    @property
    def shape(self):
        return self.elements_along("width"), self.elements_along("height")

    def coordinates(self, i, j):
        half = self.parameters.element_size / 2.0
        return np.array([half * i, half * j])

    def prescribed_velocity(self, time, i, j):
        values = np.full((2, i.size), np.nan)
        values[:, j == 0] = 0.0
        values[0, j == 2 * self.shape[1]] = self.parameters.height
        return values

    def tractions(self, time):
        return {"top": pressure(1.0)}

    def reference(self, x):
        _, fluidity, level = super().reference(x)
        return np.array([x[1], 0.0 * x[1]]), fluidity, level

    def observe(self, flow):
        """Return the mean shear stress on the top plate, P_w."""
        return {"shear_stress": flow.reaction("top")[0] / self.parameters.width}
