"""Computed and analytical spectra of homogeneous flow."""

import subprocess
from itertools import product
from operator import itemgetter
from pathlib import Path

from pgran.runs import run_on_ranks

from . import study

#: Models, I0 and wave vectors A d k of the table of single wave vectors.
SINGLE = (*product(("ngf", "li"), ("1e-4", "1e-3", "1e-2", "0.1", "1"), ("0.10,0.03",)),
          *(("li", "1e-3", k) for k in ("0.0325,0.0265", "0.065,0.053", "0.13,0.106",
                                        "0.26,0.212")))
#: I0, L (d) and element size (d) of specimens.
SPECIMENS = (*product(("1e-3",), (20, 40, 80, 160), (4, 2)), ("1e-3", 320, 8), ("1e-3", 320, 4),
             *product(("1e-4", "1e-2"), (20, 40, 80, 160), (4,)))
#: Target of the eigenvalue solver over the analytical growth rate.
TARGET = 0.999
RATES = {"computed": ".8g", "analytic": ".8g", "relative error": ".2e"}
values = itemgetter("computed", "analytic", "relative_error")


def eigen(*options):
    """Return the eigenvalues that pgran.eigen finds, a list of dictionaries."""
    return study.json_of(run_on_ranks.RANKS, "pgran.eigen", "-options_file", "options/eigen.opts",
                         *options, "-json")


def single(model, number, k, *options):
    """Return the eigenvalue of one wave vector with the law of Jop."""
    flow = ("-pgran_law", "jop", "-pgran_model", model, "-pgran_inertial_number", number)
    rate = study.json_of(0, "pgran.stability", *flow, "-wave_vector", k, "-json")[
        "growth_rate_gdot0"]
    rows = eigen(*options, *flow, "-wave_vector", k, "-target", TARGET * rate, "-eps_nev", 2)
    return min(rows, key=lambda row: abs(row["analytic"] - rate))


def specimen(number, width, size, *options):
    """Return the eigenvalues of a specimen, complex, largest real part first."""
    return [complex(row["computed"], row["imaginary"]) for row in eigen(
        *options, "-pgran_case", "biaxial", "-pgran_inertial_number", number, "-pgran_width",
        width, "-pgran_element_size", size)]


def specimen_rows(*options):
    """Yield the number of unstable modes and the leading eigenvalues of each specimen."""
    for number, width, size in SPECIMENS:
        rates = specimen(number, width, size, *options)
        leading = (f"{rate.real:.4g}" + (f"{rate.imag:+.4g}i" if rate.imag else "")
                   for rate in rates[:4])
        yield number, width, size, sum(rate.real > 0 for rate in rates), ", ".join(leading)


def spectra(directory="results", *, options=()):
    """Computed (SLEPc) and analytical spectra: spectra [directory]

    Spectra of pgran.eigen over the plane of wave vectors of figures 1(a) and 1(b), both laws over
    the inertial number, single wave vectors over the inertial number, and the specimen on its
    initial mesh over its size, I0 and mesh. Then it draws figures 1, 2, 8 and 9. A
    quarter of an hour on two cores, mostly for the specimens of 320 d.
    """
    directory, fine = Path(directory), ("-pgran_cell_elements", 32, *options)
    for model in ("ngf", "li"):
        run_on_ranks.python(run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file",
                            "options/eigen.opts", *options, "-pgran_model", model, "-pgran_law",
                            "jop", "-pgran_output", directory / f"spectra_{model}.h5", "-sweep", 8,
                            "-sweep_end", 0.19, "-eps_nev", 4)
    study.write_table(
        directory / "spectra_inertial_number.csv", {"I0": "", "law": "", **RATES},
        ((number, law, *values(eigen(*fine, "-pgran_law", law, "-pgran_inertial_number", number,
                                     "-eps_nev", 1)[0]))
         for law, number in product(("bingham", "jop"), ("1e-4", "1e-3", "3e-3", "1e-2"))))
    study.write_table(
        directory / "spectra_single.csv", {"model": "", "I0": "", "wave vector": "", **RATES},
        ((*point, *values(single(*point, *fine))) for point in SINGLE))
    study.write_table(
        directory / "spectra_specimen.csv", {
            "I0": "", "L (d)": "d", "element (d)": "g", "unstable modes found": "d",
            "leading eigenvalues (gdot0)": ""}, specimen_rows(*options))
    text = run_on_ranks.python(run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file",
                               "options/eigen.opts", *options, stdout=subprocess.PIPE,
                               text=True).stdout
    study.write_page("eigen_periodic", f"```text\n{text}```")
    text = study.paper_figures(["fig1", "fig2", "fig8", "fig9", "specimen"], directory)
    study.write_page("figures_numbers", "\n".join(
        line for line in text.splitlines() if line.startswith("|") or not line))
