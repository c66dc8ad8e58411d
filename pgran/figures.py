"""Draw the paper's figures: python -m pgran.figures fig1 ... fig9 specimen

Writes figN.png and, as figN.h5, the numbers behind it, and prints each number that the paper's
text states beside the computed one. Where results/spectra_ngf.csv and results/spectra_li.csv exist
(bash jobs/spectra.sh), figure 1 shows SLEPc's points on its contours. Figures 3 to 7 are drawn
from the runs that jobs/fig3.sh to jobs/fig7.sh make. ``specimen`` is not in the paper: it shows
the growth rates of the specimen between plates.
"""

import sys

from .cli import command_option, run_without_petsc

OPTIONS = (command_option("output", "str", "directory of the pictures", "results/figures"),
        command_option("results", "str", "directory of the runs of section 4", "results/section4"))


def run(asked, names):
    """Draw the figures and print their tables."""
    from .output import figures

    figures.draw(names, asked.output, asked.results)


def main(arguments):
    """Draw the figures named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "figures", run, __doc__, OPTIONS, operands="fig1 ... fig9")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
