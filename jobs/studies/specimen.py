"""Growth rates of the specimen by theory, linearised step and runs: specimen [directory]

Fastest growth rates of the linearised step (pgran.growth), extrapolated to a step of zero, over the
parts of the coupling, H, L, I0, G and inertia, compared with the analytical growth rate for the
same G and with the creep-buckling column (`pgran.theory.specimen`). The last table adds the growth
of the range of I in nonlinear runs with a faint imperfection, and the linearised step corrected for
the current shape of the specimen. mode.png shows the fastest mode.
"""

from itertools import product
from pathlib import Path

import numpy as np

from pgran import cases
from pgran.runs import run_on_ranks
from pgran.runs.table import result_file
from pgran.theory import specimen as theory

from .growth import fitted, history
from .study import Report, command, run

#: Half the range of I over I0 between which growth is fitted, at I0 = 0.001 and above. The first
#: points fall below yield at 0.04; a smaller I0, with mu - mu_s = b I0, takes them there earlier.
LINEAR = 0.005, 0.015
#: Steps that are extrapolated to zero, 1/gdot0; the first table shows some larger ones too.
STEPS, LARGE = (5e-4, 2.5e-4, 1.25e-4), (2e-3, 1e-3)
#: Growth rate, gdot0, up to which these steps are small enough; beyond it they are smaller.
FAST = 400.0
COUPLINGS = ("", "spin", "memory", "spin,memory", "interior", "faces", "geometry",
             "faces,geometry")
HEIGHTS = 60, 80, 120, 160, 240
BASE = "-pgran_element_size", 2
_BARREL = {"half_waves": 2, "parity": "barrel"}
#: Name, options, arguments of the analytical solution, and which rate of the linearised step.
MODES = (
    ("L = 40 d, H = 120 d, I0 = 0.001", (), {}, 0),
    ("elements of d", ("-pgran_element_size", 1), {}, 0),
    *((f"H = {height} d", ("-pgran_height", height), {}, 0) for height in (60, 80, 160, 240)),
    *((f"H = {height} d, barrel, n = 2", ("-pgran_height", height), _BARREL, 1)
      for height in (60, 80)),
    *((f"L = {width} d, H = {3 * width} d", ("-pgran_width", width, "-pgran_height", 3 * width), {},
       0) for width in (20, 80)),
    *((f"I0 = {number:g}", ("-pgran_inertial_number", number), {}, 0)
      for number in (1e-4, 0.003, 0.007, 0.03)),
    ("I0 = 0.03, LI", ("-pgran_inertial_number", 0.03, "-pgran_model", "li"), {}, 0),
    *((f"G = {G:g}", ("-pgran_shear_modulus", G), {}, 0) for G in (100, 1e4, 1e5)))
_SLOW = {"step": 5e-4, "end": 0.05}
#: Name, options, and arguments of `measured` of the last table. With inertia, loading
#: leaves a pattern of 4 % of I0 that the mode must outgrow.
CASES = (
    ("L = 40 d, I0 = 0.001, G = 1000", (), {}),
    ("L = 20 d", ("-pgran_width", 20), _SLOW),
    ("L = 80 d", ("-pgran_width", 80), {}),
    ("I0 = 0.0001", ("-pgran_inertial_number", 1e-4), {}),
    ("I0 = 0.003", ("-pgran_inertial_number", 0.003), _SLOW),
    ("I0 = 0.007", ("-pgran_inertial_number", 0.007), _SLOW),
    ("I0 = 0.03", ("-pgran_inertial_number", 0.03), {"step": 1e-3, "end": 0.08}),
    *((f"G = {G:g}", ("-pgran_shear_modulus", G), {}) for G in (100, 1e4, 1e5)),
    ("no-slip plates", ("-pgran_plates_slip", "false"), {"step": 1e-3, "end": 0.14}),
    ("with inertia", ("-pgran_inertia", "true"),
     {"step": 1e-3, "end": 0.07, "solver": "direct", "window": (0.05, 0.15)}))


def linearised(*options, steps=STEPS):
    """Return the fastest growth rates of each step by pgran.growth, a list of complex (n,), gdot0.

    Of a pair of complex rates both have the positive imaginary part.
    """
    rows = command(1, "pgran.growth", "-options_file", "options/growth.opts", "-dt",
                   ",".join(map(str, steps)), *options)
    return [np.array([complex(real, abs(imaginary)) for real, imaginary in row["growth_rates"]])
            for row in rows]


def predicted(*options):
    """Return the fastest growth rates, complex (n,), gdot0, extrapolated to a step of zero."""
    expected = analytical(options) or FAST
    steps = [step * min(1.0, FAST / expected.real) for step in STEPS]
    return at_zero(steps, linearised(*options, steps=steps))


def at_zero(steps, rates):
    """Return the rates of ``steps``, complex arrays, extrapolated to a step of zero."""
    from pgran.solve.linearised import extrapolated  # starts PETSc

    found = np.array([row[:min(map(len, rates))] for row in rates])
    return np.array([complex(*(extrapolated(steps, part) for part in (rate.real, rate.imag)))
                     for rate in found.T])


def arguments(options, stretch=1.0):
    """Return the parameters of options, and the arguments of the analytical solution, or None.

    ``stretch`` is the factor by which the specimen has become wider and shorter.
    """
    parameters = cases.read(run_on_ranks.parsed(options))
    specimen = cases.create(parameters).specimen
    if specimen is not None:
        specimen.update(width=specimen["width"] * stretch, height=specimen["height"] / stretch)
    return parameters, specimen


def analytical(options, stretch=1.0, **wave):
    """Return the analytical growth rate with elasticity, gdot0, or None outside its scope.

    ``options`` as on the command line, ``stretch`` as for `arguments`, and ``wave`` as for
    `pgran.theory.specimen.growth_rate`.
    """
    parameters, specimen = arguments(options, stretch)
    if specimen is None:
        return None
    return complex(theory.growth_rate(**specimen, shear_modulus=parameters.shear_modulus, **wave))


def column(options, half_waves=1):
    """Return the growth rate of the creep-buckling column, gdot0, or None outside its scope."""
    specimen = arguments(options)[1]
    return specimen and theory.column_growth_rate(**specimen, half_waves=half_waves)


def later(options, time):
    """Return the growth rate at ``time``, 1/gdot0, over that of the initial shape.

    Homogeneous flow makes the specimen wider and shorter by the factor exp(time/2).
    """
    then, first = analytical(options, stretch=np.exp(time / 2.0)), analytical(options)
    return then.real / first.real


def measured(output, *options, imperfection=0.9999, step=2.5e-4, end=0.02, solver="biaxial",
             window=LINEAR):
    """Return the growth rate fitted to a nonlinear run, gdot0, and when it was found, 1/gdot0.

    ``end`` is a compression, ``solver`` an options file, and ``window`` an argument of `fitted`.
    None and None where nothing grows.
    """
    run(output, solver, *options, "-pgran_imperfection", imperfection, "-pgran_step_max", step,
        "-snes_atol", 1e-7, "-pgran_compression", end, "-pgran_snapshots", end)
    I0, time, span = history(output)
    window = [min(1.0, I0 / 0.001) * limit for limit in window]
    rate = fitted(time, span, window)
    if rate is None:
        return None, None
    return rate, time[np.flatnonzero(span < np.sqrt(window[0] * window[1]))[-1]]


def shown(rate):
    """Return a growth rate as text."""
    if rate is None:
        return "-"
    return f"{rate.real:.1f}" + (f" +- {rate.imag:.1f} i" if abs(rate.imag) > 0.05 else "")


def steps_table(directory, *options):
    """Fastest growth rate over the step, its limit, and theory."""
    table = Report(directory / "steps.csv", {"step": "g", "fastest growth rate": ".1f"},
                   "specimen_steps")
    steps = LARGE + STEPS
    found = linearised(*options, steps=steps)
    for step, rates in zip(steps, found):
        table.row(step, rates[0].real)
    table.row("extrapolated to 0", at_zero(STEPS, found[len(LARGE):])[0].real)
    table.row("analytical", analytical(options).real)
    table.row("column", column(options))


def coupling_table(directory, *options):
    """Fastest growth rate without parts of the coupling."""
    table = Report(directory / "coupling.csv", {"left out": "", "fastest growth rate": ""},
                   "specimen_coupling")
    for without in COUPLINGS:
        more = ("-without", without) if without else ()
        table.row(without or "nothing", shown(predicted(*options, *more)[0]))


def analytical_table(directory, *options):
    """Analytical growth rates with elasticity, and the linearised step."""
    table = Report(directory / "analytical.csv", {
        "case": "", "analytical": ".6g", "linearised step, extrapolated": ".6g",
        "difference (%)": "+.3f"}, "specimen_analytical")
    for name, varied, wave, number in MODES:
        more = (*options, *varied, "-eps_tol", 1e-9)
        exact, found = analytical(more[:-2], **wave).real, predicted(*more)[number].real
        table.row(name, exact, found, 100 * (found / exact - 1))


def heights_table(directory, *options):
    """Two fastest growth rates over the height, and theory."""
    table = Report(directory / "heights.csv", {
        "H (d)": "d", "linearised step": ".1f", "analytical": ".1f", "second mode": ".1f",
        "second analytical": ".1f", "column, n = 1": ".1f", "column, n = 2": ".1f"},
        "specimen_heights")
    for height in HEIGHTS:
        more = (*options, "-pgran_height", height)
        first, second = predicted(*more)[:2].real
        forms = sorted((analytical(more, half_waves=n, parity=parity).real
                        for n, parity in product((1, 2, 3), theory.PARITIES)), reverse=True)
        table.row(height, first, forms[0], second, forms[1], column(more, 1), column(more, 2))


def runs_table(directory, *options):
    """Linearised step, theory and nonlinear runs."""
    table = Report(directory / "runs.csv", dict.fromkeys((
        "case", "linearised step", "analytical", "column", "corrected for the current shape",
        "nonlinear run"), ""), "specimen_runs")
    for name, varied, how in CASES:
        more = (*options, *varied)
        found, time = measured(result_file(directory, name), *more, **how)
        rate, creeping = predicted(*more)[0], column(more)
        then = rate * later(more, time) if found and creeping else None
        table.row(name, shown(rate), shown(analytical(more)), shown(creeping), shown(then),
                  "none" if found is None else f"{found:.1f}")


def main(directory="results/specimen", *, options=()):
    """Make the tables, the runs and the picture of the fastest mode."""
    directory, options = Path(directory), (*BASE, *options)
    for table in (steps_table, coupling_table, analytical_table, heights_table, runs_table):
        table(directory, *options)
        print()
    mode, steady = directory / "mode.h5", (*options, "-pgran_imperfection", 1)
    if not run_on_ranks.done(mode, "options/growth.opts", steady):
        run_on_ranks.python(1, "-m", "pgran.growth", "-options_file", "options/growth.opts",
                            *steady, "-dt", STEPS[0], "-mode", mode)
