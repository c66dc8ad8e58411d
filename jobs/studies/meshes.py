"""Do results converge with the mesh if the weak square does not? meshes [sizes: NGF] [sizes: LI]

The weak square keeps its side of 2 d, so that what is left of the differences in figures 6 and 7 is
that of the meshes. Element sizes are "2 1 0.5" for both models unless given. The table has the
differences of I between successive meshes, as `pgran.output.band.mesh_differences` tells.
"""

from pgran.output import band
from pgran.runs import run_on_ranks
from pgran.runs.table import COST, Table, cost

from .section4 import RESULTS

#: Options files of the models.
FILES = {"ngf": "options/biaxial.opts", "li": "options/li.opts"}
COLUMNS = {"model": "", "from (d)": "", "to (d)": "", "over L2 norm (%)": ".2f",
           "over maximum (%)": ".2f", "order": ".2f", **COST}


def main(ngf="2 1 0.5", li="2 1 0.5", *, options=()):
    """Make the runs and the table; costs are those of the finer run."""
    table = Table(RESULTS / "meshes.csv", COLUMNS)
    for model, sizes in (("ngf", ngf.split()), ("li", li.split())):
        paths = []
        for number, size in enumerate(sizes):
            paths.append(RESULTS / f"{model}_square_h{size}.h5")
            took = run_on_ranks.run(paths[-1], FILES[model], *run_on_ranks.QUIET, *options,
                              "-pgran_imperfection_size", 2, "-pgran_element_size", size)
            if number:
                found = band.compare(paths)[-1]
                table.row(model, sizes[number - 1], size, 100 * found["l2"],
                          100 * found["maximum"], found["order"], *cost(took))
