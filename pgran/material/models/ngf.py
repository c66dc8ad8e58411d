"""The non-local granular fluidity model (NGF), equations (2.3)-(2.8)."""

from dataclasses import dataclass

import numpy as np

from . import AMPLITUDE, Model, Response, WithDerivatives

#: Largest |mu - mu_s|/(mu_loc(I) - mu_s) at a spurious root, where converged solutions have 1e-6.
#: Elements that contain mu = mu_s have more than 0.01 unless they are much smaller than d.
AT_YIELD = 0.01


@dataclass(frozen=True)
class NGF(Model):
    """Steady non-local granular fluidity; ``A`` is the non-local amplitude."""

    A: float

    options = (AMPLITUDE,)
    fields = "velocity", "fluidity", "pressure"
    theory = "ngf"
    needs_length = True

    @property
    def diffusion(self):
        return self.A**2

    def response(self, law, s, gdot, P, g, theta):
        """Return the `Response` with sigma' = 2 P/(g + theta P) D~ and mu = gdot~/(g + theta P)."""
        total = 1.0 / (g + theta * P)
        mu = gdot * total
        source = self.source(law, s, mu, P, g)
        return Response(
            viscosity=WithDerivatives(P * total, pressure=g * total**2, fluidity=-P * total**2),
            stress_ratio=mu,
            inertial_number=g * mu / s,
            fluidity=g,
            # d mu/dP = -theta mu total and d mu/dg = -mu total
            source=WithDerivatives(
                source.value,
                rate=source.rate * total,
                pressure=source.pressure - source.rate * theta * mu * total,
                fluidity=source.fluidity - source.rate * mu * total))

    def source(self, law, s, mu, P, g):
        """Return F = (A^2 d^2/xi^2) (g - g_loc) of (2.5)-(2.8) at points, as `fluidity_excess`."""
        stiffness, slope = law.inverse_length_squared(mu)
        excess = self.fluidity_excess(law, s, mu, P, g)
        return WithDerivatives(stiffness * excess.value,
                               rate=slope * excess.value + stiffness * excess.rate,
                               pressure=stiffness * excess.pressure,
                               fluidity=stiffness)

    def curvature(self, law, s, mu, P, g):
        # The other terms vanish at mu_s.
        return 2.0 * law.inverse_length_squared(mu)[1] * self.fluidity_excess(law, s, mu, P, g).rate

    def spurious_root(self, law, mu, I):
        # At mu = mu_s F = 0 for any g, although (2.5) excludes g > 0 there without lap g.
        excess = law.stress_ratio(I)[0] - law.yield_ratio
        return np.where(np.abs(mu - law.yield_ratio) < AT_YIELD * excess, excess, 0.0)

    def fluidity_excess(self, law, s, mu, P, g):
        """Return g - g_loc with g_loc = s I_loc(mu)/mu; the derivative by P includes s."""
        I_loc, slope = law.inertial_number(mu)
        # I_loc is zero below the yield ratio, so the result is the same.
        positive = np.maximum(mu, law.yield_ratio)
        ratio = I_loc / positive
        return WithDerivatives(g - s * ratio, rate=-s * (slope - ratio) / positive,
                               pressure=-ratio * s / (2.0 * P), fluidity=np.ones_like(mu))
