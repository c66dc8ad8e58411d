"""Does the answer of the main job depend on step, stiffness or mesh? verify [directory]

Stiffer elasticity, smaller steps, half the element size, and a larger inertial number. The
difference from the base is that of I at the same material points at the end, the largest over the
specimen, over the largest I of the base. The study fails where it exceeds `LIMITS`.
"""

from pathlib import Path

import numpy as np

from pgran.options import SolutionError
from pgran.output import band
from pgran.runs import run_on_ranks
from pgran.runs.table import Table

CASES = {
    "base": (),
    "stiff": ("-pgran_shear_modulus", 10000),
    "small_steps": ("-pgran_step_max", 0.001, "-pgran_step_error", 0.05),
    "fine": ("-pgran_element_size", 1),
    "inertial": ("-pgran_inertial_number", 0.03)}
#: Largest difference from the base, per cent of the largest I.
LIMITS = {"stiff": 3.0, "small_steps": 2.0, "fine": 10.0}
#: Where flow stays homogeneous, I departs from I0 by less than this share.
HOMOGENEOUS = "inertial", 0.02
COLUMNS = {"run": "", "I min": ".4e", "I max": ".4e", "to base (%)": "+.2f",
           "difference (%)": ".2f", "angle": ".1f", "width": ".1f"}


def difference(fine, coarse):
    """Return the largest difference of two fields (ny, nx) at nodes of the coarse one."""
    step = (len(fine) - 1) // (len(coarse) - 1)
    return float(np.abs(fine[::step, ::step] - coarse).max())


def main(directory="results/verify", *, options=()):
    """Make the runs and the table; raises `pgran.options.SolutionError` beyond the limits."""
    table, wrong = Table(Path(directory) / "verify.csv", COLUMNS), []
    for name, varied in CASES.items():
        path = Path(directory) / f"{name}.h5"
        result = run_on_ranks.run(path, "options/biaxial.opts", * \
                                  run_on_ranks.QUIET, *options, *varied)
        row = band.measure(path)[-1]
        low, high = row["inertial_number_min"], row["inertial_number_max"]
        I, I0 = result.snapshots[-1]["inertial_number"], result.options["inertial_number"]
        if name == HOMOGENEOUS[0]:
            table.row(name, low, high, None, None, row["angle"], row["width"])
            if max(abs(low / I0 - 1.0), abs(high / I0 - 1.0)) >= HOMOGENEOUS[1]:
                wrong.append(name)
            continue
        if name == "base":
            base, largest = I, high
        apart = 100 * difference(I, base) / largest
        table.row(name, low, high, 100 * (high / largest - 1), apart, row["angle"], row["width"])
        if apart > LIMITS.get(name, np.inf):
            wrong.append(name)
    if wrong:
        raise SolutionError(f"beyond the limits: {', '.join(wrong)}")
