"""From the linear spectrum to the nonlinear solver: an eigenvector grows at its eigenvalue.

    python jobs/growth.py [directory: results/growth]

SLEPc's fastest mode of the periodic cell (pgran.eigen) seeds the nonlinear solver with inertia
and almost rigid elasticity, on the moving mesh. Prints the growth rate fitted to half the range of
the inertial number while that is small, beside the eigenvalue, and draws it: growth.png, and the
numbers in growth.csv. About a minute on two cores.
"""

import sys
from pathlib import Path

import h5py
import numpy as np
from launch import python

ELEMENTS, STEP, SEED, ELASTIC = 16, 2e-5, 1e-3, 1e8
#: Half the range of I over I0 between which growth is fitted.
LINEAR = 3e-4, 3e-3


def eigenmode(path, elements, ranks=2):
    """Compute the fastest mode with pgran.eigen; return its growth rate, gdot0, and its options."""
    python(ranks, "-m", "pgran.eigen", "-options_file", "options/eigen.opts", "-eps_nev", 2,
           "-refinement", elements, "-pgran_cell_elements", elements, "-pgran_output", path)
    with h5py.File(path) as file:
        settings = dict(line[1:].split(" ", 1) for line in file.attrs["options"].splitlines())
        return float(file.attrs["growth_rate"]), settings


def grow(mode, settings, output, end, *more, ranks=2):
    """Run the nonlinear solver from a mode; return time and half the range of I over I0."""
    kept = ("case", "width", "height", "inertial_number", "cell_elements")
    given = [text for name in kept for text in (f"-pgran_{name}", settings[f"pgran_{name}"])]
    python(ranks, "-m", "pgran", "-options_file", "options/direct.opts", *given,
           "-pgran_inertia", "true", "-pgran_imperfection", 1, "-pgran_seed", mode,
           "-pgran_seed_size", SEED, "-pgran_shear_modulus", ELASTIC, "-pgran_step_first", STEP,
           "-pgran_step_max", STEP, "-pgran_step_error", 10, "-pgran_output", output,
           "-pgran_compression", 1 - np.exp(-end / 2), "-pgran_snapshots", 0.5,
           "-pgran_progress", "quiet", *more)
    with h5py.File(output) as file:
        history = {name: data[...] for name, data in file["history"].items()}
    I0 = float(settings["pgran_inertial_number"])
    span = (history["inertial_number_max"] - history["inertial_number_min"]) / (2 * I0)
    return history["time"], span


def fitted(time, span):
    """Return the growth rate, gdot0, fitted where ``span`` lies between `LINEAR`."""
    part = (span > LINEAR[0]) & (span < LINEAR[1])
    part[np.argmax(span > LINEAR[1]):] = False
    return np.polyfit(time[part], np.log(span[part]), 1)[0]


def main(directory="results/growth"):
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    rate, settings = eigenmode(directory / "mode.h5", ELEMENTS)
    time, span = grow(directory / "mode.h5", settings, directory / "growth.h5", 0.012)
    found = fitted(time, span)
    print(f"{ELEMENTS} x {ELEMENTS} elements: eigenvalue {rate:.3f} gdot0, growth in the nonlinear "
          f"run {found:.3f} gdot0 ({100 * (found / rate - 1):+.2f} %)")
    np.savetxt(directory / "growth.csv", np.stack([time, span], axis=1), delimiter=",",
               header="time,half_range_of_I_over_I0", comments="")
    figure, axes = plt.subplots(figsize=(5.5, 4.0), constrained_layout=True)
    axes.semilogy(time, span, "k", label="nonlinear solver, with inertia")
    middle = np.argmax(span > np.sqrt(LINEAR[0] * LINEAR[1]))
    line = span[middle] * np.exp(rate * (time - time[middle]))
    axes.semilogy(time[line < 2], line[line < 2], "--", color="tab:red",
                  label=rf"eigenvalue, {rate:.1f} $\dot\gamma^0$")
    axes.set(xlabel=r"$t\,\dot\gamma^0$", ylabel=r"$(I_{max} - I_{min})/2I^0$")
    axes.legend()
    figure.savefig(directory / "growth.png", dpi=150)
    print(directory / "growth.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
