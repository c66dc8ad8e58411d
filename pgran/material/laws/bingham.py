"""The Bingham law mu_loc = mu_s + b I, equation (1.2)."""

from dataclasses import dataclass

import numpy as np

from . import MU_S, B, Law


@dataclass(frozen=True)
class Bingham(Law):
    """mu_loc = mu_s + b I, equation (1.2)."""

    mu_s: object
    b: float

    options = MU_S, B

    @property
    def yield_ratio(self):
        return self.mu_s

    def stress_ratio(self, I):
        return self.mu_s + self.b * I, self.b * np.ones_like(I)

    def inertial_number(self, mu):
        flowing = mu > self.mu_s
        return np.where(flowing, mu - self.mu_s, 0.0) / self.b, flowing / self.b

    def inverse_length_squared(self, mu):
        """Return A^2 d^2/xi^2 = |mu - mu_s| of (2.8a) and its derivative."""
        return np.abs(mu - self.mu_s), np.sign(mu - self.mu_s)

    def elastic_stress_ratio(self, gdot, s, compliance):
        return (gdot + s * self.mu_s / self.b) / (s / self.b + compliance)
