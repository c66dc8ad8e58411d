"""Laws and their inverses, derivatives of models, elastic return, and elasticity."""

import numpy as np
import pytest
from conftest import parameters
from scipy.linalg import expm, polar

from pgran import cases
from pgran.kinematics import PLANE
from pgran.material import elasticity, laws
from pgran.material.laws.barker_gray import BarkerGray
from pgran.material.laws.bingham import Bingham
from pgran.material.laws.jop import Jop
from pgran.material.models.li import LI
from pgran.material.models.ngf import NGF
from pgran.material.models.ngf_primitive import NGFPrimitive
from pgran.options import ParameterError

RNG = np.random.default_rng(3)
NON_LOCAL = {"bingham": Bingham(0.3819, 0.9377), "jop": Jop(0.3819, 0.6435, 0.9377)}
LAWS = {**NON_LOCAL, "barker_gray": BarkerGray(0.3819, 0.6435, 0.279)}
MODELS = {"ngf": NGF(0.48), "ngf_primitive": NGFPrimitive(0.48, 0.01), "li": LI(0.48)}


def random_points(n=200, least=0.0):
    """gdot, P and g over wide ranges."""
    return 10.0**RNG.uniform(-1, 1, n), RNG.uniform(0.5, 3.0, n), RNG.uniform(least, 5.0, n)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_laws_are_inverted_and_weakened(law):
    I = 10.0**RNG.uniform(-5, 1, 100)
    mu, mu_slope = law.stress_ratio(I)
    back, slope = law.inertial_number(mu)
    # Far above I_0 the Jop law is flat, and the error of mu_2 - mu dominates.
    np.testing.assert_allclose(back, I, rtol=1e-11 / np.min(mu_slope))
    np.testing.assert_allclose(slope * mu_slope, 1.0, rtol=1e-9)
    below = np.array([0.0, 0.2, law.mu_s])
    if law in NON_LOCAL.values():
        assert all((part == 0.0).all() for part in law.inertial_number(below))
    weakened, _ = law.weakened(np.array([1.0, 0.99])).stress_ratio(np.full((3, 2), 1e-3))
    assert (weakened[:, 0] == law.stress_ratio(np.asarray(1e-3))[0]).all()
    assert (weakened[:, 1] < weakened[:, 0]).all()


def test_cooperativity_lengths_agree_with_the_paper():
    mu, mu_s, mu_2 = 0.45, 0.3819, 0.6435
    assert LAWS["bingham"].inverse_length_squared(mu)[0] == pytest.approx(abs(mu - mu_s))
    assert LAWS["jop"].inverse_length_squared(mu)[0] == pytest.approx(
        (mu_2 - mu_s) * abs(mu - mu_s) / (mu_2 - mu))
    # At a homogeneous state both are A d / sqrt(b I) (appendix B).
    for law in NON_LOCAL.values():
        mu = law.stress_ratio(np.asarray(0.05))[0]
        assert law.inverse_length_squared(mu)[0] == pytest.approx(0.9377 * 0.05)


@pytest.mark.parametrize("theta", [0.0, 0.5])
@pytest.mark.parametrize("model, name", [
    *((model, law) for model in ("ngf", "ngf_primitive") for law in NON_LOCAL),
    ("li", "bingham"), ("li", "jop"), ("li", "barker_gray")])
def test_derivatives_agree_with_differences(model, name, theta):
    law = LAWS[name]
    gdot, P, g = random_points(least=0.5)

    def response(gdot, P, g):
        return MODELS[model].response(law, np.sqrt(P) / 0.1, gdot, P, g, theta)

    with np.errstate(invalid="ignore", divide="ignore"):
        exact = response(gdot, P, g)
        # The Jop law is undefined beyond mu_2, and F has a kink at mu_s.
        ok = np.isfinite(exact.viscosity.value)
        if model != "ngf_primitive":
            ok &= np.abs(exact.stress_ratio - law.mu_s) > 1e-3
        if model != "li":
            ok &= np.isfinite(exact.source.value) & (exact.stress_ratio < 0.6)
    point = np.array([gdot, P, g])[:, ok]
    exact = response(*point)
    assert point.shape[1] > 20
    for number, suffix in enumerate(("rate", "pressure", "fluidity")):
        step = 1e-6 * point * np.eye(3)[number][:, None]
        high, low = response(*(point + step)), response(*(point - step))
        for quantity in ("viscosity", "source") if model != "li" else ("viscosity",):
            change = getattr(high, quantity).value - getattr(low, quantity).value
            slope = getattr(getattr(exact, quantity), suffix) + 0.0 * change
            scale = np.abs(slope).max() + 1.0
            np.testing.assert_allclose(slope / scale, change / (2.0 * step[number]) / scale,
                                       atol=1e-6)


@pytest.mark.parametrize("theta", [1e-4, 0.8, 1e3])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_elastic_return_of_li_shares_the_rate_between_flow_and_elasticity(law, theta):
    gdot, P, _ = random_points()
    s = np.sqrt(P) / 0.01
    response = MODELS["li"].response(law, s, gdot, P, None, theta)
    plastic = s * response.inertial_number
    np.testing.assert_allclose(response.fluidity * response.stress_ratio, plastic, rtol=1e-12)
    np.testing.assert_allclose(plastic + theta * P * response.stress_ratio, gdot, rtol=1e-9)
    np.testing.assert_allclose(response.viscosity.value * gdot, response.stress_ratio * P,
                               rtol=1e-12)


def test_homogeneous_state_agrees_with_section_4():
    case = cases.create(parameters())
    material, mu = case.material, 0.3819 + 0.9377 * 0.001
    assert case.pressure == material.pressure == pytest.approx(1.0 / (1.0 - mu))
    assert case.fluidity == pytest.approx(1.0 / mu)
    P = np.array([case.pressure])
    response = material.model.response(material.law, material.inverse_time(P), np.array([1.0]), P,
                                     np.array([case.fluidity]), 0.0)
    assert response.source.value[0] == pytest.approx(0.0, abs=1e-12)
    assert response.inertial_number[0] == pytest.approx(0.001)
    with pytest.raises(ParameterError, match="inertial_number 1: .* below 1"):
        cases.create(parameters(inertial_number=1))


@pytest.mark.parametrize("law", NON_LOCAL.values(), ids=NON_LOCAL)
def test_uniform_dynamic_flow_has_the_local_fluidity_and_the_linearised_source_of_ngf(law):
    I = np.geomspace(1e-6, 0.5, 30)
    P = RNG.uniform(0.5, 3.0, I.size)
    mu, s = law.stress_ratio(I)[0], np.sqrt(P) / 0.1
    g = s * I / mu
    steady, primitive = (MODELS[name].response(law, s, g * mu, P, g, 0.0)
                         for name in ("ngf", "ngf_primitive"))
    np.testing.assert_allclose(primitive.source.value, 0.0, atol=1e-14 * g.max())
    for name in ("rate", "pressure", "fluidity"):
        found, expected = (getattr(a.source, name) for a in (primitive, steady))
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-12)
    for name in ("value", "pressure", "fluidity"):
        assert (getattr(primitive.viscosity, name) == getattr(steady.viscosity, name)).all()


@pytest.mark.parametrize("law", NON_LOCAL.values(), ids=NON_LOCAL)
def test_negative_fluidity_returns_to_zero_at_every_stress(law):
    mu, g = np.meshgrid([0.0, 0.3, law.mu_s, 0.5], -np.geomspace(1e-6, 1e3, 20))
    P, size = np.full_like(g, 1.5), 1e-6

    def source(mu, g):
        return MODELS["ngf_primitive"].source(law, 10.0 * np.sqrt(P), mu, P, g)

    F = source(mu, g)
    assert (F.value < 0.0).all() and (F.fluidity > 0.0).all()
    high, low = (source(mu, g * factor).value for factor in (1.0 + size, 1.0 - size))
    np.testing.assert_allclose((high - low) / (2.0 * size * g), F.fluidity, rtol=1e-6)


@pytest.mark.parametrize("law", NON_LOCAL.values(), ids=NON_LOCAL)
def test_zero_fluidity_is_a_dynamic_solution_at_every_stress(law):
    P, theta = np.full(60, 1.5), 0.5
    gdot = np.append(0.0, np.geomspace(1e-6, 0.64, 59)) * theta * P  # mu up to nearly mu_2
    response = MODELS["ngf_primitive"].response(law, np.sqrt(P) / 0.1, gdot, P, np.zeros(60), theta)
    np.testing.assert_allclose(response.stress_ratio, gdot / (theta * P))
    assert (response.source.value == 0.0).all() and (response.source.rate == 0.0).all()
    assert (response.source.pressure == 0.0).all()
    # Disturbances of g = 0 decay below mu_s and grow above.
    above = response.stress_ratio > law.mu_s
    assert above.any() and (np.sign(response.source.fluidity) == np.where(above, -1.0, 1.0)).all()


class Shorter(Bingham):
    """The Bingham law with half the cooperativity length."""

    def inverse_length_squared(self, mu):
        return tuple(4.0 * part for part in super().inverse_length_squared(mu))


def test_a_length_that_changes_the_uniform_fluidity_is_refused():
    with pytest.raises(ParameterError, match="differs from b I_loc"):
        parameters(model="ngf_primitive", law=f"{__file__}:Shorter")
    parameters(model="ngf", law=f"{__file__}:Shorter")


@pytest.mark.parametrize("given, I_1, upper, A_minus, regularised", [
    ((0.342, 0.557, 0.069), 0.00397178, 0.280166, 15642.41, 16.9919),
    ((0.3819, 0.6435, 0.279), 0.0193578, 0.85205, 2962.49, 14.9104)])
def test_barker_gray_has_known_numbers(given, I_1, upper, A_minus, regularised):
    mu_s, mu_2, I_0 = given
    jop, law = Jop(mu_s, mu_2, (mu_2 - mu_s) / I_0), BarkerGray(*given)
    lower, end = (laws.sign_changes(lambda I: laws.ill_posedness(kind, I), 1e-12, 1e4)
                  for kind in (jop, law))
    assert lower == pytest.approx([I_1, upper], rel=3e-6)
    assert law.I_1 == pytest.approx(lower[0], rel=1e-14)
    assert law.A_minus == pytest.approx(A_minus, rel=3e-6)
    assert end == pytest.approx([regularised], rel=3e-6)  # well-posed from 0 on


def test_barker_gray_is_continuous_and_well_posed_at_rest_only_below_alpha_2():
    law = LAWS["barker_gray"]
    below, above = (law.stress_ratio(law.I_1 * (1.0 + e))[0] for e in (-1e-12, 1e-12))
    assert below == pytest.approx(above, rel=1e-10)
    I = np.geomspace(1e-300, 1e-200, 5)
    for alpha, sign in ((1.9, -1.0), (1.99, -1.0), (2.01, 1.0), (2.1, 1.0)):
        other = BarkerGray(0.3819, 0.6435, 0.279, alpha=alpha)
        C = laws.ill_posedness(other, I)
        assert (np.sign(C) == sign).all()


def test_stress_is_rotated_as_a_tensor():
    S, angle = np.array([0.3, -0.3, 0.7]), 0.4
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    rotated = R @ np.array([[S[0], S[2]], [S[2], S[1]]]) @ R.T
    found = PLANE.tensor(PLANE.rotate(PLANE.mandel(S), np.array([angle])))
    np.testing.assert_allclose(found, [rotated[0, 0], rotated[1, 1], rotated[0, 1]], rtol=1e-14)


def test_stress_rate_is_exact_for_quadratics():
    def stress(t):
        return np.full((3, 1), 1.0 + 2.0 * t + 3.0 * t**2)

    factor, S = elasticity.stress_rate(0.2, stress(0.0), 0.1, stress(-0.1))
    np.testing.assert_allclose(factor * (stress(0.2) - S) / 0.2, 2.0 + 6.0 * 0.2, rtol=1e-13)
    factor, S = elasticity.stress_rate(0.2, stress(0.0))
    assert factor == 1.0 and (S == stress(0.0)).all()


def test_logarithmic_strain_is_the_logarithm_of_the_left_stretch():
    """V is the polar factor of F; a rotation has no strain."""
    for d in (2, 3):
        F = np.eye(d)[..., None] + 0.5 * np.random.default_rng(7).uniform(-1, 1, (d, d, 20))
        found = elasticity.logarithmic_strain(F)
        for number in range(20):
            V = polar(F[..., number], side="left")[1]
            np.testing.assert_allclose(expm(found[..., number]), V, atol=1e-12)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    assert np.abs(elasticity.logarithmic_strain(turn)).max() < 1e-15
