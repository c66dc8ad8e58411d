"""The inertial-number-gradient model (IG), equation (5.1), which only the linear theory knows."""

from dataclasses import dataclass

from . import AMPLITUDE, Model


@dataclass(frozen=True)
class IG(Model):
    """The inertial-number-gradient model; wave vectors are in units of sqrt(nu_I) d, not A d."""

    A: float

    options = (AMPLITUDE,)
    theory = "ig"
    solved = False

    def response(self, law, s, gdot, P, g, theta):
        """Raise NotImplementedError: the model has no well-posed flow to be computed."""
        raise NotImplementedError("the IG model is known to the linear theory only")
