"""Figures of the paper: section4 fig3 ... fig7 [element sizes], section4 theory

Figures 3 to 7 need runs; `theory` draws figures 1, 2, 8 and 9 and the growth rates of the specimen.
Element sizes such as "2 1 0.5" apply to figures 6 and 7. Results go to PGRAN_RESULTS
(results/section4), where figures share runs, and figures to results/figures.
"""

import os
from pathlib import Path

from pgran.runs import run_on_ranks

from .study import docs_file, write_tables

RESULTS = Path(os.environ.get("PGRAN_RESULTS", "results/section4"))
#: Width (d), I0 and element size (d) of the NGF runs, as in the names of their files.
RUNS = {"fig3": [("40", "0.001", "0.5")],
        "fig4": [(width, "0.001", "0.5") for width in ("20", "40", "60")],
        "fig5": [("40", I0, "0.5") for I0 in ("0.001", "0.007", "0.03")]}
#: The run of figure 3 ends at 14 % compression; figures 4 to 6 share it.
LONG = RUNS["fig3"][0]
THEORY = "fig1", "fig2", "fig8", "fig9", "specimen"
ALL = [("theory",), *((f"fig{number}",) for number in (3, 4, 5, 6, 7))]


def runs(figure, sizes, options=()):
    """Make the runs of a figure: NGF to 10 or 14 % compression, LI to 1 %."""
    if figure == "fig7":
        for size in sizes:
            run_on_ranks.run(RESULTS / f"li_L40_I0.001_h{size}.h5", "options/li.opts", *options,
                             "-pgran_element_size", size)
        return
    for width, I0, size in RUNS.get(figure) or [("40", "0.001", size) for size in sizes]:
        end, at = ("0.14", "0.05,0.10,0.14") if (width, I0, size) == LONG else ("0.10", "0.05,0.10")
        run_on_ranks.run(RESULTS / f"ngf_L{width}_I{I0}_h{size}.h5", "options/biaxial.opts",
                         *options, "-pgran_width", width, "-pgran_inertial_number", I0,
                         "-pgran_element_size", size, "-pgran_compression", end,
                         "-pgran_snapshots", at)


def main(figure, sizes="2 1 0.5", *, options=()):
    """Make the runs of a figure and draw it."""
    from pgran.output import figures

    if (figure,) not in ALL:
        raise ValueError(f"{figure}: expected one of: {', '.join(name for name, in ALL)}")
    if figure != "theory":
        runs(figure, sizes.split(), options)
    target = docs_file("figures", f"{figure}.png")
    write_tables(f"section4_{figure}", lambda: figures.draw(
        THEORY if figure == "theory" else [figure],
        target.parent if target else "results/figures", RESULTS))
