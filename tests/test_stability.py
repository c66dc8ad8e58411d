"""Linear theory of waves: comparison with the unreduced equations and with the paper."""

import json

import numpy as np
import pytest
from conftest import ROOT, parameters, run_ranks
from scipy.integrate import solve_ivp
from test_material import NON_LOCAL as LAWS, Shorter

from pgran import stability
from pgran.material.laws.bingham import Bingham
from pgran.material.laws.jop import Jop
from pgran.material.models.ngf_primitive import NGFPrimitive
from pgran.theory import specimen, turning, waves
from pgran.theory.waves import BASE_FLOWS, Coefficients

PURE = waves.flow_direction(BASE_FLOWS["pure_shear"])


@pytest.fixture
def output(capsys):
    """``output(*arguments)``: the JSON output of the command."""
    def run(*arguments):
        assert stability.main([*arguments, "-json"]) == 0
        return json.loads(capsys.readouterr().out)

    return run


def random_flow(rng, n):
    """A velocity gradient (n, n) without divergence."""
    L = rng.standard_normal((n, n))
    return L - np.trace(L) / n * np.eye(n)


def unreduced_growth(k, N, coefficients, xi_square, convection=0.0, gradient=0.0):
    """Growth rates from the equations (3.8)-(3.10) or, with IG, (C 8), (3.8).

    Unknowns v, P, g in units with eta0 = gdot0 = 1, so P0 = 1/mu and A^2 d^2 phi rho_s = 1. With
    convection, (A 2) along the turning wave vector: -c L v, and k.v = 0 kept by
    k.dv/dt = -v.dk/dt = c v.L^T k, dk/dt = -c L^T k.
    """
    n, mu, nu = k.size, float(coefficients.mu), float(coefficients.nu)
    square, Nk, root = k @ k, N @ k, np.sqrt(2.0)
    L = convection * gradient + np.zeros((n, n))
    C = -square * np.eye(n) - L + 0.0j
    if coefficients.model == "ngf":
        stress = 1j * (-k + root * mu * Nk)             # of P
        weakening = -1j * root * mu * Nk                # of g
        # (1/nu + xi^2 k^2) g = flow.v + P/2
        flow = 1j * root / mu * (1.0 - nu) / nu * Nk
        C += np.outer(weakening, flow) / (1.0 / nu + xi_square * square)
        stress = stress + weakening * 0.5 / (1.0 / nu + xi_square * square)
    else:
        non_local = square if coefficients.model == "ig" else 0.0
        stress = 1j * (-k + root * mu * (1.0 - nu / 2.0 - non_local / 2.0) * Nk)
        C += 2.0 * (1.0 - nu - non_local) * np.outer(Nk, Nk)
    # P from the constraint: k.(C v + stress P) = (L^T k).v
    A = C + np.outer(stress, L.T @ k - k @ C) / (k @ stress)
    basis = waves.transverse_basis(k)
    return np.linalg.eigvals(basis @ A @ basis.T)


@pytest.mark.parametrize("model", ["ngf", "li", "ig"])
def test_pure_shear_form_is_the_tensor(model):
    k = np.random.default_rng(1).uniform(-0.3, 0.3, (50, 2))
    coefficients = Coefficients.of(LAWS["jop"], model, 0.001)
    np.testing.assert_allclose(waves.pure_shear_growth(*k.T, coefficients),
                               waves.growth_rates(k, PURE, coefficients)[:, 0],
                               rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("convective", [False, True])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("model", ["ngf", "li", "ig"])
def test_growth_rates_agree_with_the_unreduced_equations(model, name, dimension, convective):
    rng, done = np.random.default_rng([dimension, len(name), len(model)]), 0
    while done < 40:
        mu_s, b, rise = rng.uniform(0.2, 0.6), rng.uniform(0.3, 1.2), rng.uniform(0.1, 0.4)
        law = Bingham(mu_s, b) if name == "bingham" else Jop(mu_s, mu_s + rise, b)
        coefficients = Coefficients.of(law, model, 10.0**rng.uniform(-4, -0.5))
        flow = random_flow(rng, dimension)
        convection = (rng.uniform(0.0, 1.0), flow) if convective else ()
        N = waves.flow_direction(flow)
        k = rng.standard_normal(dimension) * 10.0**rng.uniform(-2, 1)
        if abs(waves.tensor(k, N, *coefficients.r_q(k @ k))[1]) < 1e-2:
            continue
        # xi0 in units of A d from its definition (2.8), not from appendix B
        xi_square = 1.0 / law.inverse_length_squared(coefficients.mu)[0]
        expected = unreduced_growth(k, N, coefficients, xi_square, *convection)
        found = waves.growth_rates(k, N, coefficients, *convection)
        for value in expected:
            assert np.abs(found - value).min() < 1e-8 * (np.abs(expected).max() + k @ k)
        done += 1


@pytest.mark.parametrize("model", ["ngf", "li", "ig"])
def test_short_waves_approach_the_asymptotic_tensor(model):
    coefficients, k = Coefficients.of(LAWS["jop"], model, 0.01), 1e5 * np.array([0.8, 0.5])
    A, _ = waves.tensor(k, PURE, *coefficients.r_q(k @ k))
    np.testing.assert_allclose(A, waves.asymptotic_tensor(k, PURE, coefficients),
                               atol=1e-6 * (k @ k))


def test_numbers_of_the_paper():
    k, rate, _ = waves.fastest(Coefficients.of(LAWS["bingham"], "ngf", 0.001))
    assert (k, rate) == (pytest.approx(0.0837, abs=5e-5), pytest.approx(1.283e-4, rel=5e-4))
    for law in LAWS.values():
        coefficients = Coefficients.of(law, "ngf", 0.0)
        k_cut = waves.cutoff(coefficients)
        assert k_cut == pytest.approx(0.123, abs=5e-4)
        assert 2.0 * np.pi * 0.48 / k_cut == pytest.approx(24.5, abs=0.1)
        angles = [waves.direction_angle(m, PURE)
                  for m in waves.unstable_directions(coefficients)]
        assert sorted(angles) == pytest.approx([33.8, 45.0], abs=0.05)
        assert waves.direction_angle(waves.fastest(coefficients)[2], PURE) \
            == pytest.approx(39.3, abs=0.05)


@pytest.mark.parametrize("t0", [None, 1e-12, 1e-4, 0.1, 1e4])
@pytest.mark.parametrize("name, I0", [
    ("bingham", 1e-4), ("bingham", 0.012), ("jop", 1e-3), ("jop", 0.012)])
def test_cutoff_and_fastest_mode_are_extrema_over_wave_vectors(name, I0, t0):
    coefficients = (primitive(LAWS[name], I0, t0)[0] if t0 else
                    Coefficients.of(LAWS[name], "ngf", I0))
    angle = np.radians(np.linspace(0.0, 90.0, 1801))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def rates(k):
        return waves.growth_rates(k, PURE, coefficients)[..., 0]

    k_cut, (size, rate, m) = float(waves.cutoff(coefficients)), waves.fastest(coefficients)
    assert rates(k_cut * (1.0 - 1e-4) * direction).max() > 0.0
    assert rates(k_cut * (1.0 + 1e-4) * direction).max() < 0.0
    sizes = np.append(np.geomspace(1e-5, 1.0, 100) * k_cut, size * np.linspace(0.98, 1.02, 21))
    largest = rates(sizes[:, None, None] * direction).max()
    assert rate * (1.0 - 1e-4) < largest <= rate * (1.0 + 1e-9)
    np.testing.assert_allclose(rates(size * waves.directions(m, PURE)), rate, rtol=1e-9)


def test_extrema_in_three_dimensions_lie_in_the_extreme_principal_plane():
    rng = np.random.default_rng(7)
    coefficients = Coefficients.of(LAWS["bingham"], "ngf", 0.001)
    for _ in range(5):
        N = waves.flow_direction(random_flow(rng, 3))
        k_cut = float(waves.cutoff(coefficients, N))
        directions = rng.standard_normal((20000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        if k_cut == 0.0:
            assert (waves.growth_rates(1e-3 * directions, N, coefficients) <= 1e-12).all()
            continue
        assert (waves.growth_rates(1.001 * k_cut * directions, N, coefficients) < 0.0).all()
        size, rate, m = (float(part) for part in waves.fastest(coefficients, N))
        assert waves.growth_rates(size * directions, N, coefficients).max() <= rate
        k = size * waves.directions(m, N)[0]
        assert waves.growth_rates(k, N, coefficients)[0] == pytest.approx(rate, rel=1e-9)


@pytest.mark.parametrize("name, expected", [("bingham", 1), ("jop", 2)])
def test_critical_inertial_numbers_bound_the_unstable_range(name, expected):
    law = LAWS[name]
    critical = waves.critical_inertial_numbers(law)
    assert len(critical) == expected
    for I in critical:
        below, above = (waves.cutoff(Coefficients.of(law, "ngf", I * (1.0 + e)))
                        for e in (-1e-7, 1e-7))
        assert (below > 0.0) != (above > 0.0)
    if name == "bingham":  # the paper reads 0.0158 for b I0 off its figure
        assert 0.9377 * critical[0] == pytest.approx(0.0158, rel=0.01)


def test_growth_is_nan_where_the_denominator_vanishes_and_the_cutoff_beyond_3_19():
    coefficients = Coefficients.of(LAWS["jop"], "ig", 0.1)
    # On k1 = 0 it vanishes for |k|^2 = 2 (1 - nu/2 + 1/mu).
    size = np.sqrt(2.0 * (1.0 - coefficients.nu / 2.0 + 1.0 / coefficients.mu))
    k = np.array([[0.0, float(size)], [0.0, 1.1 * float(size)]])
    rates = waves.growth_rates(k, PURE, coefficients)[:, 0]
    assert np.isnan(rates[0]) and np.isfinite(rates[1])
    coefficients = Coefficients.of(LAWS["bingham"], "ngf", np.array([0.5, 1.0]))
    assert (coefficients.mu > 1.0).tolist() == [False, True]
    for found in (waves.cutoff(coefficients), waves.fastest(coefficients)[1]):
        assert np.isnan(found[1])


def test_amplitude_in_three_dimensions_solves_the_equation_of_the_wave():
    number, wide = 0.05, np.diag([0.5, -0.5, 0.0])
    coefficients, k = Coefficients.of(LAWS["bingham"], "ngf", 0.1), np.array([0.3, 0.2, 0.1])
    path = turning.turning_wave_vector(k, wide, number, np.array([10.0]))
    np.testing.assert_allclose(path[0], [k[0] * np.exp(-0.25), k[1] * np.exp(0.25), k[2]])
    N = waves.flow_direction(wide)
    _, logarithm = turning.amplitude(k, N, coefficients, wide, number, 10.0)
    v = waves.modes(k, N, coefficients, number, wide)[1][0].real

    def slope(t, v):
        turned = turning.turning_wave_vector(k, wide, number, np.array([t]))[0]
        return waves.tensor(turned, N, *coefficients.r_q(turned @ turned), number, wide)[0] @ v

    v = solve_ivp(slope, (0.0, 10.0), v / np.linalg.norm(v), rtol=1e-11, atol=1e-13).y[:, -1]
    assert logarithm[-1] == pytest.approx(np.log(np.linalg.norm(v)), abs=1e-7)
    assert abs(v @ path[0]) < 1e-9  # v.k = 0


@pytest.mark.parametrize("arguments, message", [
    (["-wave_vector", "0,0"], "-wave_vector 0,0"),
    (["-cutoff", "-base_flow", "1,0,0,1"], "divergence"),
    (["-cutoff", "-base_flow", "0,1,-1,0"], "does not deform"),
    (["-cutoff", "-base_flow", "1,0"], "-base_flow 1,0: "),
    (["-wave_vector", "1,1", "-amplification", "-end", "0"], "number > 0"),
    (["-cutoff", "-pgran_law", "jop", "-pgran_mu_2", "0.2"], "-pgran_mu_2 0.2: must exceed"),
    (["-cutoff", "-pgran_model", "ig"], "model ig: its growth rate is unbounded"),
    (["-json"], "-cutoff, -posedness or -specimen"),
    (["-cutoff", "-convection"], "-convection: "),
    (["-cutoff", "-pgran_law", "barker_gray"], "the law BarkerGray has no cooperativity length"),
    (["-specimen", "-pgran_plates_slip", "false"], "-specimen: "),
    (["-wave_vector", "1,1", "-convection", "-pgran_model", "ngf_primitive"], "model "
     "ngf_primitive: the theory does not include convection"),
    (["-specimen", "-pgran_case", "periodic"], "-pgran_case periodic"),
    (["-specimen", "-parity", "odd"], "-parity odd: "),
])
def test_invalid_command_lines_name_the_option(arguments, message, capsys):
    assert stability.main(arguments) == 1
    assert message in capsys.readouterr().err


def test_invalid_arguments_are_refused():
    for arguments, message in (
            (("ngf", 1e-3, 1.0), "the model ngf has none"),
            (("ngf_primitive", 1e-3), "the model ngf_primitive needs one"),
            (("ngf_primitive", 1e-3, 0.0), "must be a number > 0")):
        with pytest.raises(ValueError, match=message):
            Coefficients.of(LAWS["jop"], *arguments)


def test_command_finds_cutoff_growth_and_specimen(output):
    found = output("-cutoff")
    assert found["k_cut"] == pytest.approx(0.1189, abs=1e-4)
    assert found["fastest_growth_rate_gdot0"] == pytest.approx(355.374, rel=1e-5)
    assert found["fastest_angle"] == pytest.approx(39.3, abs=0.1)
    found = output("-wave_vector", "0.0648,0.0530")
    assert found["growth_rate"] == pytest.approx(1.283e-4, rel=1e-3)
    assert output("-specimen", "-pgran_height", "60", "-half_waves", "2", "-parity", "barrel")[
        "growth_rate_gdot0"] == pytest.approx(16.495, rel=1e-4)
    found = output("-specimen", "-pgran_width", "25")  # not a multiple of the element size
    assert found["width"] == 25.0 and found["height"] == 75.0
    assert found["growth_rate_gdot0"] == pytest.approx(specimen.growth_rate(
        LAWS["bingham"], "ngf", inertial_number=0.001, width=25.0, height=75.0), rel=1e-9)


def test_command_accepts_any_base_flow_and_follows_the_turning_wave_vector(output):
    shear = "-wave_vector", "0.0837,0.0084", "-pgran_law", "jop", "-amplification", "-base_flow"
    one, two = (output(*shear, flow) for flow in ("simple_shear", "0,2,0,0"))
    assert one["growth_rate"] == pytest.approx(two["growth_rate"])
    assert one["largest_log_amplification"] == pytest.approx(16.29, abs=0.01)
    assert one["final_log_amplification"] < -1e4
    assert output("-cutoff", "-base_flow", "1,0,0,0,-0.5,0,0,0,-0.5")[
        "stress_ratio_limit"] == pytest.approx(np.sqrt(3.0) / 2.0)


@pytest.mark.parametrize("I0", [0.0, 1e-3])
def test_theory_uses_the_cooperativity_length_of_the_law(I0):
    found = [float(waves.cutoff(Coefficients.of(kind(0.3819, 0.9377), "ngf", I0)))
             for kind in (Bingham, Shorter)]
    assert found[1] == pytest.approx(2.0 * found[0], rel=1e-7)


def test_spread_agrees_with_appendix_b_down_to_zero_inertial_number():
    I = np.concatenate([[0.0], np.geomspace(1e-14, 1.0, 60)])
    for law in LAWS.values():
        mu, slope = law.stress_ratio(I)
        np.testing.assert_allclose(Coefficients.of(law, "ngf", I).spread, slope / (law.b * mu),
                                   rtol=3e-8)


@pytest.mark.parametrize("plane", [(0, 1), (1, 2), (0, 2)])
def test_fastest_direction_lies_in_the_plane_of_the_flow(plane, output):
    gradient = np.zeros((3, 3))
    gradient[plane[0], plane[0]], gradient[plane[1], plane[1]] = 0.5, -0.5
    found = output("-cutoff", "-base_flow", ",".join(map(str, gradient.ravel())))
    both = np.array(found["fastest_directions"])
    assert np.linalg.norm(both[:, plane], axis=1) == pytest.approx(1.0)
    angles = np.degrees(np.arccos(np.abs(both[:, 0])))
    assert found["fastest_angle"] == pytest.approx(angles.min(), abs=1e-6)
    assert found["fastest_angle"] == pytest.approx(39.268 if 0 in plane else 90.0, abs=1e-3)
    N, coefficients = waves.flow_direction(gradient), Coefficients.of(LAWS["bingham"], "ngf", 1e-3)
    size, rate, _ = waves.fastest(coefficients, N)
    assert waves.growth_rates(size * both, N, coefficients)[:, 0] == pytest.approx(rate)


def test_convective_growth_is_given_for_all_and_for_incompressible_modes(output):
    gradient = BASE_FLOWS["simple_shear"]
    N, k = waves.flow_direction(gradient), np.array([0.3, 0.5])
    coefficients = Coefficients.of(LAWS["jop"], "ngf", 1.0)
    number = 1.0 / float(waves.viscous_rate(coefficients.mu, 0.48, 0.6, 1.0))
    A, _ = waves.tensor(k, N, *coefficients.r_q(k @ k), number, gradient)
    n = np.array([k[1], -k[0]]) / np.linalg.norm(k)
    found = output("-wave_vector", "0.3,0.5", "-base_flow", "simple_shear", "-convection",
                   "-pgran_law", "jop", "-pgran_inertial_number", "1")
    assert found["growth_rate"] == pytest.approx(np.linalg.eigvals(A).real.max(), rel=1e-12)
    assert found["growth_rate_incompressible"] == pytest.approx(n @ A @ n, rel=1e-12)


def test_posedness_is_known_for_any_law(output):
    example = f"{ROOT / 'docs/examples/power_law.py'}:PowerLaw"
    for law, well_posed, upper in (("jop", False, 0.852), ("barker_gray", True, 14.9104),
                                   (example, True, None)):
        I_0 = ["-pgran_I_0", "0.279"] if law != example else []
        found = output("-posedness", "-pgran_law", law, *I_0)
        assert found["well_posed"] == well_posed == (found["C"] < 0.0)
        if upper:
            assert found["ill_posed_ranges"][-1][0] == pytest.approx(upper, rel=1e-3)
        assert found["model"] == "li" and found["law"] == law
    assert found["ill_posed_ranges"][0][0] == 0.0  # mu tends to mu_s and its slope to 0


def test_theory_imports_neither_petsc_nor_mpi():
    code = ("import sys, pgran.stability; "
            "sys.exit(any(m in sys.modules for m in ('petsc4py', 'mpi4py')))")
    run_ranks(0, "-c", code)


def discrete_growth(k, N, law, I0, t0, phi=0.6, A=0.48):
    """Growth rates (n,), gdot0, of the linearised balances of momentum, volume and fluidity.

    Unknowns v, P, g of a wave exp(i k.x), ``k`` (n,) in 1/d: lambda B u = C u. The derivatives of
    viscosity and source are differences of the response of the model near homogeneous flow.
    """
    n, model, P0 = k.size, NGFPrimitive(A, t0), 1.7
    mu = law.stress_ratio(np.asarray(I0))[0]
    base, D0 = np.array([1.0, P0, 1.0 / mu]), N / np.sqrt(2.0)

    def response(gdot, P, g):
        found = model.response(law, np.sqrt(P / P0) / I0, np.asarray(gdot), P, g, 0.0)
        return np.array([found.viscosity.value, found.source.value])

    assert abs(response(*base)[1]) < 1e-12
    slopes = np.array([(response(*base + step) - response(*base - step)) / (2.0 * step.sum())
                       for step in np.diag(1e-5 * base)]).T
    change = np.zeros((3, n + 2), dtype=complex)  # of gdot, P and g
    change[0, :n] = 2.0j * D0 @ k
    change[1, n] = change[2, n + 1] = 1.0
    viscosity, source = slopes @ change
    C, B = np.zeros((n + 2, n + 2), dtype=complex), np.zeros((n + 2, n + 2))
    B[:n, :n] = phi * I0**2 * P0 * np.eye(n)
    B[n + 1, n + 1] = t0
    # div (2 eta D') = -eta (k k + |k|^2) v
    C[:n, :n] = -response(*base)[0] * (np.outer(k, k) + k @ k * np.eye(n))
    C[:n] += np.outer(2.0j * D0 @ k, viscosity)
    C[:n, n] -= 1j * k
    C[n, :n] = 1j * k
    C[n + 1] = -source
    C[n + 1, n + 1] -= A**2 * (k @ k)
    # Shift and invert: the two infinite eigenvalues become zeros.
    inverse = np.linalg.eigvals(np.linalg.solve(C - B / t0, B))
    values = 1.0 / t0 + 1.0 / inverse[np.argsort(-np.abs(inverse))[:n]]
    return values[np.argsort(-values.real)]


def primitive(law, I0, t0):
    """The coefficients and the rate eta0/(A^2 d^2 phi rho_s) in gdot0."""
    rate = float(waves.viscous_rate(law.stress_ratio(np.asarray(I0))[0], 0.48, 0.6, I0))
    return Coefficients.of(law, "ngf_primitive", I0, t0 * rate), rate


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", LAWS)
def test_dynamic_growth_rates_agree_with_the_linearised_model(name, dimension):
    rng = np.random.default_rng([dimension, len(name)])
    for t0 in np.geomspace(1e-5, 1e3, 60):
        I0 = 10.0**rng.uniform(-3, -0.7)
        N = waves.flow_direction(random_flow(rng, dimension))
        k = rng.standard_normal(dimension) * 10.0**rng.uniform(-2, 0)
        coefficients, rate = primitive(LAWS[name], I0, t0)
        found = waves.growth_rates(k, N, coefficients) * rate
        expected = discrete_growth(k / 0.48, N, LAWS[name], I0, t0)
        assert found.shape == (dimension,)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 / t0)


@pytest.mark.parametrize("name, I0", [("bingham", 1e-3), ("jop", 0.01)])
def test_inertial_numbers_and_relaxation_times_broadcast(name, I0):
    one, _ = primitive(LAWS[name], I0, 1e4)
    many = Coefficients.of(LAWS[name], "ngf_primitive", np.array([[I0], [0.1]]),
                           np.array([1e2, one.relaxation, 1e8]))
    rates = waves.fastest(many)[1]
    assert np.isnan(rates[1]).all()
    assert rates[0, 1] == pytest.approx(waves.fastest(one)[1], rel=1e-9)


def test_command_knows_dynamic_ngf(output):
    options = "-pgran_model", "ngf_primitive", "-pgran_relaxation_time", "0.1"
    wave, found = output(*options, "-wave_vector", "0.05,0.05"), output(*options, "-cutoff")
    steady, k = output("-cutoff"), np.array([0.05, 0.05])
    expected = discrete_growth(k / 0.48, PURE, LAWS["bingham"], 1e-3, 0.1)[0].real
    assert wave["growth_rate_gdot0"] == pytest.approx(expected, rel=1e-7)
    assert wave["relaxation_time"] == 0.1
    assert all(found[key] == steady[key] for key in
               ("k_cut", "unstable_angles", "critical_inertial_numbers"))
    assert found["fastest_growth_rate_gdot0"] == pytest.approx(0.138652, rel=1e-5)
    p = parameters(model="ngf_primitive", relaxation_time=0.2, law="jop")
    assert Coefficients.of_run(p).relaxation == primitive(LAWS["jop"], 1e-3, 0.2)[0].relaxation
