"""SLEPc spectra compared with linear theory: spectra [directory]

The plane of wave vectors of figures 1(a) and 1(b), both laws over the inertial number, single wave
vectors over the inertial number, and the spectrum of the specimen on its frozen initial mesh over
its size, I0 and mesh.
"""

import subprocess
from itertools import product
from pathlib import Path

from pgran.runs import run_on_ranks

from .study import Report, command, write_text

FILE = "options/eigen.opts"
#: Models, I0 and wave vectors A d k of the table of single wave vectors.
SINGLE = (*product(("ngf", "li"), ("1e-4", "1e-3", "1e-2", "0.1", "1"), ("0.10,0.03",)),
          *(("li", "1e-3", k) for k in ("0.0325,0.0265", "0.065,0.053", "0.13,0.106",
                                        "0.26,0.212")))
#: I0, L (d) and element size (d) of specimens.
SPECIMENS = (*product(("1e-3",), (20, 40, 80, 160), (4, 2)), ("1e-3", 320, 8), ("1e-3", 320, 4),
             *product(("1e-4", "1e-2"), (20, 40, 80, 160), (4,)))
#: Target of the search, over the growth rate of theory: close to the eigenvalue.
CLOSE = 0.999
RATES = {"computed": ".8g", "analytic": ".8g", "relative error": ".2e"}


def eigen(*options):
    """Return the eigenvalues that pgran.eigen finds, a list of dictionaries."""
    return command(run_on_ranks.RANKS, "pgran.eigen", "-options_file", FILE, *options)


def values(row):
    """Return the values of the columns `RATES`."""
    return row["computed"], row["analytic"], row["relative_error"]


def single(model, number, k, *options):
    """Return the eigenvalue of one wave vector with the law of Jop."""
    flow = ("-pgran_law", "jop", "-pgran_model", model, "-pgran_inertial_number", number)
    rate = command(0, "pgran.stability", *flow, "-wave_vector", k)["growth_rate_gdot0"]
    rows = eigen(*options, *flow, "-wave_vector", k, "-target", CLOSE * rate, "-eps_nev", 2)
    return min(rows, key=lambda row: abs(row["analytic"] - rate))


def specimen(number, width, size, *options):
    """Return the eigenvalues of a specimen, complex, largest real part first."""
    return [complex(row["computed"], row["imaginary"]) for row in eigen(
        *options, "-pgran_case", "biaxial", "-pgran_inertial_number", number, "-pgran_width",
        width, "-pgran_element_size", size)]


def main(directory="results", *, options=()):
    """Make all tables."""
    directory, fine = Path(directory), ("-pgran_cell_elements", 32, *options)
    write_text("eigen_periodic", run_on_ranks.python(
        run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file", FILE, *options,
        stdout=subprocess.PIPE, text=True).stdout)
    for model in ("ngf", "li"):
        run_on_ranks.python(run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file", FILE,
                            *options, "-pgran_model", model, "-pgran_law", "jop", "-pgran_output",
                            directory / f"spectra_{model}.h5", "-sweep", 8, "-sweep_end", 0.19,
                            "-eps_nev", 4)
    table = Report(directory / "spectra_inertial_number.csv", {"I0": "", "law": "", **RATES})
    for law, number in product(("bingham", "jop"), ("1e-4", "1e-3", "3e-3", "1e-2")):
        table.row(number, law, *values(eigen(*fine, "-pgran_law", law, "-pgran_inertial_number",
                                             number, "-eps_nev", 1)[0]))
    table = Report(directory / "spectra_single.csv",
                   {"model": "", "I0": "", "wave vector": "", **RATES})
    for model, number, k in SINGLE:
        table.row(model, number, k, *values(single(model, number, k, *fine)))
    table = Report(directory / "spectra_specimen.csv", {
        "I0": "", "L (d)": "d", "element (d)": "g", "unstable modes found": "d",
        "leading eigenvalues (gdot0)": ""})
    for number, width, size in SPECIMENS:
        rates = specimen(number, width, size, *options)
        leading = (f"{rate.real:.4g}" + (f"{rate.imag:+.4g}i" if rate.imag else "")
                   for rate in rates[:4])
        table.row(number, width, size, sum(rate.real > 0 for rate in rates), ", ".join(leading))
