"""Steady and dynamic NGF in the reference simulation."""

from pathlib import Path

import numpy as np

from pgran.output import band
from pgran.theory import waves

from . import specimen, study
from .study import COST, cost, result_file

#: t0 over T; None is steady NGF.
SHARES = None, 1e-4, 1e-3, 1e-2, 1e-1, 1.0
#: A stiffer elastic element, so that loading takes less time than t0: g decays during loading.
STIFF = "-pgran_shear_modulus", 1e5
#: I over I0 beyond which flow is not homogeneous.
ONSET = 1.5
#: End time and step, over the time for growth by a factor e.
GROWTH, RESOLVED = 16.0, 0.1
RATES = {"t0/T": "", "t0 (1/gdot0)": ".2e", "fastest wave": ".1f", "its length (d)": ".1f",
         "specimen, analytical": ".1f", "column": ".1f", "linearised step": ".1f",
         "corrected for the current shape": ".1f", "nonlinear run": ".1f"}
COLUMNS = {"element (d)": "", "t0/T": "", "compression": "g", "onset (%)": ".2f",
           "I max": ".3e", "10th percentile of I/I0": ".2e", "below mu_s (%)": ".1f",
           "localised": "", "angle": ".1f", "width": ".1f", "difference (%)": ".2f", **COST}


def forms(options):
    """Yield the name, t0 (1/gdot0; None for steady NGF) and the options of each form of NGF."""
    T = 1.0 / specimen.analytical(options).real
    for share in SHARES:
        if share is None:
            yield "steady NGF", None, tuple(options)
        else:
            t0 = float(f"{share * T:.4g}")
            yield f"{share:g}", t0, (*options, "-pgran_model", "ngf_primitive",
                                     "-pgran_relaxation_time", t0)


def wave(options):
    """Return growth rate (gdot0) and length (d) of the fastest wave in an infinite medium."""
    parameters = study.parameters(None, *options)
    coefficients = waves.Coefficients.of_run(parameters)
    k, rate, _ = waves.fastest(coefficients)
    return (float(rate * waves.viscous_rate(coefficients.mu, parameters.A, parameters.phi,
                                            parameters.inertial_number)),
            float(2.0 * np.pi * parameters.A / k))


def rates_rows(directory, options):
    """Yield the growth rates of each form of NGF."""
    for name, t0, more in forms(options):
        rate, step = specimen.analytical(more).real, specimen.predicted(*more)[0].real
        found, time = specimen.measured(
            result_file(directory, f"faint {name}"), *more, step=RESOLVED / rate,
            end=1.0 - np.exp(-GROWTH / rate / 2.0))
        then = step * specimen.later(more, time) if found else None
        yield name, t0, *wave(more), rate, specimen.column(more), step, then, found


def quiescent(result, snapshot):
    """Return the 10th percentile of I/I0 by area, and the share of area (%) below mu_s."""
    I0, mu_s = (result.options[name] for name in ("inertial_number", "mu_s"))
    area = band.node_areas(snapshot.x)
    I, mu = (snapshot[name] for name in ("inertial_number", "stress_ratio"))
    order = np.argsort(I, axis=None)
    tenth = np.searchsorted(np.cumsum(area.ravel()[order]), 0.1 * area.sum())
    return float(I.ravel()[order][tenth] / I0), 100.0 * float(area[mu < mu_s].sum() / area.sum())


def history(result):
    """Return the compressions (n,) of the steps of a run, and the largest I over I0 (n,)."""
    return (result.history["compression"],
            result.history["inertial_number_max"] / result.options["inertial_number"])


def onset(result):
    """Return the compression (%) after which the largest I exceeds `ONSET` I0, or None."""
    compression, largest = history(result)
    last = np.flatnonzero(largest < ONSET)[-1]
    return None if last + 1 == len(largest) else 100.0 * float(compression[last + 1])


def band_rows(directory, sizes, options, curves):
    """Yield the band in each snapshot; append the histories of the first size to ``curves``."""
    for size in sizes:
        steady = None
        for name, _, more in forms(options):
            path = result_file(directory, f"{name} h{size}")
            result = study.run(path, "biaxial", *more, "-pgran_element_size", size, needed=False)
            if result is None:
                yield size, name, "run failed"
                continue
            steady = steady or path
            difference = 100.0 * band.compare([path, steady])[0]["l2"]
            for row, snapshot in zip(band.measure(path), result.snapshots):
                yield (size, name, row["compression"], onset(result), row["inertial_number_max"],
                       *quiescent(result, snapshot), "yes" if row["localised"] else "no",
                       row["angle"], row["width"], difference, *cost(result))
            if size == sizes[0]:
                curves.append((name, *history(result)))


def primitive(sizes="2 1", directory="results/primitive", *, options=()):
    """Steady and dynamic NGF in the reference simulation: primitive [element sizes] [directory]

    t0 is 1e-4 to 1 times T, the time for growth of creep buckling by e with steady NGF. The first
    table contains growth rates: of the fastest wave, of the specimen (analytical, column,
    linearised step) and of nonlinear runs with a small imperfection. The second table contains the
    band in each snapshot. After the onset the largest I exceeds 1.5 I0, and the
    difference is the L2 norm of the difference of I from steady NGF at the same material points.
    A quarter of an hour on two cores.
    """
    directory, options, sizes, curves = Path(directory), (*STIFF, *options), sizes.split(), []
    rates = study.write_table(
        directory / "primitive_rates.csv", RATES,
        rates_rows(directory, ("-pgran_element_size", sizes[0], *options)))
    study.write_table(directory / "primitive.csv", COLUMNS,
                      band_rows(directory, sizes, options, curves))
    with study.figure("primitive", 1, 2, figsize=(10.0, 4.0)) as (_, (left, right)):
        (_, _, *steady), *dynamic = rates
        t0, columns = [row[1] for row in dynamic], list(zip(*(row[2:] for row in dynamic)))
        for n, label, style in ((0, "wave in an infinite medium", "k--"),
                                (2, "specimen, analytical", "tab:red"), (3, "column", "tab:blue"),
                                (4, "linearised step", "ko")):
            left.loglog(t0, columns[n], style, label=label, fillstyle="none")
            left.axhline(steady[n], color="0.8", linewidth=0.8, zorder=0)
        left.set(xlabel=r"$t_0\,\dot\gamma^0$", ylabel=r"growth rate over $\dot\gamma^0$")
        left.legend(fontsize=8, title="grey: steady NGF", title_fontsize=8)
        for name, compression, largest in curves:
            right.plot(100.0 * compression, largest,
                       label=name if name == curves[0][0] else f"$t_0 = {name}\\,T$")
        right.set(xlabel="compression (%)", ylabel="$I_{max}/I^0$")
        right.legend(fontsize=8)
