"""Local laws mu_loc(I). A new law is one new file with a subclass of `Law`."""

import dataclasses
from abc import ABC, abstractmethod

import numpy as np

from ...options import BOTH, ParameterError, positive

#: Options of several laws.
MU_S = positive("mu_s", 0.3819, "", "static yield value of the stress ratio", "(1.2), (1.3)",
                shared=BOTH)
MU_2 = positive("mu_2", 0.6435, "", "limit of the stress ratio of the Jop law", "(1.3)",
                shared=BOTH)
B = positive("b", 0.9377, "", "slope of mu_loc at I = 0", "(1.2), (1.3)", shared=BOTH)
I_0 = positive("I_0", None, "1", "inertial number at which mu_loc of the Jop law is "
               "(mu_s + mu_2)/2; replaces b", "I_0 = (mu_2 - mu_s)/b", shared=BOTH)


class Configurable:
    """A law or a model, which options describe."""

    #: Options, whose values `of` passes to the constructor by name.
    options = ()

    @classmethod
    def resolve(cls, parameters, names):
        """Complete and check ``parameters``; ``names`` are the options that the user has set."""

    @classmethod
    def of(cls, parameters):
        """Return the law or model with the values of its options."""
        return cls(**{option.name: getattr(parameters, option.name) for option in cls.options})


class Law(Configurable, ABC):
    """A local law mu_loc(I) and its inverse, functions of arrays with their derivatives.

    A subclass must define `stress_ratio` and `inertial_number`. Non-local models also need
    ``inverse_length_squared(mu)``, which returns A^2 d^2/xi^2 of (2.8) and its derivative with
    respect to mu. Everything else has a default.
    """

    #: Largest stress ratio without local flow; 0 for a law without yield value.
    yield_ratio = 0.0
    inverse_length_squared = None

    @abstractmethod
    def stress_ratio(self, I):
        """Return mu_loc(I) and its derivative with respect to I."""

    @abstractmethod
    def inertial_number(self, mu):
        """Return I_loc(mu) of (2.7), which is zero up to `yield_ratio`, and its derivative."""

    @property
    def limit(self):
        """Limit of mu_loc for I -> infinity, possibly infinite."""
        previous, last = self.stress_ratio(np.array([1e12, 1e15]))[0]
        return float(last) if last - previous < 1e-9 * last else np.inf

    def weakened(self, factor):
        """Return the law with mu_s times ``factor`` (n,), one entry per element."""
        if not hasattr(self, "mu_s"):
            raise ParameterError("imperfection", "below 1",
                                 f"the law {type(self).__name__} has no mu_s; must be 1")
        return dataclasses.replace(self, mu_s=self.mu_s * factor)

    def elastic_stress_ratio(self, gdot, s, compliance):
        """Return mu > `yield_ratio` with s I_loc(mu) + compliance mu = gdot, or NaN.

        ``compliance`` is theta P. The default is Newton's method within a bracket, to rounding.
        """
        gdot, s, compliance = np.broadcast_arrays(gdot, s, compliance)
        with np.errstate(all="ignore"):
            low = np.zeros(gdot.shape) + self.yield_ratio
            # Either part of the rate bounds mu from above.
            high = np.fmin(self.stress_ratio(gdot / s)[0], gdot / compliance)
            mu = high.copy()
            for _ in range(200):
                I, slope = self.inertial_number(mu)
                excess = s * I + compliance * mu - gdot
                low, high = np.where(excess < 0.0, mu, low), np.where(excess > 0.0, mu, high)
                new = mu - excess / (s * slope + compliance)
                new = np.where((low <= new) & (new <= high), new, (low + high) / 2.0)
                done = ~(np.abs(new - mu) > 4.0 * np.finfo(float).eps * mu)
                mu = new
                if done.all():
                    return mu
        return np.where(done, mu, np.nan)


def ill_posedness(law, I, centre=0.0, reach=0.5**0.5):
    """Return q^2 + 8 r^2 reach^2 - 4 r (1 - sqrt(2) q centre), r = 1 - nu, q = mu (1 - nu/2).

    It is positive where some long wave grows; for LI waves of all lengths then grow. ``centre`` and
    ``reach`` are mean and half distance of the extreme principal values of N. In plane flow, the
    default, it is C(I) = 4 nu^2 - 4 nu + mu^2 (1 - nu/2)^2.
    """
    mu, nu = sensitivity(law, I)
    r, q = 1.0 - nu, mu * (1.0 - nu / 2.0)
    return q**2 + 8.0 * r**2 * reach**2 - 4.0 * r * (1.0 - np.sqrt(2.0) * q * centre)


def sensitivity(law, I):
    """Return mu_loc(I) and nu = I mu_loc'(I)/mu_loc(I) of (3.6)."""
    mu, slope = law.stress_ratio(I)
    return mu, I * slope / mu


def sign_changes(function, low, high, count=2001):
    """Return where ``function`` changes sign between ``count`` points from ``low`` to ``high``."""
    points = np.geomspace(low, high, count)
    signs = np.sign(function(points))
    left = np.flatnonzero(signs[1:] != signs[:-1])
    low, high, sign = points[left], points[left + 1], signs[left]
    for _ in range(60):  # bisection to rounding
        middle = 0.5 * (low + high)
        same = np.sign(function(middle)) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return 0.5 * (low + high)


def resolve_jop(cls, parameters, names):
    """`Law.resolve` of laws with the options of Jop: I_0 replaces b."""
    if not parameters.mu_2 > parameters.mu_s:
        raise ParameterError("mu_2", parameters.mu_2,
                             f"must exceed @mu_s {parameters.mu_s} with @law {parameters.law}")
    if parameters.I_0 is not None:
        if {"b", "I_0"} <= names:
            raise ParameterError("I_0", parameters.I_0, "replaces @b; set only one of them")
        parameters.b = None
