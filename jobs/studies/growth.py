"""Growth of an eigenvector in the nonlinear solver."""

from pathlib import Path

import numpy as np

from pgran.options import PREFIX, written
from pgran.output.result import Result
from pgran.runs import run_on_ranks

from . import study

ELEMENTS, STEP, AMPLITUDE = 16, 2e-5, 1e-3
#: Shear moduli over |sigma_1|: almost rigid, and softer for the run to saturation.
RIGID, SOFT = 1e8, 1e5
#: Half the range of I over I0 between which growth is fitted.
LINEAR = 3e-4, 3e-3
#: Options of exponential growth (equal steps), and of the run to saturation (adaptive steps).
EXPONENTIAL = ("-pgran_shear_modulus", RIGID, "-pgran_step_max", STEP, "-pgran_step_error", 10)
SATURATION = ("-pgran_shear_modulus", SOFT, "-pgran_step_max", 5 * STEP)
#: Name, end (1/gdot0) and options of the runs.
RUNS = ("growth", 0.012, EXPONENTIAL), ("saturation", 0.03, SATURATION)
#: Options that pgran.eigen sets for the cell of the fastest wave vector.
SET_BY_EIGEN = "width", "height", "inertia", "imperfection"
COLUMNS = {"elements": "d", "G": "g", "eigenvalue": ".3f", "growth": ".3f",
           "difference (%)": "+.2f", "half range of I over I0 up to": ".3g"}


def eigenmode(path, elements, *options):
    """Return the growth rate (gdot0) of the fastest mode, and the options of its file as texts."""
    options = ("-pgran_cell_elements", elements, *options)
    if not run_on_ranks.holds(path, study.parameters("eigen", *options),
                              (*run_on_ranks.IGNORED, *SET_BY_EIGEN)):
        run_on_ranks.python(run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file",
                            "options/eigen.opts", "-eps_nev", 2, "-refinement", elements, *options,
                            "-pgran_output", path)
    mode = Result(path).attributes
    return float(mode["growth_rate"]), written(mode["options"])


def grow(mode, mode_options, output, end, *options):
    """Run the nonlinear solver with inertia from a mode to the time ``end``, 1/gdot0."""
    cell = [text for name in ("width", "height", "inertial_number", "cell_elements")
            for text in (f"-{PREFIX}{name}", mode_options[PREFIX + name])]
    study.run(output, "periodic", *cell, "-pgran_inertia", "true", "-pgran_imperfection", 1,
              "-pgran_mode_file", mode, "-pgran_mode_amplitude", AMPLITUDE, "-pgran_step_first",
              STEP, "-pgran_end_time", end, *options)


def history(path):
    """Return I0, the times (n,) of the steps in 1/gdot0, and half the range of I over I0 (n,)."""
    result = Result(path)
    I0 = result.options["inertial_number"]
    time, high, low = (result.history[name] for name in (
        "time", "inertial_number_max", "inertial_number_min"))
    return I0, time, (high - low) / (2.0 * I0)


def fitted(time, span, window=LINEAR):
    """Return the growth rate, gdot0, of ``span`` (n,) after it enters a window for the last time.

    None if the span does not reach the end of the window, or crosses it in fewer than four steps.
    """
    if span[-1] < window[1]:
        return None
    first = np.flatnonzero(span < window[0])
    first = first[-1] + 1 if first.size else 0
    last = first + np.argmax(span[first:] > window[1])
    if last - first < 4:
        return None
    return float(np.polyfit(time[first:last], np.log(span[first:last]), 1)[0])


def growth(directory="results/growth", *, options=()):
    """Growth of an eigenvector in the nonlinear solver: growth [directory]

    The fastest mode of the periodic cell (pgran.eigen) is the initial disturbance of two nonlinear
    runs with inertia on the moving mesh: almost rigid with equal steps, and softer through
    saturation. The table contains the eigenvalue and the growth rate fitted to half the range of I.
    Five minutes on two cores.
    """
    directory = Path(directory)
    mode, curves = directory / "mode.h5", []
    directory.mkdir(parents=True, exist_ok=True)
    rate, mode_options = eigenmode(mode, ELEMENTS, *options)

    def rows():
        for name, end, more in RUNS:
            path = directory / f"{name}.h5"
            grow(mode, mode_options, path, end, *options, *more)
            _, time, span = history(path)
            found, G = fitted(time, span), more[1]
            np.savetxt(directory / f"{name}.csv", np.stack([time, span], axis=1), delimiter=",",
                       header="time,half_range_of_I_over_I0", comments="")
            curves.append((time, span, f"nonlinear solver with inertia, G = {G:g}"))
            yield (ELEMENTS, G, rate, found, 100 * (found / rate - 1) if found else None,
                   span.max())

    study.write_table(directory / "growth_rates.csv", COLUMNS, rows())
    with study.figure("growth", figsize=(5.5, 4.0)) as (_, axes):
        for time, span, label in curves:
            axes.semilogy(time, span, label=label)
        time, span, _ = curves[0]
        middle = np.argmax(span > np.sqrt(LINEAR[0] * LINEAR[1]))
        ends = np.array([0.0, 0.02])
        axes.semilogy(ends, span[middle] * np.exp(rate * (ends - time[middle])), "--",
                      label=rf"eigenvalue, {rate:.1f} $\dot\gamma^0$")
        axes.set(xlabel=r"$t\,\dot\gamma^0$", ylabel=r"$(I_{max} - I_{min})/2I^0$",
                 ylim=(1e-4, 0.2))
        axes.legend(fontsize=8)
