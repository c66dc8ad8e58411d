"""Local laws mu_loc(I), the fluidity source and the elastic return: numpy alone.

Every function takes arrays and returns values with their derivatives; nothing
here knows of meshes or solvers. Units: d, |sigma_1| and 1/gdot0.

Symbols: ``mu`` stress ratio, ``I`` inertial number, ``gdot`` equivalent shear
rate, ``g`` fluidity, ``P`` pressure, ``xi`` cooperativity length,
``s = sqrt(P/(d^2 rho_s))`` the inverse of the grains' inertial time, and
``theta = 1/(G dt)`` the compliance of the elastic element in one step (0: rigid).
"""

from dataclasses import dataclass

import numpy as np

from .options import OptionError


@dataclass(frozen=True)
class Bingham:
    """mu_loc = mu_s + b I, equation (1.2)."""

    mu_s: object
    b: float

    def stress_ratio(self, I):
        """Return mu_loc(I) and its derivative."""
        return self.mu_s + self.b * I, self.b * np.ones_like(I)

    def inertial_number(self, mu):
        """Return I_loc(mu), zero up to mu_s (2.7), and its derivative."""
        flowing = mu > self.mu_s
        return np.where(flowing, mu - self.mu_s, 0.0) / self.b, flowing / self.b

    def inverse_length_squared(self, mu):
        """Return A^2 d^2 / xi^2 of (2.8a) and its derivative."""
        return np.abs(mu - self.mu_s), np.sign(mu - self.mu_s)

    def elastic_stress_ratio(self, gdot, s, compliance):
        """Solve s I_loc(mu) + compliance mu = gdot for mu > mu_s, compliance = theta P."""
        return (gdot + s * self.mu_s / self.b) / (s / self.b + compliance)


@dataclass(frozen=True)
class Jop:
    """mu_loc = mu_s + (mu_2 - mu_s)/(I_0/I + 1), I_0 = (mu_2 - mu_s)/b, equation (1.3).

    At mu >= mu_2 there is no I_loc: the result is not a number, which a solver
    sees as a failed evaluation.
    """

    mu_s: object
    mu_2: float
    b: float

    @property
    def I_0(self):
        """I_0 = (mu_2 - mu_s)/b."""
        return (self.mu_2 - self.mu_s) / self.b

    def stress_ratio(self, I):
        """Return mu_loc(I) and its derivative."""
        fraction = I / (self.I_0 + I)
        rise = self.mu_2 - self.mu_s
        return self.mu_s + rise * fraction, rise * self.I_0 / (self.I_0 + I)**2

    def inertial_number(self, mu):
        """Return I_loc(mu), zero up to mu_s (2.7), and its derivative."""
        flowing = mu > self.mu_s
        gap = np.where(mu < self.mu_2, self.mu_2 - mu, np.nan)
        value = self.I_0 * (mu - self.mu_s) / gap
        slope = self.I_0 * (self.mu_2 - self.mu_s) / gap**2
        return np.where(flowing, value, 0.0), np.where(flowing, slope, 0.0)

    def inverse_length_squared(self, mu):
        """Return A^2 d^2 / xi^2 of (2.8b) and its derivative."""
        rise = self.mu_2 - self.mu_s
        gap = np.where(mu < self.mu_2, self.mu_2 - mu, np.nan)
        excess = np.abs(mu - self.mu_s)
        return rise * excess / gap, rise * (np.sign(mu - self.mu_s) * gap + excess) / gap**2

    def elastic_stress_ratio(self, gdot, s, compliance):
        """Solve s I_loc(mu) + compliance mu = gdot for mu_s < mu < mu_2, compliance = theta P."""
        inertial = s * self.I_0
        linear = inertial + compliance * self.mu_2 + gdot
        constant = inertial * self.mu_s + gdot * self.mu_2
        return 2.0 * constant / (linear + np.sqrt(linear**2 - 4.0 * compliance * constant))


@dataclass(frozen=True)
class Material:
    """The parameters of a rheology, and the homogeneous pure shear that sets the units.

    ``law`` is `Bingham` or `Jop`, ``model`` 'ngf' or 'li', ``A`` the non-local
    amplitude, ``phi`` the solid fraction, ``I0`` the target inertial number and
    ``G`` the elastic shear modulus. With gdot0 = 1 and sigma_1 = -1:
    P0 = 1/(1 - mu_loc(I0)), g0 = 1/mu_loc(I0), and the grains' inertial time is
    sqrt(d^2 rho_s) = I0 sqrt(P0).
    """

    law: object
    model: str
    A: float
    phi: float
    I0: float
    G: float

    @property
    def stress_ratio(self):
        """mu_loc(I0)."""
        return float(self.law.stress_ratio(np.asarray(self.I0))[0])

    @property
    def pressure(self):
        """P0, in |sigma_1|."""
        return 1.0 / (1.0 - self.stress_ratio)

    @property
    def fluidity(self):
        """g0, in gdot0."""
        return 1.0 / self.stress_ratio

    @property
    def yield_stress(self):
        """mu_s P0, in |sigma_1|."""
        return self.law.mu_s * self.pressure

    @property
    def loading_time(self):
        """mu_s P0/G, the time of elastic loading from rest to yield, in 1/gdot0."""
        return self.yield_stress / self.G

    def elastic_compliance(self, dt):
        """Return theta = 1/(G dt), in 1/|sigma_1| gdot0; 0, rigid, for a step of no length."""
        return 1.0 / (self.G * dt) if dt > 0.0 else 0.0

    def inverse_time(self, P):
        """Return s = sqrt(P/(d^2 rho_s)), in gdot0, at pressures ``P``, |sigma_1|."""
        return np.sqrt(P) / self.root_density

    @property
    def root_density(self):
        """sqrt(d^2 rho_s), in sqrt(|sigma_1|)/gdot0."""
        return self.I0 * np.sqrt(self.pressure)

    @property
    def bulk_density(self):
        """phi rho_s, in |sigma_1|/(d gdot0)^2."""
        return self.phi * self.root_density**2


@dataclass
class Response:
    """What the rheology answers at points, each an array of one shape.

    sigma' = 2 viscosity D~; ``source`` is F of the fluidity equation (None for
    LI); ``stress_ratio`` mu = tau/P; ``inertial_number`` I of the plastic rate
    g mu; ``fluidity`` g. The suffixes name derivatives with respect to the effective rate
    gdot~, the pressure and the fluidity.
    """

    viscosity: np.ndarray
    viscosity_rate: object
    viscosity_pressure: np.ndarray
    stress_ratio: np.ndarray
    inertial_number: np.ndarray
    fluidity: np.ndarray
    viscosity_fluidity: object = 0.0
    source: object = None
    source_rate: object = None
    source_pressure: object = None
    source_fluidity: object = None


def ngf(law, s, gdot, P, g, theta):
    """Non-local granular fluidity with the elastic return; a `Response`.

    With D~ = D + theta S/2 and gdot~ = sqrt(2 D~:D~) (argument ``gdot``):
    sigma' = 2 P/(g + theta P) D~, mu = gdot~/(g + theta P) and
    F = (A^2 d^2/xi^2) (g - g_loc), g_loc = s I_loc(mu)/mu (2.5)-(2.8). ``s`` is
    `Material.inverse_time` at ``P``; all arrays have one shape.
    """
    total = 1.0 / (g + theta * P)
    mu = gdot * total
    I_loc, I_slope = law.inertial_number(mu)
    stiffness, stiffness_slope = law.inverse_length_squared(mu)
    positive = np.maximum(mu, law.mu_s)  # I_loc is zero below mu_s, so this changes no value
    ratio = I_loc / positive
    ratio_slope = (I_slope - ratio) / positive
    lag = g - s * ratio
    source_mu = stiffness_slope * lag - stiffness * s * ratio_slope
    return Response(
        viscosity=P * total,
        viscosity_rate=0.0,
        viscosity_pressure=g * total**2,
        viscosity_fluidity=-P * total**2,
        stress_ratio=mu,
        inertial_number=g * mu / s,
        fluidity=g,
        source=stiffness * lag,
        source_rate=source_mu * total,
        source_pressure=-source_mu * theta * mu * total - stiffness * ratio * s / (2.0 * P),
        source_fluidity=stiffness - source_mu * mu * total)


def li(law, s, gdot, P, theta):
    """Local inertial rheology with its closed-form elastic return; a `Response`.

    g = g_loc pointwise: s I_loc(mu) + theta P mu = gdot~ above yield, and
    mu = gdot~/(theta P) below; sigma' = 2 (mu P/gdot~) D~. Arguments as of `ngf`.
    """
    compliance = theta * P
    flowing = gdot > compliance * law.mu_s
    mu = np.where(flowing, law.elastic_stress_ratio(gdot, s, compliance), 0.0)
    I, slope = law.inertial_number(mu)
    safe = np.where(flowing, gdot, 1.0)
    total = 1.0 / (s * np.where(flowing, slope, 1.0) + compliance)
    mu_rate = total
    mu_pressure = -(s / (2.0 * P) * I + theta * mu) * total
    elastic = 1.0 / theta if theta > 0.0 else np.inf
    return Response(
        viscosity=np.where(flowing, mu * P / safe, elastic),
        viscosity_rate=np.where(flowing, P * (mu_rate - mu / safe) / safe, 0.0),
        viscosity_pressure=np.where(flowing, (mu + P * mu_pressure) / safe, 0.0),
        stress_ratio=np.where(flowing, mu, gdot * elastic / P),
        inertial_number=I,
        fluidity=np.where(flowing, s * I / np.where(flowing, mu, 1.0), 0.0))


def rotated(stress, angle):
    """Return the deviator (3, ...), 11, 22, 12, turned counterclockwise by ``angle`` (...), rad."""
    mean, half = (stress[0] + stress[1]) / 2.0, (stress[0] - stress[1]) / 2.0
    cos, sin = np.cos(2.0 * angle), np.sin(2.0 * angle)
    turned = half * cos - stress[2] * sin
    return np.array([mean + turned, mean - turned, half * sin + stress[2] * cos])


def law_of(settings):
    """Return the law of resolved options."""
    if settings.law == "bingham":
        return Bingham(settings.mu_s, settings.b)
    return Jop(settings.mu_s, settings.mu_2, settings.b)


def material_of(settings):
    """Return the `Material` of resolved options. Raises `OptionError` where P0 would not exist."""
    material = Material(law_of(settings), settings.model, settings.A, settings.phi,
                        settings.inertial_number, settings.shear_modulus)
    if not material.stress_ratio < 1.0:
        raise OptionError(
            f"-pgran_inertial_number {settings.inertial_number:g}: mu_loc(I0) is "
            f"{material.stress_ratio:.4g}, and plane-strain compression needs it below 1 (3.19)")
    return material
