"""The local inertial rheology (LI), equation (1.1): g = g_loc at every point."""

from dataclasses import dataclass

import numpy as np

from . import AMPLITUDE, Model, Response, WithDerivatives


@dataclass(frozen=True)
class LI(Model):
    """The local inertial rheology; ``A`` is only the unit of wave vectors."""

    A: float

    options = (AMPLITUDE,)
    theory = "li"

    @property
    def length(self):
        return self.A

    def response(self, law, s, gdot, P, g, theta):
        """Return the `Response` with sigma' = 2 (mu P/gdot~) D~.

        Above yield s I_loc(mu) + theta P mu = gdot~, and below it mu = gdot~/(theta P).
        """
        compliance = theta * P
        flowing = gdot > compliance * law.yield_ratio
        mu = np.where(flowing, law.elastic_stress_ratio(gdot, s, compliance), 0.0)
        I, slope = law.inertial_number(mu)
        safe = np.where(flowing, gdot, 1.0)
        total = 1.0 / (s * np.where(flowing, slope, 1.0) + compliance)
        mu_pressure = -(s / (2.0 * P) * I + theta * mu) * total
        elastic = 1.0 / theta if theta > 0.0 else np.inf
        return Response(
            viscosity=WithDerivatives(
                np.where(flowing, mu * P / safe, elastic),
                rate=np.where(flowing, P * (total - mu / safe) / safe, 0.0),
                pressure=np.where(flowing, (mu + P * mu_pressure) / safe, 0.0)),
            stress_ratio=np.where(flowing, mu, gdot * elastic / P),
            inertial_number=I,
            fluidity=np.where(flowing, s * I / np.where(flowing, mu, 1.0), 0.0))
