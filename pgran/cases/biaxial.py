"""Plane-strain compression of a rectangular specimen (section 4, figure 3(a)).

The bottom has v2 = 0, and its left corner also v1 = 0. The top moves down at v2 = D2 H exp(D2 t)
and slides freely. The lateral faces carry the normal stress sigma_1 = -1, which follows the
deformed normal. The fluidity has no flux through any face. The imperfection, a square with a lower
yield value, is the element to the upper right of the centre.
"""

from functools import cached_property

import numpy as np

from ..options import BOTH, Option, ParameterError, positive
from ..theory import specimen
from . import PureShear, pressure, reached


class Biaxial(PureShear):
    """The specimen between two plates; the progress of a run is the compression."""

    options = (
        *PureShear.SIZE,
        positive("element_size", 2.0, "d", "side of an element; must divide width and height",
                 shared=("restart",)),
        Option("imperfection", "float", 0.99, "", "yield value of the imperfection over mu_s; "
               "1: no imperfection", low=0.0, open_low=True, high=1.0, shared=("restart",)),
        positive("imperfection_size", None, "d", "side of the imperfection, a square whose lower "
                 "left corner is at the centre; default: one element", shared=("restart",)),
        Option("imperfection_mirrored", "bool", False, "", "place the imperfection to the left of "
               "the centre", shared=("restart",)),
        Option("plates_slip", "bool", True, "", "the specimen slips along the plates; otherwise "
               "both plates prescribe the v1 of homogeneous flow", shared=BOTH),
        Option("compression", "float", 0.10, "", "end of the run, 1 - h/H", "h = H exp(D2 t)",
               low=0.0, high=1.0, open_low=True, open_high=True, changeable=True),
        Option("snapshots", "floats", None, "", "exact compressions at which fields are written; "
               "those after the end are ignored, and the end is always written", low=0.0,
               high=1.0, open_low=True, open_high=True, changeable=True),
    )
    observables = {"compression": "", "top_stress": "stress"}
    progress_name = "compression"

    @classmethod
    def resolve(cls, parameters, names):
        super().resolve(parameters, names)
        parameters.snapshots = reached(parameters.snapshots, parameters.compression)
        for name in ("imperfection_size", "imperfection_mirrored"):
            if parameters.imperfection == 1.0 and name in names and getattr(parameters, name):
                raise ParameterError(name, getattr(parameters, name),
                                     "there is no imperfection with @imperfection 1")

    @classmethod
    def homogeneous(cls, parameters):
        return parameters.replace(imperfection=1.0, imperfection_size=None,
                                  imperfection_mirrored=False)

    @property
    def specimen(self):
        p, material = self.parameters, self.material
        if not p.plates_slip or material.model.theory not in specimen.MODELS:
            return None
        return {"law": self.law, "model": material.model.theory,
                "inertial_number": p.inertial_number, "width": p.width, "height": p.height,
                "amplitude": p.A, "density": material.bulk_density if p.inertia else 0.0,
                "relaxation_time": material.model.storage.get("fluidity")}

    @cached_property
    def shape(self):
        shape = self.elements_along("width"), self.elements_along("height")
        maximum = min(n - n // 2 for n in shape)
        if self.parameters.imperfection != 1.0 and self.weak_elements > maximum:
            raise ParameterError(
                "imperfection_size", self.parameters.imperfection_size, "the imperfection exceeds "
                f"the specimen; must be a number <= {maximum * self.parameters.element_size:g}")
        return shape

    @cached_property
    def weak_elements(self):
        size = self.parameters.imperfection_size
        return self.elements_along("imperfection_size") if size else 1

    def coordinates(self, i, j):
        return np.array([i, j]) * (self.parameters.element_size / 2.0)

    def prescribed_velocity(self, time, i, j):
        values = super().prescribed_velocity(time, i, j)
        bottom, top = j == 0, j == 2 * self.shape[1]
        values[1, bottom] = 0.0
        values[1, top] = -0.5 * self.parameters.height * np.exp(-0.5 * time)
        values[0, (i == 0) & bottom] = 0.0
        if not self.parameters.plates_slip:
            x1, _ = self.coordinates(i, j)  # initial coordinates of the material
            values[0] = np.where(bottom | top, 0.5 * x1 * np.exp(0.5 * time), np.nan)
        return values

    def nodes_outside(self, time, x, i, j):
        top = self.parameters.height * (1.0 - self.progress(time))
        free = (j > 0) & (j < 2 * self.shape[1])
        return free & ((x[1] <= 0.0) | (x[1] >= top)), "a free face reaches a plate"

    def tractions(self, time):
        return {"left": pressure(1.0), "right": pressure(1.0)}

    def start(self, x):
        velocity, fluidity, _ = super().start(x)
        return velocity, fluidity, np.ones_like(fluidity)  # the lateral stress

    def reference(self, x):
        _, fluidity, pressure = super().reference(x)
        return np.array([0.5 * x[0], -0.5 * x[1]]), fluidity, pressure

    def yield_factor(self, i, j):
        nx, ny = self.shape
        if self.parameters.imperfection_mirrored:
            i = nx - 1 - i
        weak = ((nx // 2 <= i) & (i < nx // 2 + self.weak_elements)
                & (ny // 2 <= j) & (j < ny // 2 + self.weak_elements))
        return np.where(weak, self.parameters.imperfection, 1.0)

    def progress(self, time):
        return 1.0 - np.exp(-0.5 * time)

    def time_of(self, progress):
        return -2.0 * np.log(1.0 - progress)

    def label(self, time):
        return f"{100 * self.progress(time):.4g} % compression"

    def observe(self, flow):
        """Return the compression 1 - h/H, and the mean normal stress on the plate, |sigma_1|."""
        return {"compression": self.progress(flow.time),
                "top_stress": flow.reaction("top")[1] / flow.extent("top")[0]}
