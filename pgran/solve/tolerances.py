"""How exactly a step is solved: no worse than what it has to resolve, and no better.

What Newton's method leaves of the residual pushes the flow as an imperfection does. Before a band
has formed, it must be small against the perturbation from which the band grows. So the tolerance of
the residual follows the size of the perturbation. Each linear system is solved as exactly as
Newton's method can use.
"""

#: Linear systems are solved to this share of what the tolerance of the residual asks for.
SHARE = 0.3
#: Exponent of the last reduction of the residual in the next tolerance of a linear system.
ORDER = 1.5


class Tolerances:
    """Sets the tolerances of SNES and of its KSP. Those of the options are the loosest.

    Parameters
    ----------
    snes : PETSc.SNES
    whole : float
        Departure from the reference flow, relative to it, from which on ``-snes_atol`` holds. Below
        it the tolerance is smaller in proportion. Zero leaves both tolerances as they are.
    least : float
        Smallest share of ``-snes_atol``.
    """

    def __init__(self, snes, whole, least):
        self._whole, self._least = whole, least
        self._residual, self._linear = snes.getTolerances()[1], snes.getKSP().getTolerances()[0]
        self._tolerance, self._last = self._residual, None

    def begin(self, snes, perturbation):
        """Begin a step from a flow with this departure from the reference flow, over its size."""
        if not self._whole:
            return
        share = min(1.0, max(self._least, perturbation / self._whole))
        self._tolerance, self._last = share * self._residual, None
        snes.setTolerances(atol=self._tolerance)

    def next(self, snes):
        """Set the tolerance of the linear system at the present iterate."""
        norm = snes.getFunctionNorm()
        if not self._whole or norm <= 0.0:
            return
        wanted = 1.0 if self._last is None else (norm / self._last)**ORDER
        self._last = norm
        snes.getKSP().setTolerances(
            rtol=min(self._linear, max(wanted, SHARE * self._tolerance / norm)))
