"""Rheological models: their fields, their response with derivatives, and their storage terms.

A model is a class that derives from `Model`; a new model is one new file. It is pure numpy.

Symbols: ``mu`` stress ratio, ``I`` inertial number, ``gdot`` equivalent shear rate, ``g``
fluidity, ``P`` pressure, ``xi`` cooperativity length, ``s = sqrt(P/(d^2 rho_s))`` the inverse of
the grains' inertial time, and ``theta = f/(G dt)`` the compliance of the elastic element in one
step (0: rigid).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...options import positive

#: The row of the non-local amplitude, which is also the unit A d of wave vectors.
AMPLITUDE = positive("A", 0.48, "", "non-local amplitude; A d is also the unit of wave vectors in "
                     "theory and spectra", "(2.8)", shared=("restart", "mode_file"))


@dataclass
class WithDerivatives:
    """A value at points and its derivatives, each an array of one shape.

    ``rate``, ``pressure`` and ``fluidity`` are the derivatives with respect to the effective
    shear rate gdot~, to P and to g. A derivative that vanishes everywhere may be 0.0.
    """

    value: np.ndarray
    rate: object = 0.0
    pressure: object = 0.0
    fluidity: object = 0.0


@dataclass
class Response:
    """What a rheology answers at points, with D~ = D + theta S/2 and gdot~ = sqrt(2 D~:D~).

    Attributes
    ----------
    viscosity : WithDerivatives
        sigma' = 2 viscosity D~, in stress/gdot0.
    stress_ratio, inertial_number, fluidity : ndarray
        mu = tau/P, I of the plastic rate g mu, and g in gdot0.
    source : WithDerivatives or None
        F of the fluidity equation in gdot0; None for a model without this equation.
    """

    viscosity: WithDerivatives
    stress_ratio: np.ndarray
    inertial_number: np.ndarray
    fluidity: np.ndarray
    source: object = None


class Model(ABC):
    """A rheology that rests on a local law.

    A subclass must define `response`. With a fluidity field the solver adds its equation::

        storage["fluidity"] (h, dg/dt) + diffusion (grad h, grad g) + (h, F) = 0

    Attributes
    ----------
    options : tuple of pgran.options.Option
        The model's own options. `of` passes their values to the constructor by name.
    fields : tuple of str
        Fields of the solver: velocity, pressure, and perhaps fluidity.
    start_fluidity : float
        Fluidity from which a run in time starts, over that of the reference flow.
    theory : str or None
        Which linear theory of homogeneous flow holds: ngf, ngf_primitive, li or ig; None if there
        is none.
    solved : bool
        Whether the nonlinear solver knows the model.
    needs_length : bool
        Whether the law must have a cooperativity length.
    diffusion : float
        Coefficient of grad g in the fluidity equation, d^2.
    """

    options = ()
    start_fluidity = 0.0
    fields = "velocity", "pressure"
    theory = None
    solved = True
    needs_length = False
    diffusion = 0.0

    @classmethod
    def resolve(cls, parameters, given):
        """Fill in and check values of ``parameters``, as `pgran.material.laws.Law.resolve`."""

    @classmethod
    def of(cls, parameters):
        """Return the model with the values of its rows."""
        return cls(**{row.name: getattr(parameters, row.name) for row in cls.options})

    @property
    def storage(self):
        """Coefficients of time derivatives by field; by default there are none."""
        return {}

    @property
    def has_fluidity(self):
        """Whether the fluidity is a field of its own."""
        return "fluidity" in self.fields

    @property
    def length(self):
        """The length, d, in whose units growing waves are counted: A d of NGF."""
        return float(np.sqrt(self.diffusion)) or 1.0

    def fluidity_excess(self, law, s, mu, P, g):
        """Return g - g_loc and its derivatives, a `WithDerivatives` whose ``rate`` is that by mu.

        Only walls of local fluidity need it; the default raises NotImplementedError.
        """
        raise NotImplementedError(f"{type(self).__name__} has no walls of local fluidity")

    def curvature(self, law, s, mu, P, g):
        """Return the second derivative of F with respect to mu, (points, n) or a number, gdot0.

        P and g are held; the arguments are those of `lag`. Newton's method uses it near a double
        root of F, see `pgran.space.points.secant`. The default is zero: there is no double root.
        """
        return 0.0

    def spurious_root(self, law, mu, I):
        """Return mu_loc(I) - mu_s where F vanishes because mu = mu_s, and zero elsewhere.

        Uniform flow must have mu = mu_loc(I). The solver repeats a step that converged to another
        root of F, see `pgran.solve.driver`. The default is zero: there is no other root.

        Parameters
        ----------
        law : pgran.material.laws.Law
        mu, I : ndarray, (points, n)
            Stress ratio, and inertial number of the plastic rate.
        """
        return np.zeros_like(mu)

    @abstractmethod
    def response(self, law, s, gdot, P, g, theta):
        """Return the `Response` at points.

        Parameters
        ----------
        law : pgran.material.laws.Law
            The local law, whose parameters may vary from element to element, (n,).
        s : ndarray, (points, n)
            `pgran.material.Material.inverse_time` at ``P``, gdot0.
        gdot : ndarray, (points, n)
            Effective shear rate gdot~, gdot0.
        P : ndarray, (points, n)
            Pressure, stress unit of the case.
        g : ndarray, (points, n), or None
            Fluidity, gdot0; None for a model without this field.
        theta : float
            Compliance of the elastic element, gdot0/stress; 0 where it is rigid.
        """
