"""The primitive form of NGF: its fluidity takes time, and vanishes where the material rests."""

from dataclasses import dataclass

import numpy as np

from ...options import BOTH, Option, ParameterError, positive
from . import WithDerivatives
from .ngf import NGF

#: Inertial numbers at which a law is checked, and by how much it may differ, relatively.
CHECKED, ROUNDING = np.array([1e-3, 1e-2, 1e-1]), 1e-6


@dataclass(frozen=True)
class NGFPrimitive(NGF):
    """Non-local granular fluidity in its primitive, dynamic form.

    ::

        t0 dg/dt = A^2 d^2 lap g - F
        F = K g + b sqrt(d^2 rho_s/P) mu g^2,    K = (A^2 d^2/xi^2) sign(mu_s - mu)

    Here b is the slope of mu_loc at I = 0. The stress is that of `NGF`. K and F are smooth in mu
    at mu_s, and g = 0 is a solution at every mu. Above mu_s, F = (b mu g/s) (g - g_loc). The
    uniform steady state is therefore g_loc of `NGF`, and about it both forms have the same
    linearised F. This holds if A^2 d^2/xi^2 = b I_loc above mu_s, which `resolve` checks.

    g never becomes negative, but its approximation may, by an undershoot or by what Newton's method
    leaves, where the material rests. Above mu_s this F would then drive g to minus infinity. For
    g < 0 it is therefore F = (A^2 d^2/xi^2) g - b sqrt(d^2 rho_s/P) mu g^2, which returns g to 0
    and has a kink there above mu_s.

    Attributes
    ----------
    relaxation_time : float
        t0, 1/gdot0.
    start_fluidity : float
        As `Model` has it.
    """

    relaxation_time: float
    start_fluidity: float = 1.0

    options = (*NGF.options,
            positive("relaxation_time", None, "1/gdot0", "time t0 in which the fluidity relaxes; "
                     "the inertial time of the grains at the reference pressure, which is the "
                     "inertial number in these units, unless given", "t0 dg/dt", shared=BOTH),
            Option("start_fluidity", "float", 1.0, "", "fluidity from which a run in time starts, "
                   "over that of the reference flow; without any the material rests for ever",
                   low=0.0))
    theory = "ngf_primitive"

    @classmethod
    def resolve(cls, parameters, given):
        """Fill in t0, and refuse a law whose cooperativity length is not that of (2.8).

        Raises `pgran.options.ParameterError`.
        """
        if parameters.relaxation_time is None:
            parameters.relaxation_time = parameters.inertial_number
        law = parameters.part("law").of(parameters)
        if law.inverse_length_squared is None:
            return  # whoever uses the length refuses the law
        stiffness, _ = law.inverse_length_squared(law.stress_ratio(CHECKED)[0])
        if not np.allclose(stiffness, _slope_at_rest(law, CHECKED) * CHECKED, rtol=ROUNDING):
            raise ParameterError("model", parameters.model, f"@law {parameters.law} has another "
                                 "A^2 d^2/xi^2 than b I_loc, so that its uniform flow would not "
                                 "have the fluidity g_loc; allowed is ngf")

    @property
    def storage(self):
        """t0 of the fluidity."""
        return {"fluidity": self.relaxation_time}

    def curvature(self, law, s, mu, P, g):
        """Return zero: this F has no double root."""
        return 0.0

    def spurious_root(self, law, mu, I):
        """Return zeros: at mu_s this F is positive."""
        return np.zeros_like(mu)

    def source(self, law, s, mu, P, g):
        """Return F and its derivatives at points, as `NGF.source`."""
        # The inverse length has a kink at mu_s and no slope there; K takes the one from above.
        beside = np.where(mu == law.yield_ratio, np.nextafter(law.yield_ratio, np.inf), mu)
        sign = np.where(g < 0.0, 1.0, np.sign(law.yield_ratio - beside))
        K, K_slope = (sign * part for part in law.inverse_length_squared(beside))
        drag = _slope_at_rest(law, mu) * np.abs(g) / s
        return WithDerivatives(g * (K + drag * mu),
                        rate=g * (K_slope + drag),
                        pressure=-g * drag * mu / (2.0 * P),
                        fluidity=K + 2.0 * drag * mu)


def _slope_at_rest(law, like):
    """Return b, the slope of mu_loc at I = 0, with the shape of ``like``."""
    return law.stress_ratio(np.zeros_like(like))[1]
