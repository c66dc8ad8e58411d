"""Growth rates of the specimen: linearised step, analytical solutions and nonlinear runs."""

import shutil
from itertools import product
from pathlib import Path

import numpy as np

from pgran import cases
from pgran.runs import run_on_ranks
from pgran.theory import specimen as theory

from . import study
from .growth import fitted, history
from .study import result_file

#: Half the range of I over I0 between which growth is fitted, at I0 >= 0.001. The first points fall
#: below yield at 0.04, and earlier at smaller I0, where mu - mu_s = b I0 is smaller.
LINEAR = 0.005, 0.015
#: Steps that are extrapolated to zero, 1/gdot0, and larger steps of the first table.
STEPS, LARGE = (5e-4, 2.5e-4, 1.25e-4), (2e-3, 1e-3)
#: Growth rate, gdot0, beyond which the steps are made smaller.
FAST = 400.0
COUPLINGS = ("", "spin", "memory", "spin,memory", "interior", "faces", "geometry",
             "faces,geometry")
HEIGHTS = 60, 80, 120, 160, 240
BASE = "-pgran_element_size", 2
_SLOW = {"step": 5e-4, "end": 0.05}
#: Name, options, and arguments of `measured` of the last table. With inertia, loading leaves a
#: pattern of 4 % of I0, which the mode has to exceed.
CASES = (
    ("L = 40 d, I0 = 0.001, G = 1000", (), {}),
    ("L = 20 d", ("-pgran_width", 20), _SLOW),
    ("L = 80 d", ("-pgran_width", 80), {}),
    ("I0 = 0.0001", ("-pgran_inertial_number", 1e-4), {}),
    ("I0 = 0.003", ("-pgran_inertial_number", 0.003), _SLOW),
    ("I0 = 0.007", ("-pgran_inertial_number", 0.007), _SLOW),
    ("I0 = 0.03", ("-pgran_inertial_number", 0.03), {"step": 1e-3, "end": 0.08}),
    *((f"G = {G:g}", ("-pgran_shear_modulus", G), {}) for G in (100, 1e4, 1e5)),
    ("no slip at the plates", ("-pgran_plates_slip", "false"), {"step": 1e-3, "end": 0.14}),
    ("with inertia", ("-pgran_inertia", "true"),
     {"step": 1e-3, "end": 0.07, "solver": "direct", "window": (0.05, 0.15)}))
#: Variations of the table of analytical rates.
SHAPES = ((), ("-pgran_element_size", 1), ("-pgran_height", 60), ("-pgran_width", 20),
          ("-pgran_width", 80), ("-pgran_inertial_number", 0.003), ("-pgran_shear_modulus", 1e5))


def linearised(*options, steps=STEPS):
    """Return the fastest growth rates of each step (pgran.growth): complex (n,), gdot0."""
    rows = study.json_of(1, "pgran.growth", "-options_file", "options/growth.opts", "-json",
                         "-dt", ",".join(map(str, steps)), *options)
    return [np.array([complex(real, abs(imaginary)) for real, imaginary in row["growth_rates"]])
            for row in rows]


def predicted(*options):
    """Return the fastest growth rates, complex (n,), gdot0, extrapolated to a step of zero."""
    expected = analytical(options) or FAST
    steps = [step * min(1.0, FAST / expected.real) for step in STEPS]
    return at_zero(steps, linearised(*options, steps=steps))


def at_zero(steps, rates):
    """Return rates extrapolated to a step of zero, as many as all steps have."""
    from pgran.solve.linearised import extrapolated  # starts PETSc

    found = np.array([row[:min(map(len, rates))] for row in rates])
    return np.array([complex(*(extrapolated(steps, part) for part in (rate.real, rate.imag)))
                     for rate in found.T])


def arguments(options, stretch=1.0):
    """Return the parameters and the arguments of the analytical solutions (None if none holds)."""
    parameters = study.parameters(None, *options)
    shape = cases.create(parameters).specimen
    if shape is not None:
        shape.update(width=shape["width"] * stretch, height=shape["height"] / stretch)
    return parameters, shape


def analytical(options, stretch=1.0, **wave):
    """Return the analytical growth rate with elasticity, gdot0, or None if it does not apply."""
    parameters, shape = arguments(options, stretch)
    if shape is None:
        return None
    return complex(theory.growth_rate(**shape, shear_modulus=parameters.shear_modulus, **wave))


def column(options, half_waves=1):
    """Return the growth rate of the creep-buckling column, gdot0, or None if it does not apply."""
    shape = arguments(options)[1]
    return None if shape is None else theory.column_growth_rate(**shape, half_waves=half_waves)


def later(options, time):
    """Return the growth rate at ``time``, 1/gdot0, over the initial one: the shape has changed."""
    return (analytical(options, stretch=np.exp(time / 2.0)).real / analytical(options).real)


def measured(output, *options, imperfection=0.9999, step=2.5e-4, end=0.02, solver="biaxial",
             window=LINEAR):
    """Return the growth rate of a nonlinear run, gdot0, and the time of the fit, 1/gdot0.

    ``end`` is a compression, ``solver`` an options file, and ``window`` as for `fitted`. None and
    None if nothing grows.
    """
    study.run(output, solver, *options, "-pgran_imperfection", imperfection, "-pgran_step_max",
              step, "-snes_atol", 1e-7, "-pgran_compression", end, "-pgran_snapshots", end)
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


def steps_rows(*options):
    """Yield the fastest growth rate for each step, its limit, and the analytical rates."""
    steps = LARGE + STEPS
    found = linearised(*options, steps=steps)
    yield from ((step, rates[0].real) for step, rates in zip(steps, found))
    yield "extrapolated to 0", at_zero(STEPS, found[len(LARGE):])[0].real
    yield "analytical", analytical(options).real
    yield "column", column(options)


def coupling_rows(*options):
    """Yield the fastest growth rate without parts of the coupling."""
    for without in COUPLINGS:
        more = ("-without", without) if without else ()
        yield (without.replace("memory", "stress history") or "nothing",
               shown(predicted(*options, *more)[0]))


def heights_rows(*options):
    """Yield the two fastest growth rates for each height, and analytical rates."""
    for height in HEIGHTS:
        more = (*options, "-pgran_height", height)
        first, second = predicted(*more)[:2].real
        forms = sorted((analytical(more, half_waves=n, parity=parity).real
                        for n, parity in product((1, 2, 3), theory.PARITIES)), reverse=True)
        yield height, first, forms[0], second, forms[1], column(more, 1), column(more, 2)


def analytical_rows(*options):
    """Yield the analytical growth rate and the linearised step for several shapes."""
    for varied in SHAPES:
        exact, found = analytical((*options, *varied)), predicted(*options, *varied)[0]
        yield (" ".join(map(str, varied)) or "base", exact.real, found.real,
               100 * (found.real / exact.real - 1))


def runs_rows(directory, *options):
    """Yield the growth rates of the linearised step, of theory and of nonlinear runs."""
    for name, varied, how in CASES:
        more = (*options, *varied)
        found, time = measured(result_file(directory, name), *more, **how)
        rate, creeping = predicted(*more)[0], column(more)
        then = rate * later(more, time) if found and creeping else None
        yield (name, shown(rate), shown(analytical(more)), shown(creeping), shown(then),
               "none" if found is None else f"{found:.1f}")


def specimen(directory="results/specimen", *, options=()):
    """Growth rates of the specimen in theory and in runs: specimen [directory]

    Fastest growth rates of the linearised step (pgran.growth), extrapolated to a step of zero, for
    parts of the coupling, H, L, I0, G and inertia; the analytical rate with the same G, and the
    creep-buckling column. The last table adds nonlinear runs with a small imperfection, and the
    linearised step corrected for the current shape. The fastest mode is stored in mode.h5. A
    quarter of an hour on two cores.
    """
    directory, options = Path(directory), (*BASE, *options)
    for name, columns, rows in (
            ("steps", {"step": "g", "fastest growth rate": ".1f"}, steps_rows(*options)),
            ("coupling", {"left out": "", "fastest growth rate": ""}, coupling_rows(*options)),
            ("heights", {"H (d)": "d", "linearised step": ".1f", "analytical": ".1f",
                         "second mode": ".1f", "second, analytical": ".1f",
                         "column, n = 1": ".1f", "n = 2": ".1f"}, heights_rows(*options)),
            ("analytical", {"case": "", "analytical": ".3f", "linearised step": ".3f",
                            "difference (%)": "+.3f"}, analytical_rows(*options)),
            ("runs", dict.fromkeys((
                "case", "linearised step", "analytical", "column",
                "corrected for the current shape", "nonlinear run"), ""),
             runs_rows(directory, *options))):
        study.write_table(directory / f"specimen_{name}.csv", columns, rows)
    mode, steady = directory / "mode.h5", (*options, "-pgran_imperfection", 1)
    if not run_on_ranks.done(mode, "options/growth.opts", steady):
        run_on_ranks.python(1, "-m", "pgran.growth", "-options_file", "options/growth.opts",
                            *steady, "-dt", STEPS[0], "-mode", mode)
    shutil.copy(mode.with_suffix(".png"), study.DOCS / "figures")
