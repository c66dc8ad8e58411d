"""Rheological models. A new model is one new file with a subclass of `Model`.

Symbols: ``mu`` stress ratio, ``I`` inertial number, ``gdot`` equivalent shear rate, ``g``
fluidity, ``P`` pressure, ``xi`` cooperativity length, ``s = sqrt(P/(d^2 rho_s))`` the inverse of
the grains' inertial time, and ``theta = f/(G dt)`` the compliance of the elastic element in one
step (0: rigid).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...options import BOTH, positive
from ..laws import Configurable

AMPLITUDE = positive("A", 0.48, "", "non-local amplitude; A d is also the unit of wave vectors in "
                     "theory and spectra", "(2.8)", shared=BOTH)


@dataclass
class WithDerivatives:
    """A value at points and its derivatives by gdot~ (``rate``), P and g, arrays or 0.0."""

    value: np.ndarray
    rate: object = 0.0
    pressure: object = 0.0
    fluidity: object = 0.0


@dataclass
class Response:
    """Response of a rheology at points, with D~ = D + theta S/2 and gdot~ = sqrt(2 D~:D~)."""

    #: sigma'/(2 D~), stress/gdot0.
    viscosity: WithDerivatives
    #: mu = tau/P.
    stress_ratio: np.ndarray
    #: I of the plastic rate g mu.
    inertial_number: np.ndarray
    #: g, gdot0.
    fluidity: np.ndarray
    #: F of the fluidity equation as `WithDerivatives`, gdot0; None without this equation.
    source: object = None


class Model(Configurable, ABC):
    """A rheology based on a local law.

    A subclass must define `response`. The equation of a fluidity field is::

        storage["fluidity"] (h, dg/dt) + diffusion (grad h, grad g) + (h, F) = 0
    """

    #: Initial fluidity of a transient run over the fluidity of the reference flow.
    start_fluidity = 0.0
    #: Fields of the solver: velocity, pressure, and for some models fluidity.
    fields = "velocity", "pressure"
    #: Linear theory of homogeneous flow: ngf, ngf_primitive, li, ig or None.
    theory = None
    #: Whether the nonlinear solver supports the model.
    solved = True
    #: Whether the law must have a cooperativity length.
    needs_length = False
    #: Coefficient of grad g in the fluidity equation, d^2.
    diffusion = 0.0
    #: Coefficients of time derivatives, {field: number}.
    storage = {}

    @property
    def has_fluidity(self):
        """Whether the fluidity is a field of the solver."""
        return "fluidity" in self.fields

    @property
    def length(self):
        """Unit of growing wavelengths, d: A d for NGF."""
        return float(np.sqrt(self.diffusion)) or 1.0

    def fluidity_excess(self, law, s, mu, P, g):
        """Return g - g_loc as `WithDerivatives`, where ``rate`` is the derivative by mu."""
        raise NotImplementedError(f"{type(self).__name__} does not support walls of local fluidity")

    def curvature(self, law, s, mu, P, g):
        """Return the second derivative of F with respect to mu, (points, n) or a number, gdot0.

        Newton's method uses it near a double root of F, see `pgran.space.points.secant`.
        """
        return 0.0

    def spurious_root(self, law, mu, I):
        """Return mu_loc(I) - mu_s where F vanishes because mu = mu_s, and zero elsewhere.

        The solver repeats a step that converged to such a root of F.
        """
        return np.zeros_like(mu)

    @abstractmethod
    def response(self, law, s, gdot, P, g, theta):
        """Return the `Response` at points of n elements, where parameters of ``law`` may be (n,).

        ``s`` = sqrt(P/(d^2 rho_s)), effective shear rate ``gdot``, pressure ``P`` and fluidity
        ``g`` (None without this field) are (points, n), and ``theta`` is the elastic compliance.
        """
