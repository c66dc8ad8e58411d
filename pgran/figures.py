"""Draw the paper's figures: python -m pgran.figures fig1 ... fig9 specimen

Writes figN.png and its numbers figN.h5, and prints each number of the paper's text with the
computed one. Figure 1 shows computed spectra if results/spectra_ngf.csv and spectra_li.csv exist
(bash jobs/study.sh spectra). Figures 3 to 7 need the runs of bash jobs/study.sh section4.
``specimen`` shows growth rates of a specimen between slipping plates.
"""

import sys

from .cli import run_without_petsc
from .options import command_option

OPTIONS = (command_option("output", "str", "directory of the pictures", "results/figures"),
           command_option("results", "str", "directory of the runs of figures 3 to 7",
                          "results/section4"))


def run(args, names):
    """Draw the figures and print their tables."""
    from .output import figures

    figures.draw(names, args.output, args.results)


def main(arguments):
    """Draw the figures named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "figures", run, __doc__, OPTIONS, operands="fig1 ... fig9")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
