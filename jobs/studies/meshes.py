"""Mesh convergence with a weakened square of fixed size: meshes [sizes: NGF] [sizes: LI] [end: LI]

NGF, LI with the law of Bingham type, which is ill-posed at I0 = 0.001, and LI with the law of
Barker and Gray, which is well-posed, on elements of "2 1 0.5" d. The square keeps its side of 2 d.
NGF is compressed by 10 %, LI by 0.01. The table has the range of I at the nodes, the number of
bands on a line up the specimen at L/4, and the difference of I from the previous mesh.
"""

from pathlib import Path

from pgran.output import band
from pgran.runs.table import COST, cost

from .study import Report, attempt

RESULTS = Path("results/meshes")
#: Model, law, options file.
MODELS = (("ngf", "bingham", "biaxial"), ("li", "bingham", "li"), ("li", "barker_gray", "li"))
COLUMNS = {"model": "", "law": "", "element (d)": "", "I from": ".3e", "I to": ".3e",
           "localised": "", "bands": "d", "over L2 norm (%)": ".2f", "over maximum (%)": ".2f",
           "order": ".2f", **COST}


def crossed(result):
    """Return how many bands a line of nodes at L/4 crosses in the last snapshot."""
    I = result.snapshots[-1]["inertial_number"]
    return band.stretches(I[:, I.shape[1] // 4] > result.options["inertial_number"])


def main(ngf="2 1 0.5", li="2 1 0.5", end="0.01", *, options=()):
    """Make the runs and the table."""
    table = Report(RESULTS / "meshes.csv", COLUMNS)
    for model, law, file in MODELS:
        paths, stop = [], ("-pgran_compression", end, "-pgran_snapshots", end)
        for size in (ngf if model == "ngf" else li).split():
            path = RESULTS / f"{model}_{law}_h{size}.h5"
            result = attempt(table, (model, law, size), path, file, *options, "-pgran_law", law,
                             "-pgran_element_size", size, "-pgran_imperfection_size", 2,
                             *(stop if model == "li" else ()))
            if result is None:
                continue
            paths.append(path)
            found = band.measure(path)[-1]
            change = band.compare(paths[-3:])[-1] if len(paths) > 1 else None
            table.row(model, law, size, found["inertial_number_min"], found["inertial_number_max"],
                      "yes" if found["localised"] else "no", crossed(result),
                      *([100 * change["l2"], 100 * change["maximum"], change["order"]]
                        if change else [None] * 3), *cost(result))
    table.close()
