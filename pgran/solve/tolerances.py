"""Nonlinear and linear tolerances of a time step.

The residual left by Newton's method acts like an imperfection: its tolerance is proportional to the
perturbation from which a band grows. The tolerance of each linear system follows the convergence of
Newton's method.
"""

#: Ratio of the smallest linear tolerance to the reduction that the residual still needs.
SHARE = 0.3
#: Exponent of the last reduction of the residual in the next tolerance of a linear system.
ORDER = 1.5


class Tolerances:
    """Sets the tolerances of SNES and of its KSP; the values of the options are upper bounds.

    ``full_deviation`` is the relative deviation from the reference flow from which ``-snes_atol``
    applies, zero for constant tolerances; ``min_factor`` is their smallest ratio to this option.
    """

    def __init__(self, snes, full_deviation, min_factor):
        self._full_deviation, self._min_factor = full_deviation, min_factor
        self._residual, self._linear = snes.getTolerances()[1], snes.getKSP().getTolerances()[0]
        self._tolerance, self._last = self._residual, None

    def begin(self, snes, deviation):
        """Begin a step from a flow with this relative deviation from the reference flow."""
        if not self._full_deviation:
            return
        factor = min(1.0, max(self._min_factor, deviation / self._full_deviation))
        self._tolerance, self._last = factor * self._residual, None
        snes.setTolerances(atol=self._tolerance)

    def next(self, snes):
        """Set the tolerance of the linear system of the current Newton iteration."""
        norm = snes.getFunctionNorm()
        if not self._full_deviation or norm <= 0.0:
            return
        wanted = (norm / self._last)**ORDER if self._last else 1.0
        self._last = norm
        snes.getKSP().setTolerances(
            rtol=min(self._linear, max(wanted, SHARE * self._tolerance / norm)))
