"""The law of Jop, Forterre & Pouliquen, equation (1.3)."""

from dataclasses import dataclass

import numpy as np

from . import I_0, MU_2, MU_S, B, Law, resolve_jop


@dataclass(frozen=True)
class Jop(Law):
    """mu_loc = mu_s + (mu_2 - mu_s)/(I_0/I + 1), I_0 = (mu_2 - mu_s)/b, equation (1.3).

    I_loc is NaN at mu >= mu_2, and the solver then reduces the step.
    """

    mu_s: object
    mu_2: object
    b: object

    options = MU_S, MU_2, B, I_0
    resolve = classmethod(resolve_jop)

    @classmethod
    def of(cls, parameters):
        p = parameters
        return cls(p.mu_s, p.mu_2, (p.mu_2 - p.mu_s) / p.I_0 if p.I_0 else p.b)

    @property
    def yield_ratio(self):
        return self.mu_s

    @property
    def I_0(self):
        return (self.mu_2 - self.mu_s) / self.b

    def stress_ratio(self, I):
        fraction = I / (self.I_0 + I)
        rise = self.mu_2 - self.mu_s
        return self.mu_s + rise * fraction, rise * self.I_0 / (self.I_0 + I)**2

    def inertial_number(self, mu):
        flowing = mu > self.mu_s
        gap = np.where(mu < self.mu_2, self.mu_2 - mu, np.nan)
        value = self.I_0 * (mu - self.mu_s) / gap
        slope = self.I_0 * (self.mu_2 - self.mu_s) / gap**2
        return np.where(flowing, value, 0.0), np.where(flowing, slope, 0.0)

    def inverse_length_squared(self, mu):
        """Return A^2 d^2/xi^2 = (mu_2 - mu_s) |mu - mu_s|/(mu_2 - mu) (2.8b), its derivative."""
        rise = self.mu_2 - self.mu_s
        gap = np.where(mu < self.mu_2, self.mu_2 - mu, np.nan)
        excess = np.abs(mu - self.mu_s)
        return rise * excess / gap, rise * (np.sign(mu - self.mu_s) * gap + excess) / gap**2

    def elastic_stress_ratio(self, gdot, s, compliance):
        inertial = s * self.I_0
        linear = inertial + compliance * self.mu_2 + gdot
        constant = inertial * self.mu_s + gdot * self.mu_2
        return 2.0 * constant / (linear + np.sqrt(linear**2 - 4.0 * compliance * constant))
