"""Why the specimen localises: theory of the moving specimen beside nonlinear runs.

    python jobs/specimen.py [directory: results/specimen]

Fastest growth rates of the linearised step (pgran.growth) over L, I0, G, inertia and the parts of
the coupling, beside the growth of the range of I in nonlinear runs with a faint imperfection.
Prints Markdown tables. About ten minutes on two cores.
"""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
from launch import python

#: Half the range of I over I0 between which growth is fitted.
LINEAR = 0.002, 0.015


def predicted(*options, steps="5e-4,2.5e-4"):
    """Return the fastest growth rates, one list for each step, by pgran.growth."""
    done = python(1, "-m", "pgran.growth", "-options_file", "options/growth.opts", "-json", "-dt",
                  steps, *options, stdout=subprocess.PIPE, text=True)
    return [row["growth_rates"] for row in json.loads(done.stdout)]


def measured(output, *options, step=2.5e-4, end=0.02, ranks=2,
             solver="biaxial"):
    """Return the growth rate fitted to a nonlinear run, gdot0, or None where nothing grows."""
    output = Path(output)
    if not output.exists():
        python(ranks, "-m", "pgran", "-options_file", f"options/{solver}.opts",
               "-pgran_imperfection", 0.9999, "-pgran_step_max", step, "-snes_atol", 1e-7,
               "-pgran_compression", end, "-pgran_snapshots", end, "-pgran_output", output,
               "-pgran_progress", "quiet", *options)
    with h5py.File(output) as file:
        settings = dict(line[1:].split(" ", 1) for line in file.attrs["options"].splitlines())
        I0 = float(settings["pgran_inertial_number"])
        time, high, low = (file["history"][name][...] for name in (
            "time", "inertial_number_max", "inertial_number_min"))
    span = (high - low) / (2.0 * I0)
    return fitted(time, span)


def fitted(time, span):
    """Return the growth rate where ``span`` passes `LINEAR` for good, None where it does not."""
    if span[-1] < LINEAR[1]:
        return None
    first = np.flatnonzero(span < LINEAR[0])
    first = first[-1] + 1 if first.size else 0
    last = first + np.argmax(span[first:] > LINEAR[1])
    if last - first < 4:
        return None
    return float(np.polyfit(time[first:last], np.log(span[first:last]), 1)[0])


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
    print("\n| case | linearised step | nonlinear run |\n|---|---|---|")
    cases = [("L = 40 d, I0 = 0.001, G = 1000", ())]
    cases += [(f"L = {L} d", ("-pgran_width", L)) for L in (20, 80)]
    cases += [(f"I0 = {I0}", ("-pgran_inertial_number", I0)) for I0 in (1e-4, 0.003, 0.007, 0.03)]
    cases += [(f"G = {G:g}", ("-pgran_shear_modulus", G)) for G in (100, 1e4, 1e5)]
    cases += [("with inertia", ("-pgran_inertia", "true"))]
    for name, more in cases:
        # With inertia the pressure mass matrix is no stand-in for the Schur complement.
        solver = "direct" if "inertia" in name else "biaxial"
        found = measured(directory / (name.replace(" ", "").replace(",", "_") + ".h5"), *base,
                         *more, solver=solver)
        print(f"| {name} | {show(predicted(*base, *more)[1])} | "
              f"{'none' if found is None else f'{found:.1f}'} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
