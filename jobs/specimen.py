"""Why the specimen localises: theory of the moving specimen beside nonlinear runs.

    python jobs/specimen.py [directory: results/specimen]

Fastest growth rates of the linearised step (pgran.growth) over L, H, I0, G, inertia and the parts
of the coupling, beside a column that creeps, and the growth of the range of I in nonlinear runs
with a faint imperfection. Prints Markdown tables and leaves the fastest mode, mode.png; runs that
are there are not repeated. About ten minutes on two cores.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from growth import fitted, history
from launch import RANKS, complete, python

from pgran.growth import column_growth_rate
from pgran.options import read

#: Half the range of I over I0 between which growth is fitted, at I0 = 0.001 and above. The first
#: points fall below yield at 0.04; a smaller I0, with mu - mu_s = b I0, takes them there earlier.
LINEAR = 0.005, 0.015


def predicted(*options, steps="5e-4,2.5e-4"):
    """Return the fastest growth rates, one list for each step, by pgran.growth."""
    done = python(1, "-m", "pgran.growth", "-options_file", "options/growth.opts", "-json", "-dt",
                  steps, *options, stdout=subprocess.PIPE, text=True)
    return [row["growth_rates"] for row in json.loads(done.stdout)]


def column(options, half_waves=None, stretch=1.0):
    """Return the growth rate of a column, gdot0, for options as on the command line.

    ``stretch``: how much wider, and shorter, it has become.
    """
    settings = read({name[1:]: str(value) for name, value in zip(options[::2], options[1::2])})
    settings.width, settings.height = settings.width * stretch, settings.height / stretch
    return column_growth_rate(settings, half_waves)


def later(options, time):
    """Return by what factor a column grows slower at ``time``, 1/gdot0, for its shape has changed.

    Homogeneous flow makes it exp(time/2) wider and as much shorter.
    """
    return column(options, stretch=np.exp(time / 2.0)) / column(options)


def measured(output, *options, imperfection=0.9999, step=2.5e-4, end=0.02, solver="biaxial",
             window=LINEAR):
    """Return the growth rate fitted to a nonlinear run, gdot0, and when it was found, 1/gdot0.

    None and None where nothing grows.
    """
    if not complete(output):
        python(RANKS, "-m", "pgran", "-options_file", f"options/{solver}.opts",
               "-pgran_imperfection", imperfection, "-pgran_step_max", step, "-snes_atol", 1e-7,
               "-pgran_compression", end, "-pgran_snapshots", end, "-pgran_output", output,
               "-pgran_progress", "quiet", *options)
    I0, time, span = history(output)
    window = [min(1.0, I0 / 0.001) * limit for limit in window]
    rate = fitted(time, span, window)
    if rate is None:
        return None, None
    return rate, time[np.flatnonzero(span < np.sqrt(window[0] * window[1]))[-1]]


def show(rates):
    """The fastest of growth rates, as text."""
    if not rates:
        return "-"
    real, imaginary = rates[0]
    return f"{real:.1f}" + (f" +- {abs(imaginary):.1f} i" if abs(imaginary) > 0.05 else "")


def main(directory="results/specimen"):
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    base = ("-pgran_element_size", 2)
    print("| step | fastest growth rate |\n|---|---|")
    for step in ("2e-3", "1e-3", "5e-4", "2.5e-4", "1.25e-4"):
        print(f"| {step} | {show(predicted(*base, steps=step)[0])} |")
    print("\n| left out of the coupling | fastest growth rate |\n|---|---|")
    for without in ("", "spin", "memory", "spin,memory", "interior", "faces", "geometry",
                    "faces,geometry"):
        more = ("-without", without) if without else ()
        print(f"| {without or 'nothing'} | {show(predicted(*base, *more)[1])} |")
    print("\n| H (L = 40 d) | the two fastest growth rates | column, n = 1 and 2 |\n|---|---|---|")
    for height in (60, 80, 120, 160, 240):
        both = predicted(*base, "-pgran_height", height)[1]
        print(f"| {height} d | {both[0][0]:.1f}, {both[1][0]:.1f} | "
              f"{column(('-pgran_height', height), 1):.1f}, "
              f"{column(('-pgran_height', height), 2):.1f} |")
    print("\n| case | linearised step | column | for the shape then | nonlinear run |\n"
          "|---|---|---|---|---|")
    slow = {"step": 5e-4, "end": 0.05}
    cases = [("L = 40 d, I0 = 0.001, G = 1000", (), {}),
             ("L = 20 d", ("-pgran_width", 20), slow),
             ("L = 80 d", ("-pgran_width", 80), {}),
             ("I0 = 0.0001", ("-pgran_inertial_number", 1e-4), {}),
             ("I0 = 0.003", ("-pgran_inertial_number", 0.003), slow),
             ("I0 = 0.007", ("-pgran_inertial_number", 0.007), slow),
             ("I0 = 0.03", ("-pgran_inertial_number", 0.03), {"step": 1e-3, "end": 0.08})]
    cases += [(f"G = {G:g}", ("-pgran_shear_modulus", G), {}) for G in (100, 1e4, 1e5)]
    cases += [("plates hold it", ("-pgran_plates_slip", "false"), {"step": 1e-3, "end": 0.14})]
    # With inertia the pressure mass matrix is no stand-in for the Schur complement, and loading
    # leaves a pattern of 4 % of I0 that the mode has to outgrow.
    cases += [("with inertia", ("-pgran_inertia", "true"),
               {"step": 1e-3, "end": 0.07, "solver": "direct", "window": (0.05, 0.15)})]
    for name, more, how in cases:
        found, time = measured(directory / (name.replace(" ", "").replace(",", "_") + ".h5"),
                               *base, *more, **how)
        rates = predicted(*base, *more)[1]
        seen = ["none", "none"] if found is None else [
            f"{rates[0][0] * later(more, time):.1f}", f"{found:.1f}"]
        print(f"| {name} | {show(rates)} | {column(more):.1f} | {' | '.join(seen)} |", flush=True)
    python(1, "-m", "pgran.growth", "-options_file", "options/growth.opts", *base, "-dt", "5e-4",
           "-mode", directory / "mode.h5")


if __name__ == "__main__":
    main(*sys.argv[1:])
