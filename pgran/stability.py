"""Linear stability of homogeneous flow in closed form (sections 3, 5, appendix A).

    python -m pgran.stability -wave_vector k1,k2 [-pgran_... options] [-json]
    python -m pgran.stability -cutoff [-base_flow pure_shear|simple_shear] [-json]
    python -m pgran.stability -posedness [-json]
    python -m pgran.stability -specimen [-half_waves n] [-parity sway|barrel] [-json]

prints the growth rate of one wave vector; or the cut-off, the fastest-growing wave vector, the
unstable directions and the critical inertial numbers; or the inertial numbers at which the local
rheology is ill-posed; or the growth rate of a specimen between plates. Wave vectors and growth
rates are dimensionless, as in the paper (`pgran.theory.waves`), unless a name says otherwise.

With -wave_vector, -convection adds the terms of (A 7): `growth_rate` is then the largest real part
of the eigenvalues of A_ik, as in the paper, and `growth_rate_incompressible` that of A_ik on
v.k = 0. -amplification follows the wave vector as the flow turns it, to the time -end: the largest
ln(|v|/|v0|), when it is reached, and the last one.

-pgran_model ngf_primitive depends on the relaxation time t0 in its growth rates and in its fastest
wave vector, but not in the cut-off, the unstable directions and the critical inertial numbers. Its
theory knows neither -convection nor -amplification.
"""

import sys

import numpy as np

from .cli import JSON, as_json, command_option, run_without_petsc
from .options import OptionError
from .theory import specimen, turning, waves
from .theory.waves import BASE_FLOWS, Coefficients

#: The model that -posedness is about.
LOCAL = "li"
OPTIONS = (
    command_option("wave_vector", "floats", "wave vector A d k (sqrt(nu_I) d k for IG), 2 or 3 numbers"),
    command_option("cutoff", "flag", "find the cut-off and the fastest wave vector", False),
    command_option("posedness", "flag", "find where the local rheology is ill-posed in plane flow: C(I) > 0",
        False),
    command_option("specimen", "flag", "growth rate of the specimen between slipping plates", False),
    command_option("base_flow", "str", "velocity gradient: pure_shear, simple_shear, or L0 as 4 or 9 "
        "numbers, row by row", "pure_shear"),
    command_option("convection", "flag", "keep the convective terms of (A 7)", False),
    command_option("amplification", "flag", "follow the turning wave vector", False),
    command_option("end", "float", "time until which it is followed", 1.0, unit="1/gdot0", low=0.0,
        open_low=True),
    command_option("half_waves", "int", "half waves along the specimen", 1, low=1),
    command_option("parity", "str", "whether both faces move the same way or opposite ways", "sway",
        choices=("sway", "barrel")),
    JSON)


def read_base_flow(text):
    """Return L0/gdot0 (n, n) of a name of `BASE_FLOWS`, or of 4 or 9 numbers, row by row.

    Raises `OptionError` where it is neither.
    """
    if text in BASE_FLOWS:
        return BASE_FLOWS[text]
    try:
        found = np.array([float(part) for part in text.split(",")])
    except ValueError:
        found = np.empty(0)
    if found.size not in (4, 9) or not np.isfinite(found).all():
        raise OptionError(f"-base_flow {text}: allowed is {' | '.join(BASE_FLOWS)}, or 4 or 9 "
                          "numbers")
    gradient = found.reshape((2, 2) if found.size == 4 else (3, 3))
    waves.flow_direction(gradient)  # refuses what is no base flow
    D = (gradient + gradient.T) / 2.0
    return gradient / (waves.ROOT_2 * np.sqrt((D * D).sum()))


def read_wave_vector(numbers, dimension=2):
    """Return the wave vector (dimension,) of numbers; raises `OptionError` where it is not one."""
    text = ",".join(f"{number:g}" for number in numbers)
    if len(numbers) != dimension:
        raise OptionError(f"-wave_vector {text}: allowed is {dimension} numbers")
    if not any(numbers):
        raise OptionError(f"-wave_vector {text}: allowed is any but the zero vector")
    return np.array(numbers)


def analyse(parameters, asked):
    """Return the answer to a command line as a dictionary.

    Raises `OptionError`, or ValueError where the theory has no answer.
    """
    law, model = parameters.part("law").of(parameters), parameters.part("model").theory
    given = {"model": parameters.model, "law": parameters.law,
             "inertial_number": parameters.inertial_number}
    questions = [name for name in ("wave_vector", "cutoff", "posedness", "specimen")
                 if getattr(asked, name)]
    if len(questions) != 1:
        raise OptionError("-wave_vector k1,k2, -cutoff, -posedness or -specimen: one of them says "
                          "what is asked")
    for name, questions_of in (
            ("convection", ["wave_vector"]), ("amplification", ["wave_vector"]),
            ("base_flow", ["wave_vector", "cutoff"]), ("half_waves", ["specimen"]),
            ("parity", ["specimen"])):
        changed = getattr(asked, name) != next(row.default for row in OPTIONS if row.name == name)
        if changed and questions[0] not in questions_of:
            raise OptionError(f"-{name}: allowed only with -{' or -'.join(questions_of)}")
    if asked.end != 1.0 and not asked.amplification:
        raise OptionError(f"-end {asked.end:g}: allowed only with -amplification")
    if questions == ["posedness"]:
        return {**given, "model": LOCAL, **posedness(law, parameters.inertial_number)}
    if model is None:
        raise OptionError(f"-pgran_model {parameters.model}: it has no linear theory")
    if questions == ["specimen"]:
        return {**given, **specimen_answer(parameters, asked)}
    coefficients = Coefficients.of_run(parameters)
    gradient = read_base_flow(asked.base_flow)
    N = waves.flow_direction(gradient)
    limit = waves.limit_of_stress_ratio(N)
    given.update(base_flow=asked.base_flow, stress_ratio=float(coefficients.mu),
                 stress_ratio_limit=float(limit),
                 well_posed_pressure=bool(coefficients.mu < limit))
    if model == "ngf_primitive":
        given["relaxation_time"] = parameters.relaxation_time
    rate = float(waves.viscous_rate(coefficients.mu, parameters.A, parameters.phi,
                                    parameters.inertial_number))
    if questions == ["cutoff"]:
        return {**given, **extremes(law, coefficients, N, rate, parameters.A)}
    k = read_wave_vector(asked.wave_vector, len(N))
    return {**given, **wave(k, N, coefficients, gradient, rate, asked)}


def posedness(law, I0):
    """Return C at an inertial number, and the ranges in which the law is ill-posed for LI."""
    ranges = waves.ill_posed_ranges(law)
    found = {"C": float(waves.long_wave_excess(Coefficients.of(law, LOCAL, I0))),
             "well_posed": not any(low <= I0 <= high for low, high in ranges),
             "ill_posed_ranges": [[_number(low), _number(high)] for low, high in ranges]}
    for name in ("I_1", "A_minus"):
        if hasattr(law, name):
            found[name] = float(getattr(law, name))
    return found


def specimen_answer(parameters, asked):
    """Return the growth rate of a specimen, as `pgran.theory.specimen.growth_rate` tells."""
    given = parameters.part("case")(parameters).specimen  # without a mesh, which may not fit
    if given is None:
        raise OptionError("-specimen: the closed form holds for a specimen between slipping plates "
                          f"with the models {', '.join(specimen.MODELS)}, not for "
                          f"-pgran_case {parameters.case} with these options")
    rate = complex(specimen.growth_rate(**given, half_waves=asked.half_waves,
                                        parity=asked.parity))
    answer = {"width": given["width"], "height": given["height"],
              "half_waves": asked.half_waves, "parity": asked.parity,
              "growth_rate_gdot0": rate.real}
    return {**answer, "frequency_gdot0": rate.imag} if rate.imag else answer


def extremes(law, coefficients, N, rate, A):
    """Return cut-off, fastest wave vector, unstable directions and critical inertial numbers."""
    k_cut = float(waves.cutoff(coefficients, N))
    k, value, m = (float(part) for part in waves.fastest(coefficients, N))
    angles = sorted(float(waves.direction_angle(part, N))
                    for part in waves.unstable_directions(coefficients, N))
    return {"k_cut": _number(k_cut),
            "cutoff_wavelength": _number(2.0 * np.pi * A / k_cut if k_cut else np.inf),
            "fastest_growth_rate": _number(value),
            "fastest_growth_rate_gdot0": _number(value * rate),
            "fastest_wave_number": _number(k),
            "fastest_angle": _number(waves.direction_angle(m, N)),
            "fastest_directions": ([] if not np.isfinite(m)
                                   else waves.directions(m, N).tolist()),
            "unstable_angles": [_number(angle) for angle in angles],
            "critical_inertial_numbers": waves.critical_inertial_numbers(law, N=N).tolist()}


def wave(k, N, coefficients, gradient, rate, asked):
    """Return the growth of one wave vector, with what else was asked of it."""
    value = waves.growth_rates(k, N, coefficients)[0].real
    found = {"wave_vector": k.tolist(), "convection": asked.convection,
             "denominator": float(waves.tensor(k, N, *coefficients.r_q(k @ k))[1])}
    if asked.convection:
        full, reduced = (function(k, N, coefficients, 1.0 / rate, gradient)[0].real for function
                         in (waves.tensor_growth_rates, waves.growth_rates))
        found["growth_rate_incompressible"] = _number(reduced)
        value = full
    found["growth_rate"] = _number(value)
    if coefficients.model != "ig":
        found["growth_rate_gdot0"] = _number(value * rate)
    if asked.amplification:
        end = asked.end * rate
        largest, when = turning.largest_amplification(k, N, coefficients, gradient, 1.0 / rate,
                                                      end)
        _, _, last = turning.amplitude(k, N, coefficients, gradient, 1.0 / rate, end)
        found.update(end=asked.end, largest_log_amplification=largest,
                     largest_amplification_time=when / rate,
                     final_log_amplification=float(last[-1]))
    return found


def _number(value):
    """A float for JSON, None where it is not a finite number."""
    return float(value) if np.isfinite(value) else None


def run(parameters, asked):
    """Answer a command line on the terminal."""
    found = analyse(parameters, asked)
    if asked.json:
        print(as_json(found))
        return
    if asked.posedness:
        print("the local rheology LI in plane flow, whatever -pgran_model is:")
    for key, value in found.items():
        text = "not a number: the denominator vanishes, growth is unbounded, or all is stable" \
            if value is None else f"{value:.10g}" if isinstance(value, float) else value
        print(f"{key:28} {text}")
    if not found.get("well_posed_pressure", True):
        print("warning: mu_loc(I0) violates (3.19): the denominator of (3.16) changes sign")


def main(arguments):
    """Answer the command line ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "stability", run, __doc__, OPTIONS, runs=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
