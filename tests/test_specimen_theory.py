"""The theory of the specimen: its limits, and a transfer matrix with 170 digits."""

import mpmath
import numpy as np
import pytest
from scipy.optimize import bisect

from pgran.material.laws.barker_gray import BarkerGray
from pgran.material.laws.bingham import Bingham
from pgran.material.laws.jop import Jop
from pgran.theory import specimen
from pgran.theory.specimen import PARITIES, column_growth_rate, growth_rate

BINGHAM, JOP = Bingham(0.3819, 0.9377), Jop(0.3819, 0.6435, 0.9377)
REGULARISED = BarkerGray(0.342, 0.557, 0.069)
SPECIMEN = {"inertial_number": 0.001, "width": 40.0, "height": 120.0}
#: phi rho_s = phi I0^2 P0 at phi = 0.6 and I0 = 0.001.
DENSITY = 0.6 * 0.001**2 / (1.0 - 0.3819 - 0.9377 * 0.001)


def rate(law=BINGHAM, model="ngf", **more):
    return growth_rate(law, model, **{**SPECIMEN, **more})


class Transfer:
    """The theory as first-order equations y' = M y across the width, without parity and roots.

    y = v1, v2, sigma_11, sigma_12, g', g',1, for LI without the last two. exp(M L) maps the left
    face to the right one, and P' follows directly from (2.3) to (2.7).
    """

    def __init__(self, law, model, r, *, inertial_number, width, height, half_waves=1,
                 parity="sway", amplitude=0.48, density=0.0, shear_modulus=None,
                 relaxation_time=0.0):
        mu = float(law.stress_ratio(np.asarray(inertial_number))[0])
        I, slope = (mpmath.mpf(float(part)) for part in law.inertial_number(np.asarray(mu)))
        self.k, self.L = half_waves * mpmath.pi / height, mpmath.mpf(width)
        self.sign, self.nonlocal_ = (1 if parity == "sway" else -1), model != "li"
        mu, k = mpmath.mpf(mu), self.k
        P, s = 1 / (1 - mu), 1 / mpmath.mpf(inertial_number)
        tau, g = mu * P, s * I / mu
        self.load, self.r = 2 * tau * k, mpmath.mpmathify(r)
        memory = self.r / (2 * mpmath.mpf(shear_modulus)) if shear_modulus else mpmath.mpf(0)
        turn = tau / mpmath.mpf(shear_modulus) if shear_modulus else mpmath.mpf(0)
        # mu' = (tau' - mu P')/P and g_loc' = g P'/(2 P) + rise mu'.
        rise = s * (slope - I / mu) / mu
        local = np.array([rise / P, g / (2 * P) - rise * mu / P])           # of tau', P'
        # D11 = (g tau/P)'/2 + memory tau', of tau', P', g'.
        D11 = np.array([g / (2 * P) + memory, -g * tau / (2 * P**2), tau / (2 * P)])
        names, rows = ("v1", "v2", "n", "s", "g", "slope"), {}
        unit = dict(zip(names, np.vectorize(mpmath.mpf)(np.eye(6))))
        if not self.nonlocal_:  # g' = g_loc'
            D11 = np.array([*(D11[:2] + D11[2] * local), mpmath.mpf(0)])
        # D11 = -k v2 and tau' = sigma_11 + P' give P'.
        pressure = (-k * unit["v2"] - D11[0] * unit["n"] - D11[2] * unit["g"]) / (D11[0] + D11[1])
        shear = unit["n"] + pressure
        c = mpmath.mpf(float(law.inverse_length_squared(np.asarray(float(mu)))[0]))
        rho = mpmath.mpf(density)
        rows["v1"] = -k * unit["v2"]
        # 2 D12 = v2,1 - k v1 and 2 w = -k v1 - v2,1.
        rows["v2"] = ((1 - turn) * k * unit["v1"]
                      + (g / P + 2 * memory) * unit["s"]) / (1 + turn)
        rows["n"] = rho * (self.r + mpmath.mpf(1) / 2) * unit["v1"] - k * unit["s"]
        rows["s"] = (rho * (self.r - mpmath.mpf(1) / 2) * unit["v2"]
                     - k * (pressure + shear))
        rows["g"] = unit["slope"]
        rows["slope"] = k**2 * unit["g"] + (
            c * (unit["g"] - local[0] * shear - local[1] * pressure)
            + relaxation_time * self.r * unit["g"]) / mpmath.mpf(amplitude)**2
        size = 6 if self.nonlocal_ else 4
        self.M = mpmath.matrix([list(rows[name][:size]) for name in names[:size]])

    def excess(self):
        """Return v1/zeta + 1/2 - r of the left face, for a right face displaced by 1."""
        over = mpmath.expm(self.M * self.L, method="taylor")
        # At the left face v1, v2 and, for NGF, g' are unknown, sigma_12 = load sign, others 0.
        unknown = [0, 1, 4] if self.nonlocal_ else [0, 1]
        wanted = [(2, 0), (3, self.load), (5, 0)] if self.nonlocal_ else [(2, 0), (3, self.load)]
        left = mpmath.matrix([[over[i, j] for j in unknown] for i, _ in wanted])
        right = mpmath.matrix([value - over[i, 3] * self.load * self.sign for i, value in wanted])
        return mpmath.lu_solve(left, right)[0] / self.sign + mpmath.mpf(1) / 2 - self.r


@pytest.fixture(autouse=True)
def many_digits():
    with mpmath.workdps(170):  # layers grow by exp(130) across the widest specimen
        yield


def exact(law, model, guess, arguments):
    """The root of `Transfer.excess` next to ``guess``."""
    def excess(r):
        return Transfer(law, model, r, **arguments).excess()

    if not any(arguments.get(name) for name in ("density", "shear_modulus", "relaxation_time")):
        return complex(excess(mpmath.mpf(0)))
    guess = mpmath.mpmathify(guess)
    return complex(mpmath.findroot(excess, (guess, guess * (1 + mpmath.mpf(10)**-6)),
                                   solver="secant", tol=1e-30))


CASES = [
    (BINGHAM, "ngf", {}),
    (BINGHAM, "ngf", {"height": 80.0, "half_waves": 2, "parity": "barrel"}),
    (BINGHAM, "ngf", {"inertial_number": 1e-4, "width": 100.0, "height": 50.0}),
    (JOP, "li", {"inertial_number": 0.03, "parity": "barrel", "half_waves": 3}),
    (BINGHAM, "ngf", {"density": DENSITY, "parity": "barrel", "width": 120.0, "height": 57.0}),
    (BINGHAM, "ngf", {"shear_modulus": 100.0}),
    (BINGHAM, "li", {"shear_modulus": 1000.0, "density": DENSITY}),
    (JOP, "ngf", {"shear_modulus": 1000.0, "density": 100 * DENSITY, "inertial_number": 0.01}),
    (JOP, "ngf_primitive", {"relaxation_time": 1e-5, "shear_modulus": 100.0}),
    (BINGHAM, "ngf_primitive", {"relaxation_time": 1e-3, "parity": "barrel", "half_waves": 2,
                                "density": DENSITY}),
]


@pytest.mark.parametrize("law, model, more", CASES, ids=str)
def test_growth_rates_agree_with_a_transfer_matrix(law, model, more):
    arguments = {**SPECIMEN, **more}
    found = growth_rate(law, model, **arguments)
    expected = exact(law, model, found, arguments)
    assert abs(found - expected) < 1e-9 * abs(expected)


def test_growth_rate_is_accurate_where_roots_of_the_characteristic_equation_coincide():
    """They coincide between H = 20 and 25 d: complex below, real above."""
    def roots(height):
        across = specimen._Across(specimen.Specimen(BINGHAM, "ngf", 0.001, 40.0, height))
        return specimen._roots(across.polynomials(0.0)[-1])

    height = bisect(lambda H: 1.0 if abs(roots(H).imag).max() > 0.0 else -1.0, 10.0, 25.0,
                    xtol=1e-14)
    first, second, _ = sorted(roots(height), key=abs)
    assert abs(first - second) < 1e-6 * abs(first)
    found, arguments = rate(height=height), {**SPECIMEN, "height": height}
    assert found == pytest.approx(exact(BINGHAM, "ngf", found, arguments).real, rel=1e-9)


def test_relaxation_time_inertia_and_elasticity_have_the_right_limits():
    rates = [rate(model="ngf_primitive", relaxation_time=t0) for t0 in (1e-11, 1e-6, 1e-4, 1e-2)]
    assert rates[0] == pytest.approx(rate(), rel=1e-5)
    assert rates == sorted(rates, reverse=True) and rates[-1] > 0.0
    assert rate(shear_modulus=np.inf) == rate()
    for more in ({"density": 1e-14}, {"shear_modulus": 1e9}):
        assert rate(**more) == pytest.approx(rate(), rel=1e-5)
    found = rate(density=DENSITY, parity="barrel")
    assert found.real < 0.0 < found.imag


def test_elasticity_increases_growth_up_to_elastic_buckling():
    rates = [rate(shear_modulus=G) for G in (1e5, 1e3, 100.0, 10.0, 6.0)]
    assert rates == sorted(rates)
    with pytest.raises(ValueError, match="buckles elastically"):
        rate(shear_modulus=4.0)


@pytest.mark.parametrize("model, more", [
    ("ngf", {}), ("li", {}), ("ngf_primitive", {"relaxation_time": 1e-8})], ids=str)
def test_a_slender_specimen_sways_as_a_creeping_column(model, more):
    for density in (0.0, 1e-12):
        wide = {"inertial_number": 0.001, "width": 100.0, "height": 6000.0, "density": density,
                **more}
        assert rate(model=model, **wide) == pytest.approx(
            column_growth_rate(BINGHAM, model, **wide), rel=0.01)
    assert column_growth_rate(BINGHAM, "ngf", **SPECIMEN) == pytest.approx(457.8, abs=0.05)


@pytest.mark.parametrize("more, message", [
    ({"model": "ig"}, "model ig: expected one of: ngf, ngf_primitive, li"),
    ({"model": "ngf_primitive"}, "relaxation time: the model ngf_primitive needs one"),
    ({"parity": "left"}, "parity left: expected one of: sway, barrel"),
    ({"height": float("nan")}, "height nan: must be a number > 0"),
    ({"inertial_number": 1.0}, "mu_loc(I0) is 1.32; plane-strain compression requires"),
    ({"shear_modulus": 0.5}, "shear_modulus 0.5: must be a number > mu P0 = 0.6203"),
    ({"law": REGULARISED}, "the law BarkerGray has no cooperativity length")], ids=str)
def test_invalid_arguments_are_refused(more, message):
    with pytest.raises(ValueError) as error:
        rate(**more)
    assert message in str(error.value)
    assert all(np.isfinite(rate(REGULARISED, "li", parity=parity)) for parity in PARITIES)
