"""Constitutive response at a point: laws, models and elasticity; numpy and scipy only."""

from dataclasses import dataclass

import numpy as np

from ..options import Component
from .laws import Law
from .models import Model

LAWS = Component("law", "pgran.material.laws", Law)
MODELS = Component("model", "pgran.material.models", Model)


@dataclass(frozen=True)
class Material:
    """The rheology of a flow in the units of its case.

    ``inertial_time`` is sqrt(d^2 rho_s) in sqrt(stress)/gdot0. ``pressure`` and ``stress_ratio``
    (mu_loc) belong to the reference flow. ``G`` is the elastic shear modulus, stress.
    """

    law: object
    model: object
    inertial_time: float
    pressure: float
    stress_ratio: float
    phi: float
    G: float

    @property
    def yield_stress(self):
        """mu_s P0, stress; mu_loc of the reference flow replaces mu_s without yield value."""
        return (self.law.yield_ratio or self.stress_ratio) * self.pressure

    @property
    def loading_time(self):
        """mu_s P0/G, the time of elastic loading from rest to yield, 1/gdot0."""
        return self.yield_stress / self.G

    def elastic_compliance(self, dt):
        """Return theta = 1/(G dt), gdot0/stress; 0 (rigid) for dt = 0."""
        return 1.0 / (self.G * dt) if dt > 0.0 else 0.0

    def inverse_time(self, P):
        """Return s = sqrt(P/(d^2 rho_s)), gdot0, at pressures ``P``."""
        return np.sqrt(P) / self.inertial_time

    @property
    def bulk_density(self):
        """Bulk density phi rho_s, stress/(d gdot0)^2."""
        return self.phi * self.inertial_time**2
