"""Local laws mu_loc(I); a new law is one new file.

A law is a class that derives from `Law`. It is pure numpy: arrays go in, and arrays of the same
shape come out, with their derivatives.
"""

import dataclasses
from abc import ABC, abstractmethod

import numpy as np

from ...options import ParameterError, positive

#: Rows that several laws share.
MU_S = positive("mu_s", 0.3819, "", "static yield value of the stress ratio", "(1.2), (1.3)",
                shared=("restart", "mode_file"))
MU_2 = positive("mu_2", 0.6435, "", "limit of the stress ratio of the Jop law", "(1.3)",
                shared=("restart", "mode_file"))
B = positive("b", 0.9377, "", "slope of mu_loc at I = 0", "(1.2), (1.3)",
             shared=("restart", "mode_file"))
I_0 = positive("I_0", None, "1", "inertial number at which the Jop law is half way from mu_s to "
               "mu_2; given, it takes the place of b", "I_0 = (mu_2 - mu_s)/b",
               shared=("restart", "mode_file"))


class Law(ABC):
    """A local law mu_loc(I) and its inverse.

    A subclass must define `stress_ratio` and `inertial_number`. It may define
    ``inverse_length_squared(mu)``, which returns A^2 d^2/xi^2 of (2.8) and its derivative, both
    with the shape of ``mu``; non-local models need it. It may define everything else below.

    Attributes
    ----------
    options : tuple of pgran.options.Option
        The law's own options. `of` passes their values to the constructor by name.
    yield_ratio : float or ndarray
        Stress ratio up to which nothing flows locally, 0 for a law without yield value.
    """

    options = ()
    yield_ratio = 0.0
    inverse_length_squared = None

    @classmethod
    def resolve(cls, parameters, given):
        """Fill in and check values of ``parameters``; ``given`` holds the names that were set.

        Raises `pgran.options.ParameterError`. By default there is nothing to do.
        """

    @classmethod
    def of(cls, parameters):
        """Return the law with the values of its rows."""
        return cls(**{row.name: getattr(parameters, row.name) for row in cls.options})

    @abstractmethod
    def stress_ratio(self, I):
        """Return mu_loc(I) and its derivative with respect to I."""

    @abstractmethod
    def inertial_number(self, mu):
        """Return I_loc(mu), which is zero up to `yield_ratio` (2.7), and its derivative."""

    @property
    def limit(self):
        """The stress ratio that the law approaches as I grows, infinite for a law without limit."""
        before, last = self.stress_ratio(np.array([1e12, 1e15]))[0]
        return float(last) if last - before < 1e-9 * last else np.inf

    def weakened(self, factor):
        """Return the law of elements whose static value mu_s is ``factor`` (n,) times this one."""
        if not hasattr(self, "mu_s"):
            raise ParameterError("imperfection", "below 1", f"the law {type(self).__name__} has "
                                 "no mu_s to weaken; allowed is 1")
        return dataclasses.replace(self, mu_s=self.mu_s * factor)

    def elastic_stress_ratio(self, gdot, s, compliance):
        """Solve s I_loc(mu) + compliance mu = gdot for mu > `yield_ratio`.

        Parameters
        ----------
        gdot, s, compliance : ndarray
            Shear rate, inverse inertial time of the grains, and theta P; one shape.

        Returns
        -------
        ndarray
            mu. This default uses Newton's method within a bracket and stops when no entry changes
            by more than rounding; a law may give a closed form instead. Entries without a
            solution are not numbers.
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


#: Half the distance of the extreme principal values of N in plane flow.
PLANE_REACH = float(np.sqrt(0.5))


def ill_posedness(mu, nu, centre=0.0, reach=PLANE_REACH):
    """Return q^2 + 8 r^2 reach^2 - 4 r (1 - sqrt(2) q centre), r = 1 - nu, q = mu (1 - nu/2).

    It is positive where some long wave grows, and for LI, where waves of all lengths do the same,
    where the law is ill-posed. In plane flow it is C(I) = 4 nu^2 - 4 nu + mu^2 (1 - nu/2)^2.

    Parameters
    ----------
    mu, nu : ndarray
        mu_loc(I) and nu = I mu_loc'(I)/mu_loc(I) of (3.6); one shape.
    centre, reach : float
        Mean and half distance of the extreme principal values of N; the defaults are those of
        plane flow.
    """
    r, q = 1.0 - nu, mu * (1.0 - nu / 2.0)
    return q**2 + 8.0 * r**2 * reach**2 - 4.0 * r * (1.0 - np.sqrt(2.0) * q * centre)


def sensitivity(law, I):
    """Return mu_loc(I) and nu = I mu_loc'(I)/mu_loc(I) of (3.6), each with the shape of ``I``."""
    mu, slope = law.stress_ratio(I)
    return mu, I * slope / mu


def sign_changes(function, low, high, count=2001):
    """Return where ``function`` changes sign between ``low`` and ``high`` > 0, (m,).

    Brackets on ``count`` points in geometric order are bisected to the last digit.
    """
    points = np.geomspace(low, high, count)
    values = function(points)
    start = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    low, high, sign = points[start], points[start + 1], np.sign(values[start])
    for _ in range(60):
        middle = np.sqrt(low * high)
        same = np.sign(function(middle)) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.sqrt(low * high)


def slope_of_jop(cls, parameters, given):
    """Fill in b or leave it out where I_0 is given, and check mu_2; for `Law.resolve`."""
    if not parameters.mu_2 > parameters.mu_s:
        raise ParameterError("mu_2", parameters.mu_2,
                             f"must exceed @mu_s {parameters.mu_s} with @law {parameters.law}")
    if parameters.I_0 is not None:
        if {"b", "I_0"} <= given:
            raise ParameterError("I_0", parameters.I_0, "takes the place of @b; give one of them")
        parameters.b = None
