"""Plane-strain compression of a rectangular specimen (section 4, figure 3(a)).

The bottom has v2 = 0, and its left corner also v1 = 0. The top moves down at
v2 = D2 H exp(D2 t) and slides freely. The lateral faces carry the normal stress
sigma_1 = -1, which follows the deformed normal. The fluidity has no flux through
any face. The element to the upper right of the centre has a lower yield value. Options say how
large this weak square is, whether it lies to the left instead, and whether the plates hold the
specimen.
"""

from functools import cached_property

import numpy as np

from ..options import BOTH, Option, ParameterError, positive
from ..theory import specimen
from . import PureShear, pressure, reached

_RESTART = ("restart",)


class Biaxial(PureShear):
    """The specimen between two plates; the run is counted by compression."""

    options = (
        *PureShear.SIZE,
        positive("element_size", 2.0, "d", "side of an element; it divides width and height",
                 shared=_RESTART),
        Option("imperfection", "float", 0.99, "", "yield value of the weak square over mu_s; 1 "
               "leaves it out", low=0.0, open_low=True, high=1.0, shared=_RESTART),
        positive("imperfection_size", None, "d", "side of the weak square, whose lower left corner "
                 "is at the centre; one element unless given", shared=_RESTART),
        Option("imperfection_mirrored", "bool", False, "", "put the weak square to the left of the "
               "centre instead", shared=_RESTART),
        Option("plates_slip", "bool", True, "", "let the specimen slip along the plates; otherwise "
               "both plates carry it with the v1 of homogeneous flow", shared=BOTH),
        Option("compression", "float", 0.10, "", "where the run ends, 1 - h/H", "h = H exp(D2 t)",
               low=0.0, high=1.0, open_low=True, open_high=True, changeable=True),
        Option("snapshots", "floats", None, "", "compressions at which the fields are written, "
               "each reached exactly; those beyond the end are left out, and the end is always "
               "written", low=0.0, high=1.0, open_low=True, open_high=True, changeable=True),
    )
    observables = {"compression": "", "top_stress": "stress"}
    progress_name = "compression"

    @classmethod
    def resolve(cls, parameters, given):
        """Fill in the height and the end, and refuse options of a weak square that is left out."""
        super().resolve(parameters, given)
        parameters.snapshots = reached(parameters.snapshots, parameters.compression)
        for name in ("imperfection_size", "imperfection_mirrored"):
            if parameters.imperfection == 1.0 and name in given and getattr(parameters, name):
                raise ParameterError(name, getattr(parameters, name),
                                     "there is no weak square with @imperfection 1")

    @classmethod
    def homogeneous(cls, parameters):
        """Return the parameters without the weak square."""
        return parameters.replace(imperfection=1.0, imperfection_size=None,
                                  imperfection_mirrored=False)

    @property
    def specimen(self):
        """Law, shape, density and t0 of the specimen, if the plates let it slip."""
        p, material = self.parameters, self.material
        if not p.plates_slip or material.model.theory not in specimen.MODELS:
            return None
        return {"law": self.law, "model": material.model.theory,
                "inertial_number": p.inertial_number, "width": p.width, "height": p.height,
                "amplitude": p.A, "density": material.bulk_density if p.inertia else 0.0,
                "relaxation_time": material.model.storage.get("fluidity")}

    @cached_property
    def shape(self):
        """Return the number of elements along x1 and x2.

        Raises `ParameterError` where they do not make up the specimen and the weak square.
        """
        shape = self.elements_along("width"), self.elements_along("height")
        room = min(n - n // 2 for n in shape)
        if self.parameters.imperfection != 1.0 and self.weak_elements > room:
            raise ParameterError(
                "imperfection_size", self.parameters.imperfection_size, "the weak square begins at "
                "the centre and leaves the specimen; allowed is <= "
                f"{room * self.parameters.element_size:g}")
        return shape

    @cached_property
    def weak_elements(self):
        """Return the number of elements along a side of the weak square."""
        return (1 if self.parameters.imperfection_size is None
                else self.elements_along("imperfection_size"))

    def coordinates(self, i, j):
        """Return the initial coordinates (2, n) of nodes, d."""
        half = self.parameters.element_size / 2.0
        return np.array([i * half, j * half])

    def prescribed_velocity(self, time, i, j):
        """Return the velocities (2, n) of plates and pinned corner; not numbers where free."""
        values = np.full((2, i.size), np.nan)
        values[1, j == 0] = 0.0
        values[0, (i == 0) & (j == 0)] = 0.0
        if not self.parameters.plates_slip:
            ends = (j == 0) | (j == 2 * self.shape[1])
            x1 = self.coordinates(i, j)[0, ends]  # of the material, before it moved
            values[0, ends] = 0.5 * x1 * np.exp(0.5 * time)
        values[1, j == 2 * self.shape[1]] = -0.5 * self.parameters.height * np.exp(-0.5 * time)
        return values

    def nodes_outside(self, time, x, i, j):
        """Return which nodes besides those of the plates lie on or beyond a plate, (n,) bool."""
        top = self.parameters.height * (1.0 - self.progress(time))
        free = (j > 0) & (j < 2 * self.shape[1])
        return free & ((x[1] <= 0.0) | (x[1] >= top)), "a free face reaches a plate"

    def tractions(self, time):
        """Return the lateral stress on both faces."""
        return {"left": pressure(1.0), "right": pressure(1.0)}

    def start(self, x):
        """Return the reference flow without fluidity, with the lateral stress as pressure."""
        velocity, fluidity, pressure = self.reference(x)
        return velocity, np.zeros_like(fluidity), np.ones_like(pressure)

    def reference(self, x):
        """Return homogeneous compression, v = (x1/2, -x2/2), with g0 and P0."""
        _, fluidity, pressure = super().reference(x)
        return np.array([0.5 * x[0], -0.5 * x[1]]), fluidity, pressure

    def yield_factor(self, i, j):
        """Return mu_s of elements over its nominal value, (n,)."""
        nx, ny = self.shape
        if self.parameters.imperfection_mirrored:
            i = nx - 1 - i
        weak = ((nx // 2 <= i) & (i < nx // 2 + self.weak_elements)
                & (ny // 2 <= j) & (j < ny // 2 + self.weak_elements))
        return np.where(weak, self.parameters.imperfection, 1.0)

    def progress(self, time):
        """Return the compression 1 - h/H, h = H exp(D2 t)."""
        return 1.0 - np.exp(-0.5 * time)

    def time_of(self, count):
        """Return the time at which a compression is reached."""
        return -2.0 * np.log(1.0 - count)

    def label(self, time):
        """Return the compression in words."""
        return f"{100 * self.progress(time):.4g} % compression"

    def observe(self, flow):
        """Return the compression 1 - h/H, and the mean normal stress on the plate, |sigma_1|."""
        return {"compression": self.progress(flow.time),
                "top_stress": flow.reaction("top")[1] / flow.extent("top")[0]}
