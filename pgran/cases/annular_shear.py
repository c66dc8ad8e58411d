"""Shear in a ring between two cylinders.

    mpiexec -n 2 python -m pgran -options_file options/annular_shear.opts

The inner wall turns counterclockwise at gdot0, with the speed gdot0 R_i. The outer wall does not
move, and its pressure is P_w. The grid is periodic around the ring: the index i counts clockwise,
and j outward. The pressure is prescribed at one corner of the outer wall, because the equations
determine it in a closed ring except for a constant.
"""

import numpy as np

from ..options import BOTH, ParameterError, positive
from ..theory import profiles
from . import ROUNDING, _fixed


class AnnularShear(_fixed.Unidirectional):
    """A ring between a rotating and a fixed cylinder."""

    options = (
        positive("inertial_number", 0.01, "", "I0 = gdot0 d sqrt(rho_s/P_w), with the angular "
                 "velocity gdot0 of the inner wall", "(1.1)", shared=BOTH),
        _fixed.size("inner_radius", 10.0, "radius R_i of the inner wall"),
        _fixed.size("outer_radius", 20.0, "radius R_o of the outer wall"),
        *_fixed.options(element_size=1.0))
    periodic = True, False
    stress_unit = "P_w"
    walls = "bottom", "top"
    observables = {"torque": "stress d^2"}

    def __init__(self, parameters):
        super().__init__(parameters)
        inner, outer = parameters.inner_radius, parameters.outer_radius
        if not outer > inner:
            raise ParameterError("outer_radius", f"{outer:g}",
                                 f"must exceed @inner_radius {inner:g}")
        side = parameters.element_size
        self._across = round((outer - inner) / side)
        if self._across < 1 or abs(self._across * side - (outer - inner)) > ROUNDING * outer:
            raise ParameterError("element_size", f"{side:g}", "must divide the gap of "
                                 f"{outer - inner:g} between the walls")
        # Multigrid requires a multiple of 8.
        self._around = 8 * max(1, round(2.0 * np.pi * inner / (8 * side)))

    @property
    def shape(self):
        return self._around, self._across

    def coordinates(self, i, j):
        p = self.parameters
        r = p.inner_radius + self.graded(j, self._across, p.outer_radius - p.inner_radius)
        angle = -np.pi * (i % (2 * self._around)) / self._around
        return r * np.array([np.cos(angle), np.sin(angle)])

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        inner = self.on("bottom", i, j)
        x = self.coordinates(i, j)
        values[:, inner] = np.array([-x[1], x[0]])[:, inner]
        values[:, self.on("top", i, j)] = 0.0
        return values

    def prescribed_pressure(self, time, i, j):
        nx, ny = self.shape
        return np.where((i % nx == 0) & (j == ny), 1.0, np.nan)

    def reference(self, x):
        """Return the flow of a Newtonian fluid between the walls, with uniform g and P_w."""
        p = self.parameters
        _, fluidity, level = super().reference(x)
        ratio = (p.outer_radius / p.inner_radius)**2
        angular = (p.outer_radius**2 / (x**2).sum(axis=0) - 1.0) / (ratio - 1.0)
        rate = 2.0 * ratio / (ratio - 1.0)  # at the inner wall
        return np.array([-x[1], x[0]]) * angular, rate * fluidity, level

    def profile(self):
        p = self.parameters
        return profiles.annular_shear(*self.rheology, p.inner_radius, p.outer_radius,
                                      p.wall_fluidity,
                                      self.material.bulk_density if p.inertia else 0.0)

    def along(self, x):
        r = np.hypot(*x)
        return r, np.array([-x[1], x[0]]) / r, x / r

    def observe(self, flow):
        """Return the torque of the inner wall on the material, P_w d^2 per unit depth."""
        return {"torque": flow.torque("bottom")}
