"""Map of localisation at 10 % compression over I0 and L: regime [directory]

NGF on elements of 2 d (3 d at L = 60 d, 4 d at 80 d). The figure has the range of I over I0 of each
run. Red lines are analytical growth rates of the specimen (`pgran.theory.specimen`). The dashed
line is the shortest wavelength that grows in an infinite medium.
"""

from pathlib import Path

import numpy as np

from pgran import cases
from pgran.output import band
from pgran.runs.table import result_file
from pgran.theory import specimen, waves

from .study import Report, attempt, figure

NUMBERS = 1e-4, 3e-4, 1e-3, 3e-3, 5e-3, 7e-3, 1e-2, 3e-2, 1e-1
WIDTHS = 20, 40, 60, 80
#: Growth rates of the lines, gdot0.
LEVELS = 25, 50, 100, 200, 400, 800
COLUMNS = {"width": "g", "I0": "g", "I_min_over_I0": ".3f", "I_max_over_I0": ".3f",
           "localised": "d", "angle": ".1f", "band_width": ".1f"}


def rates(numbers, widths):
    """Return the analytical growth rates (widths, numbers) of sway, gdot0, for H = 3 L."""
    parameters = cases.read({})
    law = parameters.part("law").of(parameters)
    return np.array([[specimen.growth_rate(
        law, "ngf", inertial_number=number, width=width, height=3.0 * width,
        amplitude=parameters.A) for number in numbers] for width in widths])


def main(directory="results/regime", *, options=()):
    """Make the runs, the table and the map."""
    table, rows = Report(Path(directory) / "regime.csv", COLUMNS), []
    for width in WIDTHS:
        for number in NUMBERS:
            path = result_file(directory, f"L{width}_I{number:g}")
            if attempt(table, (f"{width}", f"{number:g}"), path, "biaxial", *options,
                       "-pgran_width", width, "-pgran_inertial_number", number,
                       "-pgran_element_size", max(2, width // 20)):
                row = band.measure(path)[-1]
                rows.append((width, number, row["inertial_number_min"] / number,
                             row["inertial_number_max"] / number, row["localised"]))
                table.row(*rows[-1], row["angle"], row["width"])
    table.close()
    draw(np.array(rows, dtype=float), Path(directory) / "regime.png")


def draw(rows, path):
    """Draw the map of ``rows`` (n, 5), the first columns of the table."""
    from matplotlib.colors import LogNorm

    parameters = cases.read({})
    I0 = np.geomspace(1e-4, 0.0167, 400)
    k_cut = waves.cutoff(waves.Coefficients.of(parameters.part("law").of(parameters), "ngf", I0))
    wavelength = np.full_like(I0, np.nan)
    np.divide(2.0 * np.pi * parameters.A, k_cut, out=wavelength, where=k_cut > 0.0)
    numbers, widths = np.geomspace(7e-5, 0.14, 32), np.linspace(12.0, 90.0, 20)
    with figure(path, figsize=(6.5, 4.6)) as (canvas, axes):
        axes.set(xscale="log", xlabel="$I^0$", ylabel="$L/d$", xlim=(7e-5, 0.14), ylim=(10, 90))
        for localised, marker, label in ((1, "s", "localised"), (0, "o", "not localised")):
            width, number, low, high, _ = rows[rows[:, 4] == localised].T
            image = axes.scatter(number, width, c=high - low, s=90, marker=marker, cmap="viridis",
                                 norm=LogNorm(1e-3, 10.0), edgecolors="black", label=label)
        axes.plot(I0, wavelength, "k--", linewidth=1.0, label=r"$2\pi/k_{cut}$")
        lines = axes.contour(numbers, widths, rates(numbers, widths), levels=LEVELS,
                             colors="tab:red", linewidths=0.8)
        axes.clabel(lines, fontsize=7, fmt=r"%g $\dot\gamma^0$")
        axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3)
        canvas.colorbar(image, label="$(I_{max} - I_{min})/I^0$")
