"""A user-defined law: the stress ratio increases with a power of the inertial number.

    python -m pgran.stability -posedness -pgran_law docs/examples/power_law.py:PowerLaw
    mpiexec -n 2 python -m pgran -options_file options/power_law.opts

The law has no cooperativity length, so it is for LI.
"""

from dataclasses import dataclass

import numpy as np

from pgran.material.laws import Law
from pgran.options import BOTH, positive


@dataclass(frozen=True)
class PowerLaw(Law):
    """mu_loc = mu_s + c I^n."""

    mu_s: object
    c: float
    n: float

    options = (positive("mu_s", 0.26, "", "static yield value of the stress ratio", shared=BOTH),
               positive("c", 0.8, "", "mu_loc - mu_s at I = 1", shared=BOTH),
               positive("n", 0.5, "", "power of the inertial number", shared=BOTH))

    @property
    def yield_ratio(self):
        return self.mu_s

    def stress_ratio(self, I):
        rise = self.c * I**self.n
        return self.mu_s + rise, self.n * rise / np.where(I > 0.0, I, np.nan)

    def inertial_number(self, mu):
        excess = np.where(mu > self.mu_s, mu - self.mu_s, 0.0) / self.c
        I = excess**(1.0 / self.n)
        return I, I / (self.n * self.c * np.where(excess > 0.0, excess, np.inf))
