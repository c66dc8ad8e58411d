"""How does the band of figure 3 depend on what the paper does not state? sensitivity [directory]

Elastic modulus, step, imperfection, law and plates, on elements of 2 d. Options hold for all runs.
The table has the band in each snapshot (5 and 10 %) and the cost of each run. Meshes are the matter
of `studies.meshes`.
"""

from pathlib import Path

from pgran.options import RUN
from pgran.output import band
from pgran.runs import run_on_ranks
from pgran.runs.table import COST, Table, cost, result_file

#: The step error of the base.
DEFAULT = next(row.default for row in RUN if row.name == "step_error")
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
    "imperfection 0.9": ("-pgran_imperfection", 0.9),
    "imperfection 0.95": ("-pgran_imperfection", 0.95),
    "imperfection 0.999": ("-pgran_imperfection", 0.999),
    "weak square of 4 d": ("-pgran_imperfection_size", 4),
    "mirrored": ("-pgran_imperfection_mirrored", "true"),
    "Jop": ("-pgran_law", "jop"),
    "plates that hold": ("-pgran_plates_slip", "false")}
COLUMNS = {"case": "", "compression": "g", "I max": ".3e", "angle": ".1f", "width": ".1f", **COST}


def main(directory="results/sensitivity", *, options=()):
    """Make the runs and the table."""
    table = Table(Path(directory) / "sensitivity.csv", COLUMNS)
    for name, varied in CASES.items():
        path = result_file(directory, name)
        took = run_on_ranks.run(path, "options/biaxial.opts", *run_on_ranks.QUIET, *options, *varied,
                          needed=False)
        if took is None:
            table.note(name, "did not come to its end")
            continue
        for row in band.measure(path):
            table.row(name, row["compression"], row["inertial_number_max"], row["angle"],
                      row["width"], *cost(took))
    table.close()
