"""Steady and dynamic NGF in the reference simulation: primitive [element sizes] [directory]

The reference simulation with the dynamic ("primitive") form of NGF on elements of "2 1" d, compared
with the steady form. t0 ranges from 1e-4 to 1 times T, the e-folding time of creep buckling with
the steady form. While the specimen is loaded, mu < mu_s and g decays; the elastic element is
stiffer than in the reference simulation, so that loading takes less time than t0.

The first table has growth rates: of the fastest wave in an infinite medium, of the specimen
(analytical), of the creep-buckling column, of the linearised step (pgran.growth), of this step
corrected for the current shape, and of nonlinear runs with a faint imperfection. The second has the
band in each snapshot: the onset is the compression at which the largest I passes 1.5 I0 for good,
and the difference compares I with the steady form at the same material points, in the L2 norm.
"""

from pathlib import Path

import numpy as np

from pgran import cases
from pgran.output import band
from pgran.runs import run_on_ranks
from pgran.runs.table import COST, cost, result_file
from pgran.theory import waves

from . import specimen
from .study import Report, attempt, figure

#: t0 over T; None is the steady form.
SHARES = None, 1e-4, 1e-3, 1e-2, 1e-1, 1.0
#: A stiffer elastic element than in the reference simulation.
STIFF = "-pgran_shear_modulus", 1e5
#: I over I0 beyond which flow is no longer homogeneous.
ONSET = 1.5
#: Time for growth, and step, over the e-folding time.
GROWTH, RESOLVED = 16.0, 0.1
RATES = {"t0/T": "", "t0 (1/gdot0)": ".2e", "wave": ".1f", "wavelength (d)": ".1f",
         "analytical": ".1f", "column": ".1f", "linearised step": ".1f",
         "corrected for the current shape": ".1f", "nonlinear run": ".1f"}
COLUMNS = {"element (d)": "", "t0/T": "", "compression": "g", "onset (%)": ".2f",
           "I max": ".3e", "10th percentile of I/I0": ".2e", "below mu_s (%)": ".1f",
           "localised": "", "angle": ".1f", "width": ".1f", "difference (%)": ".2f", **COST}


def forms(options):
    """Yield the name, t0 (1/gdot0; None for the steady form) and the options of each form of NGF.

    ``options`` apply to all runs.
    """
    growing = 1.0 / specimen.analytical(options).real
    for share in SHARES:
        if share is None:
            yield "steady", None, tuple(options)
        else:
            t0 = float(f"{share * growing:.4g}")
            yield f"{share:g}", t0, (*options, "-pgran_model", "ngf_primitive",
                                     "-pgran_relaxation_time", t0)


def wave(options):
    """Return growth rate (gdot0) and length (d) of the fastest wave in an infinite medium."""
    parameters = cases.read(run_on_ranks.parsed(options))
    coefficients = waves.Coefficients.of_run(parameters)
    k, rate, _ = waves.fastest(coefficients)
    return (float(rate * waves.viscous_rate(coefficients.mu, parameters.A, parameters.phi,
                                            parameters.inertial_number)),
            float(2.0 * np.pi * parameters.A / k))


def rates_table(directory, options):
    """Write the table of growth rates; return its rows."""
    table, rows = Report(directory / "rates.csv", RATES, "primitive_rates"), []
    for name, t0, given in forms(options):
        closed, step = specimen.analytical(given).real, specimen.predicted(*given)[0].real
        found, time = specimen.measured(
            result_file(directory, f"faint {name}"), *given, step=RESOLVED / closed,
            end=1.0 - np.exp(-GROWTH / closed / 2.0))
        then = step * specimen.later(given, time) if found else None
        rows.append((name, t0, *wave(given), closed, specimen.column(given), step, then, found))
        table.row(*rows[-1])
    return rows


def quiescent(result):
    """Return for each snapshot the 10th percentile of I/I0 by area, and the % below mu_s."""
    found = []
    I0, yield_ratio = (result.options[name] for name in ("inertial_number", "mu_s"))
    for snapshot in result.snapshots:
        area = band.node_areas(snapshot.x)
        I, mu = (snapshot[name] for name in ("inertial_number", "stress_ratio"))
        order = np.argsort(I, axis=None)
        tenth = np.searchsorted(np.cumsum(area.ravel()[order]), 0.1 * area.sum())
        found.append((float(I.ravel()[order][tenth] / I0),
                      100.0 * float(area[mu < yield_ratio].sum() / area.sum())))
    return found


def history(result):
    """Return the compressions (n,) of the steps of a run, and the largest I over I0 (n,)."""
    return (result.history["compression"],
            result.history["inertial_number_max"] / result.options["inertial_number"])


def onset(result):
    """Return the compression (%) after which the largest I exceeds `ONSET` I0, or None."""
    compression, largest = history(result)
    last = np.flatnonzero(largest < ONSET)[-1]
    return None if last + 1 == len(largest) else 100.0 * float(compression[last + 1])


def band_table(directory, sizes, options):
    """Make the runs and their table; return the histories of the first size."""
    table, curves = Report(directory / "primitive.csv", COLUMNS), []
    for size in sizes:
        reference = None
        for name, _, given in forms(options):
            path = result_file(directory, f"{name} h{size}")
            result = attempt(table, (size, name), path, "biaxial", *given, "-pgran_element_size",
                             size)
            if result is None:
                continue
            reference = reference or path
            for row, (quiet, below) in zip(band.measure(path), quiescent(result)):
                far = 100.0 * band.compare([path, reference])[0]["l2"]
                table.row(size, name, row["compression"], onset(result), row["inertial_number_max"],
                          quiet, below, "yes" if row["localised"] else "no", row["angle"],
                          row["width"], far, *cost(result))
            if size == sizes[0]:
                curves.append((name, *history(result)))
    table.close()
    return curves


def main(sizes="2 1", directory="results/primitive", *, options=()):
    """Make the runs, the tables and the picture."""
    directory, options, sizes = Path(directory), (*STIFF, *options), sizes.split()
    rates = rates_table(directory, ("-pgran_element_size", sizes[0], *options))
    print()
    draw(rates, band_table(directory, sizes, options), directory / "primitive.png")


def draw(rates, curves, path):
    """Draw growth rates over t0, and the largest I of each run over compression.

    ``rates`` are rows of `RATES`, and ``curves`` have a name, compressions (n,) and I/I0 (n,).
    """
    import matplotlib

    (_, _, *steady), *relaxing = rates
    t0, columns = [row[1] for row in relaxing], list(zip(*(row[2:] for row in relaxing)))
    with figure(path, 1, 2, figsize=(10.0, 4.0)) as (_, (left, right)):
        for n, label, style in ((0, "wave in an infinite medium", "k--"),
                                (2, "analytical", "tab:red"), (3, "column", "tab:blue"),
                                (4, "linearised step", "ko")):
            left.loglog(t0, columns[n], style, label=label, fillstyle="none")
            left.axhline(steady[n], color="0.8", linewidth=0.8, zorder=0)
        left.set(xlabel=r"$t_0\,\dot\gamma^0$", ylabel=r"growth rate over $\dot\gamma^0$")
        left.legend(fontsize=8, title="grey: steady form", title_fontsize=8)
        for (name, compression, largest), shade in zip(curves, np.linspace(0.0, 0.9, len(curves))):
            right.plot(100.0 * compression, largest, color=matplotlib.cm.viridis(shade),
                       label=name if name == curves[0][0] else f"$t_0 = {name}\\,T$")
        right.set(xlabel="compression (%)", ylabel="$I_{max}/I^0$")
        right.legend(fontsize=8)
