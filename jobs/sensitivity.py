"""How the band of figure 3 depends on what the paper does not state, at elements of 2 d.

    python jobs/sensitivity.py [directory: results/sensitivity] [-pgran_... options for all]

Elastic modulus, step, imperfection, law and plates; prints a Markdown table with the band at 5 and
10 % compression and the cost of each run. Runs that are done are not repeated. About ten minutes
on two cores. Meshes are the matter of jobs/meshes.sh.
"""

import sys
from pathlib import Path

import h5py
from launch import RANKS, complete, python

from pgran import measure

CASES = {
    "base": (),
    "G = 100": ("-pgran_shear_modulus", 100),
    "G = 300": ("-pgran_shear_modulus", 300),
    "G = 1e4": ("-pgran_shear_modulus", 1e4),
    "G = 1e5": ("-pgran_shear_modulus", 1e5),
    "step error halved": ("-pgran_step_error", 0.05),
    "step error quartered": ("-pgran_step_error", 0.025),
    "steps up to 1e-3": ("-pgran_step_max", 1e-3),
    "steps up to 5e-4": ("-pgran_step_max", 5e-4),
    "imperfection 0.9": ("-pgran_imperfection", 0.9),
    "imperfection 0.95": ("-pgran_imperfection", 0.95),
    "imperfection 0.999": ("-pgran_imperfection", 0.999),
    "weak square of 4 d": ("-pgran_imperfection_size", 4),
    "mirrored": ("-pgran_imperfection_mirrored", "true"),
    "Jop": ("-pgran_law", "jop"),
    "plates that hold": ("-pgran_plates_slip", "false")}


def run(path, *options):
    """Run the biaxial case to ``path`` unless that was done; return its attributes.

    None if the run did not come to its end.
    """
    if not complete(path):
        python(RANKS, "-m", "pgran", "-options_file", "options/biaxial.opts", "-pgran_output",
               path, "-pgran_progress", "quiet", *options, check=False)
    if not complete(path):
        return None
    with h5py.File(path) as file:
        return dict(file.attrs)


def main(directory="results/sensitivity", *common):
    directory = Path(directory)
    print("| case | I max at 5 %, at 10 % | angle | width | steps / Newton / linear | s | MB |")
    print("|---|---|---|---|---|---|---|")
    for number, (name, options) in enumerate(CASES.items()):
        path = directory / f"{number:02d}.h5"
        cost = run(path, *common, *options)
        if cost is None:
            print(f"| {name} | did not come to its end | | | | | |", flush=True)
            continue
        half, full = measure.measure(path)

        def pair(key, half=half, full=full):
            return ", ".join("-" if row[key] is None else f"{row[key]:.1f}" for row in (half, full))

        print(f"| {name} | {1e3 * half['inertial_number_max']:.3f}e-3, "
              f"{1e3 * full['inertial_number_max']:.3f}e-3 | {pair('angle')} | {pair('width')} | "
              f"{cost['steps']} / {cost['newton_iterations']} / {cost['linear_iterations']} | "
              f"{cost['seconds']:.0f} | {cost['memory']:.0f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
