"""Does an eigenvector grow at its eigenvalue in the nonlinear solver? growth [directory]

SLEPc's fastest mode of the periodic cell (pgran.eigen) seeds the nonlinear solver with inertia on
the moving mesh: once almost rigid and in equal steps, once less stiff and through saturation. The
table has the growth rate fitted to half the range of I while that is small, beside the eigenvalue.
growth.png shows both, growth.csv and saturation.csv the histories.
"""

from pathlib import Path

import numpy as np

from pgran.options import PREFIX, written
from pgran.output.result import Result
from pgran.runs import run_on_ranks
from pgran.runs.table import Table

ELEMENTS, STEP, SEED = 16, 2e-5, 1e-3
#: Shear moduli: almost rigid for the growth, softer where points fall below yield; |sigma_1|.
RIGID, SOFT = 1e8, 1e5
#: Half the range of I over I0 between which growth is fitted.
LINEAR = 3e-4, 3e-3
#: Options of `grow` for the exponential growth alone: rigid, with equal steps.
EXPONENTIAL = ("-pgran_shear_modulus", RIGID, "-pgran_step_max", STEP, "-pgran_step_error", 10)
#: And for the run beyond it: steps that follow what happens.
BEYOND = ("-pgran_shear_modulus", SOFT, "-pgran_step_max", 5 * STEP)
#: Name, end (1/gdot0) and options of the runs.
RUNS = ("growth", 0.012, EXPONENTIAL), ("saturation", 0.03, BEYOND)
#: What pgran.eigen sets itself for the cell of the fastest wave vector.
OF_THE_CELL = "width", "height", "inertia", "imperfection"
COLUMNS = {"elements": "d", "G": "g", "eigenvalue": ".3f", "growth": ".3f", "apart (%)": "+.2f",
           "half range of I over I0 up to": ".3g"}


def eigenmode(path, elements, *more):
    """Return the growth rate (gdot0) of the fastest mode, and the options of its file as texts.

    pgran.eigen writes the mode to ``path`` unless it is there.
    """
    given = ("-pgran_cell_elements", elements, *more)
    cell = run_on_ranks.requested_parameters("options/eigen.opts", *given)
    if not run_on_ranks.holds(path, cell, (*run_on_ranks.IGNORED, *OF_THE_CELL)):
        run_on_ranks.python(run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file", "options/eigen.opts",
                      "-eps_nev", 2, "-refinement", elements, *given, "-pgran_output", path)
    mode = Result(path).attributes
    return float(mode["growth_rate"]), written(mode["options"])


def grow(mode, given_options, output, end, *more):
    """Run the nonlinear solver with inertia from a mode to the time ``end``, 1/gdot0.

    ``given_options`` are the texts that `eigenmode` returns.
    """
    kept = ("width", "height", "inertial_number", "cell_elements")
    given = [text for name in kept for text in (f"-{PREFIX}{name}", given_options[PREFIX + name])]
    run_on_ranks.run(output, "options/periodic.opts", *given, "-pgran_inertia", "true",
               "-pgran_imperfection", 1, "-pgran_mode_file", mode, "-pgran_mode_amplitude", SEED,
               "-pgran_step_first", STEP, "-pgran_end_time", end, *run_on_ranks.QUIET, *more)


def history(path):
    """Return I0, the times (n,) of the steps in 1/gdot0, and half the range of I over I0 (n,)."""
    result = Result(path)
    I0 = result.options["inertial_number"]
    time, high, low = (result.history[name] for name in (
        "time", "inertial_number_max", "inertial_number_min"))
    return I0, time, (high - low) / (2.0 * I0)


def fitted(time, span, window=LINEAR):
    """Return the growth rate, gdot0, where ``span`` (n,) passes a window for good.

    None if it does not reach the end of the window, or crosses it in fewer than four steps.
    """
    if span[-1] < window[1]:
        return None
    first = np.flatnonzero(span < window[0])
    first = first[-1] + 1 if first.size else 0
    last = first + np.argmax(span[first:] > window[1])
    if last - first < 4:
        return None
    return float(np.polyfit(time[first:last], np.log(span[first:last]), 1)[0])


def main(directory="results/growth", *, options=()):
    """Make the mode, the runs, the table and the picture."""
    directory, curves = Path(directory), []
    table = Table(directory / "rates.csv", COLUMNS)
    rate, given_options = eigenmode(directory / "mode.h5", ELEMENTS, *options)
    for name, end, how in RUNS:
        path = directory / f"{name}.h5"
        grow(directory / "mode.h5", given_options, path, end, *options, *how)
        _, time, span = history(path)
        found, G = fitted(time, span), how[1]
        table.row(ELEMENTS, G, rate, found, 100 * (found / rate - 1) if found else None,
                  span.max())
        np.savetxt(directory / f"{name}.csv", np.stack([time, span], axis=1), delimiter=",",
                   header="time,half_range_of_I_over_I0", comments="")
        curves.append((time, span, f"nonlinear solver with inertia, G = {G:g}"))
    draw(curves, rate, directory / "growth.png")


def draw(curves, rate, path):
    """Draw histories (time, span, label), and the ``rate`` through the first one."""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.5, 4.0), constrained_layout=True)
    for (time, span, label), colour in zip(curves, ("k", "tab:blue")):
        axes.semilogy(time, span, color=colour, label=label)
    time, span, _ = curves[0]
    middle = np.argmax(span > np.sqrt(LINEAR[0] * LINEAR[1]))
    ends = np.array([0.0, 0.02])
    axes.semilogy(ends, span[middle] * np.exp(rate * (ends - time[middle])), "--", color="tab:red",
                  label=rf"eigenvalue, {rate:.1f} $\dot\gamma^0$")
    axes.set(xlabel=r"$t\,\dot\gamma^0$", ylabel=r"$(I_{max} - I_{min})/2I^0$", ylim=(1e-4, 0.2))
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=150)
    print(path)
