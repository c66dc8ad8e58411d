"""Dynamic NGF, whose fluidity relaxes in time."""

from dataclasses import dataclass

import numpy as np

from ...options import BOTH, Option, ParameterError, positive
from . import Model, WithDerivatives
from .ngf import NGF


@dataclass(frozen=True)
class NGFPrimitive(NGF):
    """Dynamic non-local granular fluidity ("primitive" in the paper).

    ::

        t0 dg/dt = A^2 d^2 lap g - F
        F = K g + b sqrt(d^2 rho_s/P) mu g^2,    K = (A^2 d^2/xi^2) sign(mu_s - mu)

    Here b is the slope of mu_loc at I = 0. K and F are smooth in mu at mu_s, and g = 0 is a
    solution for every mu. Above mu_s, F = (b mu g/s) (g - g_loc), so the uniform steady state is
    g_loc of `NGF`, where both forms have the same linearised F. This requires A^2 d^2/xi^2 =
    b I_loc above mu_s, which `resolve` checks.

    Where the material is static, the discrete g may be slightly negative, and this F would drive it
    to minus infinity above mu_s. For g < 0, F = (A^2 d^2/xi^2) g - b sqrt(d^2 rho_s/P) mu g^2
    therefore returns g to 0.

    ``relaxation_time`` is t0, 1/gdot0.
    """

    relaxation_time: float
    start_fluidity: float = 1.0

    options = (*NGF.options,
               positive("relaxation_time", None, "1/gdot0", "relaxation time t0 of the fluidity; "
                        "default: the inertial time of the grains at the reference pressure, which "
                        "is the inertial number in these units", "t0 dg/dt", shared=BOTH),
               Option("start_fluidity", "float", 1.0, "", "initial fluidity of a transient run "
                      "over the fluidity of the reference flow; with 0 the material remains static",
                      low=0.0))
    theory = "ngf_primitive"

    @classmethod
    def resolve(cls, parameters, names):
        if not parameters.relaxation_time:
            parameters.relaxation_time = parameters.inertial_number
        law = parameters.part("law").of(parameters)
        if not law.inverse_length_squared:
            return  # such a law is refused where the length is used
        I = np.array([1e-3, 1e-2, 1e-1])
        stiffness, _ = law.inverse_length_squared(law.stress_ratio(I)[0])
        if not np.allclose(stiffness, law.stress_ratio(0.0 * I)[1] * I, rtol=1e-6):
            raise ParameterError("model", parameters.model, f"A^2 d^2/xi^2 of @law "
                                 f"{parameters.law} differs from b I_loc, so uniform flow would "
                                 "not have the fluidity g_loc; must be ngf")

    @property
    def storage(self):
        return {"fluidity": self.relaxation_time}

    # This F has neither a double root nor a spurious root.
    curvature, spurious_root = Model.curvature, Model.spurious_root

    def source(self, law, s, mu, P, g):
        # The inverse length has a kink at mu_s: use its slope above.
        mu_above = np.where(mu == law.yield_ratio, np.nextafter(law.yield_ratio, np.inf), mu)
        sign = np.where(g < 0.0, 1.0, np.sign(law.yield_ratio - mu_above))
        K, K_slope = (sign * part for part in law.inverse_length_squared(mu_above))
        drag = law.stress_ratio(np.zeros_like(mu))[1] * np.abs(g) / s
        return WithDerivatives(g * (K + drag * mu),
                               rate=g * (K_slope + drag),
                               pressure=-g * drag * mu / (2.0 * P),
                               fluidity=K + 2.0 * drag * mu)
