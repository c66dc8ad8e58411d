"""Localised or homogeneous: the state at 10 % compression over I0 and L, as a map.

    python jobs/regime.py [directory: results/regime]

NGF, elements of 2 d (3 d at L = 60 d, 4 d at 80 d), options/biaxial.opts otherwise. Dashed: the
shortest wavelength that grows in free space; red: growth rates of a column of that width
(pgran.growth). Writes regime.png and regime.csv; runs that are done are not repeated. About ten
minutes on two cores.
"""

import sys
from pathlib import Path

import numpy as np
from launch import RANKS, complete, python

from pgran import growth, measure, rheology, stability
from pgran.options import read

NUMBERS = 1e-4, 3e-4, 1e-3, 3e-3, 5e-3, 7e-3, 1e-2, 3e-2, 1e-1
WIDTHS = 20, 40, 60, 80


def main(directory="results/regime"):
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    directory = Path(directory)
    rows = []
    for width in WIDTHS:
        for number in NUMBERS:
            path = directory / f"L{width}_I{number:g}.h5"
            if not complete(path):
                done = python(RANKS, "-m", "pgran", "-options_file", "options/biaxial.opts",
                              "-pgran_width", width, "-pgran_inertial_number", number,
                              "-pgran_element_size", max(2, width // 20),
                              "-pgran_output", path, "-pgran_progress", "quiet", check=False)
                if done.returncode:
                    print(f"{path}: did not come to its end", flush=True)
                    continue
            row = measure.measure(path)[-1]
            rows.append((width, number, row["inertial_number_min"] / number,
                         row["inertial_number_max"] / number, row["localised"],
                         row["angle"] or np.nan, row["width"] or np.nan))
            print("L {} d, I0 {:g}: I/I0 {:.3f} to {:.3f}, localised {}, angle {:.1f}, "
                  "width {:.1f} d".format(*rows[-1]), flush=True)
    table = np.array(rows, dtype=float)
    np.savetxt(directory / "regime.csv", table, delimiter=",", comments="",
               header="width,I0,I_min_over_I0,I_max_over_I0,localised,angle,band_width")
    figure, axes = plt.subplots(figsize=(6.5, 4.6), constrained_layout=True)
    axes.set(xscale="log", xlabel="$I^0$", ylabel="$L/d$", xlim=(7e-5, 0.14), ylim=(10, 90))
    for localised, marker, label in ((1, "s", "localised"), (0, "o", "not localised")):
        part = table[table[:, 4] == localised]
        image = axes.scatter(part[:, 1], part[:, 0], c=part[:, 3] - part[:, 2], s=90,
                             marker=marker, cmap="viridis", norm=matplotlib.colors.LogNorm(
                                 1e-3, 10.0), edgecolors="black", label=label)
    settings = read({})
    I0 = np.geomspace(1e-4, 0.0167, 400)
    k_cut = stability.cutoff(stability.Coefficients.of(rheology.law_of(settings), "ngf", I0))
    wavelength = np.full_like(I0, np.nan)
    np.divide(2.0 * np.pi * settings.A, k_cut, out=wavelength, where=k_cut > 0.0)
    axes.plot(I0, wavelength, "k--", linewidth=1.0, label=r"$2\pi/k_{cut}$")
    numbers, widths = np.geomspace(7e-5, 0.14, 60), np.linspace(12.0, 90.0, 40)
    rates = [[growth.column_growth_rate(read({"pgran_width": str(width), "pgran_inertial_number":
                                              str(number)})) for number in numbers]
             for width in widths]
    lines = axes.contour(numbers, widths, rates, levels=(25, 50, 100, 200, 400, 800),
                         colors="tab:red", linewidths=0.8)
    axes.clabel(lines, fontsize=7, fmt=r"%g $\dot\gamma^0$")
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3)
    figure.colorbar(image, label="$(I_{max} - I_{min})/I^0$")
    figure.savefig(directory / "regime.png", dpi=150)
    print(directory / "regime.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
