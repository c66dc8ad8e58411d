"""Sensitivity of the band to parameters that the paper does not state: sensitivity [directory]

Elastic modulus, time step, mesh, imperfection, law, plates and inertial number, on elements of 2 d.
The table has the band in each snapshot, the cost, and the largest difference of I from the base at
the same material points, over the largest I of the base. The study fails where the difference at
the end exceeds `LIMITS`.
"""

from pathlib import Path

import numpy as np

from pgran.options import RUN, SolutionError
from pgran.output import band
from pgran.runs.table import COST, cost, result_file

from .study import Report, attempt

#: The step error of the base.
DEFAULT = next(option.default for option in RUN if option.name == "step_error")
CASES = {
    "base": (),
    "G = 100": ("-pgran_shear_modulus", 100),
    "G = 300": ("-pgran_shear_modulus", 300),
    "G = 1e4": ("-pgran_shear_modulus", 1e4),
    "G = 1e5": ("-pgran_shear_modulus", 1e5),
    **{f"{value / DEFAULT:g} of the step error": ("-pgran_step_error", value)
       for value in (0.05, 0.025)},
    "steps up to 1e-3": ("-pgran_step_max", 1e-3),
    "steps up to 5e-4": ("-pgran_step_max", 5e-4),
    "elements of d": ("-pgran_element_size", 1),
    "imperfection 0.9": ("-pgran_imperfection", 0.9),
    "imperfection 0.95": ("-pgran_imperfection", 0.95),
    "imperfection 0.999": ("-pgran_imperfection", 0.999),
    "weakened square of 4 d": ("-pgran_imperfection_size", 4),
    "mirrored": ("-pgran_imperfection_mirrored", "true"),
    "Jop": ("-pgran_law", "jop"),
    "no-slip plates": ("-pgran_plates_slip", "false"),
    "I0 = 0.03": ("-pgran_inertial_number", 0.03)}
#: Largest difference from the base at the end, per cent of the largest I of the base.
LIMITS = {"G = 1e4": 3.0, "steps up to 1e-3": 2.0, "elements of d": 10.0}
COLUMNS = {"case": "", "compression": "g", "I min": ".4e", "I max": ".4e", "difference (%)": ".2f",
           "angle": ".1f", "width": ".1f", **COST}


def difference(fine, coarse):
    """Return the largest difference of two fields (ny, nx) at nodes of the coarse one."""
    step = (len(fine) - 1) // (len(coarse) - 1)
    return float(np.abs(fine[::step, ::step] - coarse).max())


def main(directory="results/sensitivity", *, options=()):
    """Make the runs and the table; raises `pgran.options.SolutionError` beyond the limits."""
    table, base, exceeded = Report(Path(directory) / "sensitivity.csv", COLUMNS), {}, []
    for name, varied in CASES.items():
        path = result_file(directory, name)
        result = attempt(table, (name,), path, "biaxial", *options, *varied)
        if result is None:
            continue
        for row, snapshot in zip(band.measure(path), result.snapshots):
            I, label = snapshot["inertial_number"], snapshot.label
            reference = base.setdefault(label, I) if name == "base" else base.get(label)
            far = None if reference is None else (
                100 * difference(I, reference) / float(reference.max()))
            table.row(name, row["compression"], row["inertial_number_min"],
                      row["inertial_number_max"], far, row["angle"], row["width"], *cost(result))
        if far is not None and far > LIMITS.get(name, np.inf):
            exceeded.append(name)
    table.close()
    if exceeded:
        raise SolutionError(f"difference from the base beyond its limit: {', '.join(exceeded)}")
