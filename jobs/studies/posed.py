"""Does LI depend on the mesh where its law is well-posed? posed [sizes] [compression] [directory]

LI with the law of Bingham, which is ill-posed at I0 = 0.001, and with that of Barker and Gray,
which is not, on elements of "2 1 0.5" d to a compression of 0.01. The weak square keeps its side of
2 d.
The table has the range of I at the nodes, whether flow is localised, the number of bands, where
I > I0, that a line up the specimen at L/4 crosses, and the difference of I from the mesh before.
"""

from pathlib import Path

from pgran.output import band
from pgran.runs import run_on_ranks
from pgran.runs.table import COST, Table, cost

LAWS = "bingham", "barker_gray"
COLUMNS = {"law": "", "element (d)": "", "I from": ".3e", "I to": ".3e", "localised": "",
           "bands": "d", "over L2 norm (%)": ".2f", "over maximum (%)": ".2f",
           **COST}


def crossed(result):
    """Return how many bands a line of nodes at L/4 crosses in the last snapshot."""
    I = result.snapshots[-1]["inertial_number"]
    return band.stretches(I[:, I.shape[1] // 4] > result.options["inertial_number"])


def main(sizes="2 1 0.5", compression="0.01", directory="results/posed", *, options=()):
    """Make the runs and the table."""
    table = Table(Path(directory) / "posed.csv", COLUMNS)
    for law in LAWS:
        paths = []
        for size in sizes.split():
            path = Path(directory) / f"{law}_h{size}_c{compression}.h5"
            took = run_on_ranks.run(path, "options/li.opts", *run_on_ranks.QUIET, *options, "-pgran_law", law,
                              "-pgran_element_size", size, "-pgran_imperfection_size", 2,
                              "-pgran_compression", compression, "-pgran_snapshots", compression,
                              needed=False)
            if took is None:
                table.note(law, size, "did not come to its end")
                continue
            paths.append(path)
            found = band.measure(path)[-1]
            apart = band.compare(paths[-2:])[0] if len(paths) > 1 else None
            table.row(law, size, found["inertial_number_min"], found["inertial_number_max"],
                      "yes" if found["localised"] else "no", crossed(took), *(
                          [100 * apart["l2"], 100 * apart["maximum"]] if apart else [None, None]),
                      *cost(took))
    table.close()
