"""From the linear spectrum to the nonlinear solver: an eigenvector grows at its eigenvalue.

    python jobs/growth.py [directory: results/growth]

SLEPc's fastest mode of the periodic cell (pgran.eigen) seeds the nonlinear solver with inertia
on the moving mesh: once almost rigid and in equal steps, once less stiff and through saturation.
Prints the growth rate fitted to half the range of the inertial number while that is small, beside
the eigenvalue, and draws both: growth.png, and the numbers in growth.csv and saturation.csv.
Runs that are there are not repeated. About five minutes on two cores.
"""

import sys
from pathlib import Path

import h5py
import numpy as np
from launch import RANKS, complete, python

from pgran.options import written

ELEMENTS, STEP, SEED = 16, 2e-5, 1e-3
#: Shear moduli: almost rigid for the growth, softer where points fall below yield; |sigma_1|.
RIGID, SOFT = 1e8, 1e5
#: Half the range of I over I0 between which growth is fitted.
LINEAR = 3e-4, 3e-3


def eigenmode(path, elements):
    """Compute the fastest mode with pgran.eigen; return its growth rate, gdot0, and its options."""
    python(RANKS, "-m", "pgran.eigen", "-options_file", "options/eigen.opts", "-eps_nev", 2,
           "-refinement", elements, "-pgran_cell_elements", elements, "-pgran_output", path)
    with h5py.File(path) as file:
        return float(file.attrs["growth_rate"]), written(file.attrs["options"])


def grow(mode, settings, output, end, *more):
    """Run the nonlinear solver with inertia from a mode, to the time ``end``, 1/gdot0."""
    kept = ("case", "width", "height", "inertial_number", "cell_elements")
    given = [text for name in kept for text in (f"-pgran_{name}", settings[f"pgran_{name}"])]
    python(RANKS, "-m", "pgran", "-options_file", "options/direct.opts", *given,
           "-pgran_inertia", "true", "-pgran_imperfection", 1, "-pgran_seed", mode,
           "-pgran_seed_size", SEED, "-pgran_step_first", STEP, "-pgran_output", output,
           "-pgran_compression", 1 - np.exp(-end / 2), "-pgran_snapshots", 1 - np.exp(-end / 2),
           "-pgran_progress", "quiet", *more)


#: Options of `grow` for the exponential growth alone: rigid, with equal steps.
EXPONENTIAL = ("-pgran_shear_modulus", RIGID, "-pgran_step_max", STEP, "-pgran_step_error", 10)
#: And for the run beyond it: steps that follow what happens.
BEYOND = ("-pgran_shear_modulus", SOFT, "-pgran_step_max", 5 * STEP)


def history(path):
    """Return I0, time and half the range of I over I0 of the steps of a run."""
    with h5py.File(path) as file:
        I0 = float(written(file.attrs["options"])["pgran_inertial_number"])
        time, high, low = (file["history"][name][...] for name in (
            "time", "inertial_number_max", "inertial_number_min"))
    return I0, time, (high - low) / (2.0 * I0)


def fitted(time, span, window=LINEAR):
    """Return the growth rate where ``span`` passes a window for good, None where it does not."""
    if span[-1] < window[1]:
        return None
    first = np.flatnonzero(span < window[0])
    first = first[-1] + 1 if first.size else 0
    last = first + np.argmax(span[first:] > window[1])
    if last - first < 4:
        return None
    return float(np.polyfit(time[first:last], np.log(span[first:last]), 1)[0])


def main(directory="results/growth"):
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    mode = directory / "mode.h5"
    rate, settings = eigenmode(mode, ELEMENTS)
    figure, axes = plt.subplots(figsize=(5.5, 4.0), constrained_layout=True)
    for name, end, how, line in (("growth", 0.012, EXPONENTIAL, "k"),
                                 ("saturation", 0.03, BEYOND, "tab:blue")):
        path = directory / f"{name}.h5"
        if not complete(path):
            grow(mode, settings, path, end, *how)
        _, time, span = history(path)
        found = fitted(time, span)
        print(f"{ELEMENTS} x {ELEMENTS} elements, G = {how[1]:g}: eigenvalue {rate:.3f} gdot0, "
              f"growth in the nonlinear run {found:.3f} gdot0 ({100 * (found / rate - 1):+.2f} %), "
              f"half the range of I over I0 up to {span.max():.3g}")
        np.savetxt(directory / f"{name}.csv", np.stack([time, span], axis=1), delimiter=",",
                   header="time,half_range_of_I_over_I0", comments="")
        axes.semilogy(time, span, line, label=f"nonlinear solver with inertia, G = {how[1]:g}")
        if name == "growth":
            middle = np.argmax(span > np.sqrt(LINEAR[0] * LINEAR[1]))
            straight = span[middle] * np.exp(rate * (np.array([0.0, 0.02]) - time[middle]))
    axes.semilogy([0.0, 0.02], straight, "--", color="tab:red",
                  label=rf"eigenvalue, {rate:.1f} $\dot\gamma^0$")
    axes.set(xlabel=r"$t\,\dot\gamma^0$", ylabel=r"$(I_{max} - I_{min})/2I^0$", ylim=(1e-4, 0.2))
    axes.legend(fontsize=8)
    figure.savefig(directory / "growth.png", dpi=150)
    print(directory / "growth.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
