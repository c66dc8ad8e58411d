"""The non-local granular fluidity model (NGF), equations (2.3)-(2.8)."""

from dataclasses import dataclass

import numpy as np

from . import AMPLITUDE, Model, Quantity, Response


@dataclass(frozen=True)
class NGF(Model):
    """Steady non-local granular fluidity; ``A`` is the non-local amplitude."""

    A: float

    rows = (AMPLITUDE,)
    fields = "velocity", "fluidity", "pressure"
    theory = "ngf"
    needs_length = True

    @property
    def diffusion(self):
        """A^2 d^2."""
        return self.A**2

    def response(self, law, s, gdot, P, g, theta):
        """Return the `Response` with the elastic return.

        ::

            sigma' = 2 P/(g + theta P) D~,    mu = gdot~/(g + theta P)
            F = (A^2 d^2/xi^2) (g - g_loc),   g_loc = s I_loc(mu)/mu             (2.5)-(2.8)
        """
        total = 1.0 / (g + theta * P)
        mu = gdot * total
        I_loc, I_slope = law.inertial_number(mu)
        stiffness, stiffness_slope = law.inverse_length_squared(mu)
        # I_loc is zero below the yield ratio, so this changes no value.
        positive = np.maximum(mu, law.yield_ratio)
        ratio = I_loc / positive
        ratio_slope = (I_slope - ratio) / positive
        lag = g - s * ratio
        source_mu = stiffness_slope * lag - stiffness * s * ratio_slope
        return Response(
            viscosity=Quantity(P * total, pressure=g * total**2, fluidity=-P * total**2),
            stress_ratio=mu,
            inertial_number=g * mu / s,
            fluidity=g,
            source=Quantity(
                stiffness * lag,
                rate=source_mu * total,
                pressure=(-source_mu * theta * mu * total
                          - stiffness * ratio * s / (2.0 * P)),
                fluidity=stiffness - source_mu * mu * total))
