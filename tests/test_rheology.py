"""The laws invert each other, derivatives are exact, and the elastic return solves its equation."""

import numpy as np
import pytest

from pgran import rheology
from pgran.options import OptionError, read

RNG = np.random.default_rng(3)
LAWS = {"bingham": rheology.Bingham(0.3819, 0.9377), "jop": rheology.Jop(0.3819, 0.6435, 0.9377)}


def random_points(n=200, least=0.0):
    """gdot, P and g over wide ranges."""
    return 10.0**RNG.uniform(-1, 1, n), RNG.uniform(0.5, 3.0, n), RNG.uniform(least, 5.0, n)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_law_and_its_inverse_agree(law):
    I = 10.0**RNG.uniform(-5, 1, 100)
    mu, mu_slope = law.stress_ratio(I)
    back, slope = law.inertial_number(mu)
    # Far above I_0 the Jop law is flat, and its inverse loses the digits that mu_2 - mu loses.
    np.testing.assert_allclose(back, I, rtol=1e-11 / np.min(mu_slope))
    np.testing.assert_allclose(slope * mu_slope, 1.0, rtol=1e-9)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_nothing_flows_locally_up_to_the_yield_value(law):
    mu = np.array([0.0, 0.2, law.mu_s])
    assert (law.inertial_number(mu)[0] == 0.0).all()
    assert (law.inertial_number(mu)[1] == 0.0).all()


def test_cooperativity_lengths_are_those_of_the_paper():
    mu, mu_s, mu_2 = 0.45, 0.3819, 0.6435
    assert LAWS["bingham"].inverse_length_squared(mu)[0] == pytest.approx(abs(mu - mu_s))
    assert LAWS["jop"].inverse_length_squared(mu)[0] == pytest.approx(
        (mu_2 - mu_s) * abs(mu - mu_s) / (mu_2 - mu))
    # At a homogeneous state both are A d / sqrt(b I) (appendix B).
    for law in LAWS.values():
        mu = law.stress_ratio(np.asarray(0.05))[0]
        assert law.inverse_length_squared(mu)[0] == pytest.approx(0.9377 * 0.05)


@pytest.mark.parametrize("theta", [0.0, 0.5])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("model", ["ngf", "li"])
def test_derivatives_are_those_of_the_values(model, name, theta):
    law = LAWS[name]
    gdot, P, g = random_points(least=0.5)

    def answer(gdot, P, g):
        return rheology.ngf(law, np.sqrt(P) / 0.1, gdot, P, g, theta) if model == "ngf" else \
            rheology.li(law, np.sqrt(P) / 0.1, gdot, P, theta)

    with np.errstate(invalid="ignore", divide="ignore"):
        exact = answer(gdot, P, g)
        # A law that ends at mu_2 answers nothing beyond; a kink has no derivative.
        ok = np.isfinite(exact.viscosity) & (np.abs(exact.stress_ratio - law.mu_s) > 1e-3)
        if model == "ngf":
            ok &= np.isfinite(exact.source) & (exact.stress_ratio < 0.6)
    gdot, P, g = gdot[ok], P[ok], g[ok]
    exact = answer(gdot, P, g)
    assert gdot.size > 20
    for quantity in ("viscosity", "source") if model == "ngf" else ("viscosity",):
        for number, suffix in enumerate(("rate", "pressure", "fluidity")):
            if model == "li" and suffix == "fluidity":
                continue
            arguments = [np.array([gdot, P, g]) for _ in range(2)]
            size = 1e-6 * arguments[0][number]
            arguments[0][number] += size
            arguments[1][number] -= size
            high, low = (getattr(answer(*a), quantity) for a in arguments)
            slope = getattr(exact, f"{quantity}_{suffix}") + 0.0 * gdot
            scale = np.abs(slope).max() + 1.0
            np.testing.assert_allclose(slope / scale, (high - low) / (2.0 * size) / scale,
                                       atol=1e-6)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_elastic_return_of_li_shares_the_rate_between_flow_and_elasticity(law):
    gdot, P, _ = random_points()
    theta, s = 0.8, np.sqrt(P) / 0.01
    answer = rheology.li(law, s, gdot, P, theta)
    plastic = s * answer.inertial_number
    np.testing.assert_allclose(answer.fluidity * answer.stress_ratio, plastic, rtol=1e-12)
    np.testing.assert_allclose(plastic + theta * P * answer.stress_ratio, gdot, rtol=1e-9)
    np.testing.assert_allclose(answer.viscosity * gdot, answer.stress_ratio * P, rtol=1e-12)


def test_stiff_elasticity_recovers_the_flow_rule():
    gdot, P, g = random_points(least=0.5)
    rigid, stiff = (rheology.ngf(LAWS["bingham"], 10.0, gdot, P, g, theta) for theta in (0, 1e-10))
    np.testing.assert_allclose(rigid.viscosity, P / g)
    np.testing.assert_allclose(stiff.viscosity, rigid.viscosity, rtol=1e-8)
    np.testing.assert_allclose(rigid.stress_ratio, gdot / g)


def test_homogeneous_state_is_the_one_of_section_4():
    material = rheology.material_of(read({}))
    mu = 0.3819 + 0.9377 * 0.001
    assert material.pressure == pytest.approx(1.0 / (1.0 - mu))
    assert material.fluidity == pytest.approx(1.0 / mu)
    P = np.array([material.pressure])
    answer = rheology.ngf(material.law, material.inverse_time(P), np.array([1.0]), P,
                          np.array([material.fluidity]), 0.0)
    assert answer.source[0] == pytest.approx(0.0, abs=1e-12)
    assert answer.inertial_number[0] == pytest.approx(0.001)


def test_inertial_numbers_beyond_plane_strain_are_refused():
    with pytest.raises(OptionError, match="-pgran_inertial_number 1: .* below 1"):
        rheology.material_of(read({"pgran_inertial_number": "1"}))
