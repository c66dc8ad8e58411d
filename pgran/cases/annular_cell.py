"""Shear in an annular cell with gravity.

    mpiexec -n 2 python -m pgran -options_file options/annular_cell.opts

Material between two coaxial cylinders, R_i <= r <= R_o and 0 <= z <= H, with the velocities v_r,
v_z and v_t. The inner wall turns at gdot0, and the outer wall is at rest. Both hold v_r = 0 and let
the material slide along z. The floor is smooth (v_z = 0, without shear stress) or rough (at rest),
and a pressure acts on the top. The unit of stress is phi rho_s G d, so that the weight is 1 per
length d.

With inertia the top is held, v_z = 0, and the pressure is prescribed at its outer end. A real
surface would rise by r w^2/G per radius.
"""

import numpy as np

from ..kinematics import SWIRL
from ..options import BOTH, Option, ParameterError, positive
from . import ROUNDING, _fixed, pressure


def cell_options(inertial_number, inner, outer, height, top):
    """Return the options of a cell with these defaults."""
    return (
        positive("inertial_number", inertial_number, "", "I0 = gdot0 d sqrt(rho_s/P_ref), with the "
                 "angular velocity gdot0 of the driven part and P_ref = phi rho_s G d", "(1.1)",
                 shared=BOTH),
        Option("inner_radius", "float", inner, "d", "radius R_i of the inner wall; 0: the axis",
               low=0.0, shared=BOTH),
        _fixed.size("outer_radius", outer, "radius R_o of the outer wall"),
        _fixed.size("height", height, "depth H of the material"),
        Option("top_pressure", "float", top, "phi rho_s G d", "pressure on the top", low=0.0,
               shared=("restart",)),
        *_fixed.options())


#: mu over mu_s at the start of a steady flow.
START = 0.9


class AnnularCell(_fixed.FixedMesh):
    """A cell between a turning and a fixed cylinder."""

    options = (*cell_options(1e-3 / 60.0, 60.0, 80.0, 15.0, 0.1),
               Option("floor", "str", "smooth", "", "floor without shear stress, or at rest",
                      choices=("smooth", "rough"), shared=("restart",)))
    kinematics = SWIRL
    stress_unit = "phi rho_s G d"
    weight = 0.0, -1.0
    walls = "left", "right"
    observables = {"torque": "stress d^3"}

    def __init__(self, parameters):
        super().__init__(parameters)
        p = parameters
        self.gap = p.outer_radius - p.inner_radius
        if not self.gap > 0.0:
            raise ParameterError("outer_radius", f"{p.outer_radius:g}",
                                 f"must exceed @inner_radius {p.inner_radius:g}")
        self._across = round(self.gap / p.element_size)
        if self._across < 1 or abs(self._across * p.element_size - self.gap) > (
                ROUNDING * p.outer_radius):
            raise ParameterError("element_size", f"{p.element_size:g}", "must divide the gap of "
                                 f"{self.gap:g} between the walls")

    @property
    def shape(self):
        return self._across, self.elements_along("height")

    @property
    def free_surfaces(self):
        return () if self.parameters.top_pressure else ("top",)

    def coordinates(self, i, j):
        p = self.parameters
        return np.array([p.inner_radius + self.graded(i, self._across, self.gap),
                         0.5 * j * p.element_size])

    def prescribed_velocity(self, time, i, j):
        values, r = super().prescribed_velocity(time, i, j), self.coordinates(i, j)[0]
        values[1, self.on("bottom", i, j)] = 0.0
        if self.parameters.inertia:
            values[1, self.on("top", i, j)] = 0.0
        self.hold_floor(values, r, self.on("bottom", i, j))
        inner, outer = self.on("left", i, j), self.on("right", i, j)
        values[0, inner | outer] = 0.0
        values[2, inner], values[2, outer] = r[inner], 0.0
        return values

    def hold_floor(self, values, r, floor):
        """Prescribe the velocity on the floor, the nodes ``floor`` (n,) bool at radii ``r``."""
        if self.parameters.floor == "rough":
            values[:, floor] = 0.0

    def prescribed_pressure(self, time, i, j):
        values = super().prescribed_pressure(time, i, j)
        if self.parameters.inertia:
            corner = (i == self.shape[0]) & (j == self.shape[1])
            values[corner] = self.parameters.top_pressure
        return values

    def tractions(self, time):
        top = self.parameters.top_pressure
        return {"top": pressure(top)} if top and not self.parameters.inertia else {}

    def reference(self, x):
        """Return `turning` with the hydrostatic pressure, and the fluidity where mu = 0.9 mu_s.

        From this fluidity Newton's method converges to the steady flow.
        """
        velocity = super().reference(x)[0]
        angular, rate = self.turning(*x)
        velocity[2] = x[0] * angular
        ratio = START * (self.law.yield_ratio or self.stress_ratio)
        return velocity, rate / ratio, self.hydrostatic(x[1])

    def hydrostatic(self, z):
        """Return the pressure at heights ``z``."""
        return self.parameters.top_pressure + self.parameters.height - z

    def turning(self, r, z):
        """Return angular velocity and shear rate of a Newtonian fluid between the walls, gdot0."""
        inner, outer = self.parameters.inner_radius, self.parameters.outer_radius
        scale = (outer / inner)**2 - 1.0
        return ((outer / r)**2 - 1.0) / scale, 2.0 * (outer / r)**2 / scale

    def observe(self, flow):
        """Return the torque of the inner wall on the material, stress d^3."""
        return {"torque": flow.torque("left")}
