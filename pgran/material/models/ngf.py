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
        """A^2 d^2."""
        return self.A**2

    def response(self, law, s, gdot, P, g, theta):
        """Return the `Response` with the elastic return and F of `source`.

        sigma' = 2 P/(g + theta P) D~ and mu = gdot~/(g + theta P).
        """
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
        """Return F of (2.5)-(2.8) at points, gdot0, as `WithDerivatives`.

        F = (A^2 d^2/xi^2) (g - g_loc) with g_loc = s I_loc(mu)/mu. The derivatives are partial ones
        with respect to mu (``rate``), P and g; the derivative with respect to P includes s.
        """
        stiffness, slope = law.inverse_length_squared(mu)
        excess = self.fluidity_excess(law, s, mu, P, g)
        return WithDerivatives(stiffness * excess.value,
                               rate=slope * excess.value + stiffness * excess.rate,
                               pressure=stiffness * excess.pressure,
                               fluidity=stiffness)

    def curvature(self, law, s, mu, P, g):
        """Return the second derivative of F with respect to mu, (points, n), gdot0.

        It is 2 (A^2 d^2/xi^2)' (g - g_loc)'; the other terms vanish at mu_s.
        """
        return 2.0 * law.inverse_length_squared(mu)[1] * self.fluidity_excess(law, s, mu, P, g).rate

    def spurious_root(self, law, mu, I):
        """Return mu_loc(I) - mu_s where F vanishes because mu = mu_s, and zero elsewhere.

        There A^2 d^2/xi^2 = 0 and F = 0 for any g, although (2.5) excludes mu = mu_s with g > 0
        unless lap g differs from zero nearby.
        """
        excess = law.stress_ratio(I)[0] - law.yield_ratio
        return np.where(np.abs(mu - law.yield_ratio) < AT_YIELD * excess, excess, 0.0)

    def fluidity_excess(self, law, s, mu, P, g):
        """Return g - g_loc and its derivatives, as `source`."""
        I_loc, slope = law.inertial_number(mu)
        # I_loc is zero below the yield ratio, so the result is the same.
        positive = np.maximum(mu, law.yield_ratio)
        ratio = I_loc / positive
        return WithDerivatives(g - s * ratio, rate=-s * (slope - ratio) / positive,
                               pressure=-ratio * s / (2.0 * P), fluidity=np.ones_like(mu))
