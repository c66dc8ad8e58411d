"""The inertial-number-gradient model (IG), equation (5.1); linear theory only."""

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
        raise NotImplementedError("the model ig is implemented in the linear theory only")
