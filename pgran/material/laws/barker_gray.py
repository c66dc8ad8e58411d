"""The partially regularised law of Barker & Gray (2017), well-posed for LI at small I."""

from dataclasses import dataclass, field

import numpy as np

from ...options import BOTH, ParameterError, positive
from . import I_0, MU_2, MU_S, B, Law, ill_posedness, resolve_jop, sign_changes
from .jop import Jop


@dataclass(frozen=True)
class BarkerGray(Law):
    """The Jop law, replaced below I_1 by a law without yield value, and without upper limit.

    ::

        I <= I_1:   mu_loc = sqrt(alpha/ln(A_-/I))
        I > I_1:    mu_loc = (mu_s I_0 + mu_2 I + mu_inf I^2)/(I_0 + I)

    I_1 is the lower root of C(I) = 0 for the Jop law with the same mu_s, mu_2 and I_0, and A_-
    makes mu_loc continuous at I_1. For I -> 0 the law is well-posed if and only if alpha < 2.
    It has no cooperativity length and applies to LI.
    """

    mu_s: object
    mu_2: float
    I_0: float
    alpha: float = 1.9
    mu_inf: float = 0.05
    I_1: object = field(init=False)
    A_minus: object = field(init=False)

    options = (MU_S, MU_2, B, I_0,
               positive("alpha", 1.9, "", "coefficient of the law below I_1; the law is well-posed "
                        "for I -> 0 if alpha < 2", "mu = sqrt(alpha/ln(A_-/I))", shared=BOTH),
               positive("mu_inf", 0.05, "", "slope of mu_loc for I -> infinity", shared=BOTH))
    resolve = classmethod(resolve_jop)

    @classmethod
    def of(cls, parameters):
        p = parameters
        I_0 = p.I_0 if p.I_0 is not None else (p.mu_2 - p.mu_s) / p.b
        return cls(p.mu_s, p.mu_2, I_0, p.alpha, p.mu_inf)

    def __post_init__(self):
        values, index = np.unique(self.mu_s, return_inverse=True)
        roots = np.array([self._lower_root(mu_s) for mu_s in values])
        I_1 = roots[index].reshape(np.shape(self.mu_s))
        object.__setattr__(self, "I_1", I_1)
        object.__setattr__(self, "A_minus", I_1 * np.exp(self.alpha / self._rising(I_1)[0]**2))

    def _lower_root(self, mu_s):
        jop = Jop(mu_s, self.mu_2, (self.mu_2 - mu_s) / self.I_0)
        roots = sign_changes(lambda I: ill_posedness(jop, I), 1e-9, 1e3)
        if not roots.size:
            raise ParameterError("law", "barker_gray", "the Jop law with these parameters does not "
                                 "change between ill-posed and well-posed at any inertial number")
        return roots[0]

    def _rising(self, I):
        below = self.I_0 + I
        value = (self.mu_s * self.I_0 + self.mu_2 * I + self.mu_inf * I**2) / below
        return value, (self.mu_2 + 2.0 * self.mu_inf * I - value) / below

    def stress_ratio(self, I):
        I = np.asarray(I, dtype=float)
        low = I <= self.I_1
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(self.alpha / np.log(self.A_minus / np.where(low, I, self.I_1)))
            slope = root**3 / (2.0 * self.alpha * I)
        value, rising = self._rising(I)
        return np.where(low, root, value), np.where(low, np.where(I > 0.0, slope, np.inf), rising)

    def inertial_number(self, mu):
        mu = np.asarray(mu, dtype=float)
        low = mu <= self._rising(self.I_1)[0]
        small = np.where(low & (mu > 0.0), mu, np.inf)
        I = np.where(mu > 0.0, self.A_minus * np.exp(-self.alpha / small**2), 0.0)
        slope = 2.0 * self.alpha * I / small**3
        linear = mu - self.mu_2
        constant = self.I_0 * (mu - self.mu_s)
        root = np.sqrt(np.where(low, 1.0, linear**2 + 4.0 * self.mu_inf * constant))
        # Which form of the positive root avoids cancellation depends on the sign of mu - mu_2.
        with np.errstate(divide="ignore", invalid="ignore"):
            large = np.where(linear > 0.0, (linear + root) / (2.0 * self.mu_inf),
                             2.0 * constant / (root - linear))
        return np.where(low, I, large), np.where(low, slope, (large + self.I_0) / root)
