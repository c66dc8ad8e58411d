"""Linear stability of homogeneous flow (sections 3 and 5, appendix A).

    python -m pgran.stability -wave_vector k1,k2 [-pgran_... options] [-json]
    python -m pgran.stability -cutoff [-base_flow pure_shear|simple_shear] [-json]
    python -m pgran.stability -posedness [-json]
    python -m pgran.stability -specimen [-half_waves n] [-parity sway|barrel] [-json]

Wave vectors A d k and growth rates are dimensionless as in the paper; names that end in _gdot0 are
in units of gdot0. With -convection, `growth_rate` is the largest real part of the eigenvalues of
A_ik, as in the paper, and `growth_rate_incompressible` the same for A_ik restricted to v.k = 0.
-amplification follows the wave vector, which the flow turns, until the time -end, and prints the
largest ln(|v|/|v0|), its time, and the final value. Neither is available for ngf_primitive.
"""

import sys

import numpy as np

from .cli import JSON, as_json, run_without_petsc
from .options import OptionError, command_option
from .theory import specimen, turning, waves
from .theory.waves import BASE_FLOWS, Coefficients

OPTIONS = (
    command_option("wave_vector", "floats", "wave vector A d k (IG: sqrt(nu_I) d k), 2 or 3 "
                   "numbers"),
    command_option("cutoff", "flag", "cut-off, fastest wave vector, unstable directions and "
                   "critical inertial numbers", False),
    command_option("posedness", "flag", "inertial numbers where LI is ill-posed: C(I) > 0", False),
    command_option("specimen", "flag", "growth rate of a specimen between slipping plates", False),
    command_option("base_flow", "str", "velocity gradient: pure_shear, simple_shear, or L0 as 4 "
                   "or 9 numbers, row by row", "pure_shear"),
    command_option("convection", "flag", "include the convective terms of (A 7)", False),
    command_option("amplification", "flag", "follow the turning wave vector", False),
    command_option("end", "float", "final time of -amplification", 1.0, unit="1/gdot0", low=0.0,
                   open_low=True),
    command_option("half_waves", "int", "half waves along the specimen", 1, low=1),
    command_option("parity", "str", "whether both faces move the same way (sway) or opposite ways "
                   "(barrel)", "sway", choices=specimen.PARITIES),
    JSON)
#: Options that require one of others.
NEEDS = {"convection": ("wave_vector",), "amplification": ("wave_vector",),
         "end": ("amplification",), "base_flow": ("wave_vector", "cutoff"),
         "half_waves": ("specimen",), "parity": ("specimen",)}


def read_base_flow(text):
    """Return L0/gdot0 (n, n) of a name of `BASE_FLOWS`, or of 4 or 9 numbers, row by row."""
    if text in BASE_FLOWS:
        return BASE_FLOWS[text]
    try:
        numbers = np.array(text.split(","), dtype=float)
        gradient = numbers.reshape((2, 2) if numbers.size == 4 else (3, 3))
    except ValueError:
        raise OptionError(f"-base_flow {text}: expected one of: {', '.join(BASE_FLOWS)}, or 4 or 9 "
                          "numbers") from None
    waves.flow_direction(gradient)  # raises ValueError unless it is a base flow
    D = (gradient + gradient.T) / 2.0
    return gradient / (waves.ROOT_2 * np.sqrt((D * D).sum()))


def analyse(parameters, args):
    """Return the results that a command line requests as a dictionary."""
    requested = [name for name in ("wave_vector", "cutoff", "posedness", "specimen")
                 if getattr(args, name)]
    if len(requested) != 1:
        raise OptionError("-wave_vector k1,k2, -cutoff, -posedness or -specimen: exactly one of "
                          "them is required")
    defaults = {option.name: option.default for option in OPTIONS}
    for name, others in NEEDS.items():
        if getattr(args, name) != defaults[name] and not any(getattr(args, o) for o in others):
            raise OptionError(f"-{name}: allowed only with -{' or -'.join(others)}")
    law, I0 = parameters.part("law").of(parameters), parameters.inertial_number
    found = {"model": parameters.model, "law": parameters.law, "inertial_number": I0}
    if args.posedness:
        return {**found, "model": "li", **posedness(law, I0)}
    if parameters.part("model").theory is None:
        raise OptionError(f"-pgran_model {parameters.model}: this model has no linear theory")
    if args.specimen:
        return {**found, **specimen_growth(parameters, args)}
    coefficients, gradient = Coefficients.of_run(parameters), read_base_flow(args.base_flow)
    N = waves.flow_direction(gradient)
    limit = waves.limit_of_stress_ratio(N)
    found.update(base_flow=args.base_flow, stress_ratio=coefficients.mu, stress_ratio_limit=limit,
                 well_posed_pressure=coefficients.mu < limit)
    if coefficients.model == "ngf_primitive":
        found["relaxation_time"] = parameters.relaxation_time
    rate = float(waves.viscous_rate(coefficients.mu, parameters.A, parameters.phi, I0))
    if args.cutoff:
        return {**found, **extremes(law, coefficients, N, rate, parameters.A)}
    return {**found, **wave(N, coefficients, gradient, rate, args)}


def posedness(law, I0):
    """Return C at an inertial number, and the ranges where LI is ill-posed with a law."""
    ranges = waves.ill_posed_ranges(law)
    return {"C": waves.long_wave_excess(law, I0),
            "well_posed": not any(low <= I0 <= high for low, high in ranges),
            "ill_posed_ranges": ranges,
            **{name: getattr(law, name) for name in ("I_1", "A_minus") if hasattr(law, name)}}


def specimen_growth(parameters, args):
    """Return the growth rate of `pgran.theory.specimen` and what it depends on."""
    arguments = parameters.part("case")(parameters).specimen
    if arguments is None:
        raise OptionError("-specimen: the theory requires a specimen between slipping plates and "
                          f"one of the models {', '.join(specimen.MODELS)}, not "
                          f"-pgran_case {parameters.case} with these options")
    rate = complex(specimen.growth_rate(**arguments, half_waves=args.half_waves,
                                        parity=args.parity))
    return {"width": arguments["width"], "height": arguments["height"],
            "half_waves": args.half_waves, "parity": args.parity, "growth_rate_gdot0": rate.real,
            **({"frequency_gdot0": rate.imag} if rate.imag else {})}


def extremes(law, coefficients, N, rate, A):
    """Return cut-off, fastest wave vector, unstable directions and critical inertial numbers."""
    k_cut = waves.cutoff(coefficients, N)
    k, value, m = waves.fastest(coefficients, N)
    return {"k_cut": k_cut, "cutoff_wavelength": 2.0 * np.pi * A / k_cut if k_cut else np.inf,
            "fastest_growth_rate": value, "fastest_growth_rate_gdot0": value * rate,
            "fastest_wave_number": k, "fastest_angle": waves.direction_angle(m, N),
            "fastest_directions": waves.directions(m, N) if np.isfinite(m) else [],
            "unstable_angles": sorted(waves.direction_angle(direction, N) for direction in
                                      waves.unstable_directions(coefficients, N)),
            "critical_inertial_numbers": waves.critical_inertial_numbers(law, N=N)}


def wave(N, coefficients, gradient, rate, args):
    """Return the growth of one wave vector and, if requested, its amplification."""
    k, text = np.array(args.wave_vector), ",".join(f"{number:g}" for number in args.wave_vector)
    if len(k) != len(N):
        raise OptionError(f"-wave_vector {text}: must be {len(N)} numbers")
    if not k.any():
        raise OptionError(f"-wave_vector {text}: must not be zero")
    found = {"wave_vector": k, "convection": args.convection,
             "denominator": waves.tensor(k, N, *coefficients.r_q(k @ k))[1]}
    if args.convection:
        value, reduced = (function(k, N, coefficients, 1.0 / rate, gradient)[0].real for function
                          in (waves.tensor_growth_rates, waves.growth_rates))
        found["growth_rate_incompressible"] = reduced
    else:
        value = waves.growth_rates(k, N, coefficients)[0].real
    found["growth_rate"] = value
    if coefficients.model != "ig":
        found["growth_rate_gdot0"] = value * rate
    if args.amplification:
        times, logarithms = turning.amplitude(k, N, coefficients, gradient, 1.0 / rate,
                                              args.end * rate)
        largest = np.argmax(logarithms)
        found.update(end=args.end, largest_log_amplification=logarithms[largest],
                     largest_amplification_time=times[largest] / rate,
                     final_log_amplification=logarithms[-1])
    return found


def plain(value):
    """Return a value for JSON: numbers and lists of Python, and None for infinity and NaN."""
    value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value if isinstance(value, str) or np.isfinite(value) else None


def run(parameters, args):
    """Print the results."""
    found = {name: plain(value) for name, value in analyse(parameters, args).items()}
    if args.json:
        print(as_json(found))
        return
    if args.posedness:
        print("LI in plane flow, independent of -pgran_model:")
    for key, value in found.items():
        if value is None:
            value = "undefined (zero denominator, unbounded growth, or no unstable wave)"
        print(f"{key:28} {f'{value:.10g}' if isinstance(value, float) else value}")
    if not found.get("well_posed_pressure", True):
        print("warning: mu_loc(I0) violates (3.19): the denominator of (3.16) changes sign")


def main(arguments):
    """Analyse the command line ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "stability", run, __doc__, OPTIONS)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
