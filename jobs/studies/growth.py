"""Growth of an eigenvector in the nonlinear solver: growth [directory]

The nonlinear solver starts from SLEPc's fastest mode of the periodic cell (pgran.eigen), with
inertia and on the moving mesh: once almost rigid with equal steps, once softer and through
saturation. The table compares the growth rate fitted to half the range of I with the eigenvalue.
"""

from pathlib import Path

import numpy as np

from pgran.options import PREFIX, written
from pgran.output.result import Result
from pgran.runs import run_on_ranks

from .study import Report, figure, run

ELEMENTS, STEP, SEED = 16, 2e-5, 1e-3
#: Shear moduli: almost rigid for the growth, softer where points fall below yield; |sigma_1|.
RIGID, SOFT = 1e8, 1e5
#: Half the range of I over I0 between which growth is fitted.
LINEAR = 3e-4, 3e-3
#: Options for exponential growth: rigid, with equal steps.
EXPONENTIAL = ("-pgran_shear_modulus", RIGID, "-pgran_step_max", STEP, "-pgran_step_error", 10)
#: Options for growth and saturation: variable steps.
BEYOND = ("-pgran_shear_modulus", SOFT, "-pgran_step_max", 5 * STEP)
#: Name, end (1/gdot0) and options of the runs.
RUNS = ("growth", 0.012, EXPONENTIAL), ("saturation", 0.03, BEYOND)
#: Options that pgran.eigen sets for the cell of the fastest wave vector.
OF_THE_CELL = "width", "height", "inertia", "imperfection"
COLUMNS = {"elements": "d", "G": "g", "eigenvalue": ".3f", "growth": ".3f",
           "difference (%)": "+.2f", "half range of I over I0 up to": ".3g"}


def eigenmode(path, elements, *more):
    """Return the growth rate (gdot0) of the fastest mode, and the options of its file as texts.

    pgran.eigen writes the mode to ``path`` unless it is there.
    """
    cell = ("-pgran_cell_elements", elements, *more)
    requested = run_on_ranks.requested_parameters("options/eigen.opts", *cell)
    if not run_on_ranks.holds(path, requested, (*run_on_ranks.IGNORED, *OF_THE_CELL)):
        run_on_ranks.python(run_on_ranks.RANKS, "-m", "pgran.eigen", "-options_file",
                            "options/eigen.opts", "-eps_nev", 2, "-refinement", elements, *cell,
                            "-pgran_output", path)
    mode = Result(path).attributes
    return float(mode["growth_rate"]), written(mode["options"])


def grow(mode, mode_options, output, end, *more):
    """Run the nonlinear solver with inertia from a mode to the time ``end``, 1/gdot0.

    ``mode_options`` are the texts that `eigenmode` returns.
    """
    cell = [text for name in ("width", "height", "inertial_number", "cell_elements")
            for text in (f"-{PREFIX}{name}", mode_options[PREFIX + name])]
    run(output, "periodic", *cell, "-pgran_inertia", "true", "-pgran_imperfection", 1,
        "-pgran_mode_file", mode, "-pgran_mode_amplitude", SEED, "-pgran_step_first", STEP,
        "-pgran_end_time", end, *more)


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
    table = Report(directory / "rates.csv", COLUMNS, "growth_rates")
    rate, mode_options = eigenmode(directory / "mode.h5", ELEMENTS, *options)
    for name, end, how in RUNS:
        path = directory / f"{name}.h5"
        grow(directory / "mode.h5", mode_options, path, end, *options, *how)
        _, time, span = history(path)
        found, G = fitted(time, span), how[1]
        table.row(ELEMENTS, G, rate, found, 100 * (found / rate - 1) if found else None,
                  span.max())
        curves.append((time, span, f"nonlinear solver with inertia, G = {G:g}"))
    draw(curves, rate, directory / "growth.png")


def draw(curves, rate, path):
    """Draw histories (time, span, label), and the ``rate`` through the first one."""
    time, span, _ = curves[0]
    middle, ends = np.argmax(span > np.sqrt(LINEAR[0] * LINEAR[1])), np.array([0.0, 0.02])
    with figure(path, figsize=(5.5, 4.0)) as (_, axes):
        for (times, spans, label), colour in zip(curves, ("k", "tab:blue")):
            axes.semilogy(times, spans, color=colour, label=label)
        axes.semilogy(ends, span[middle] * np.exp(rate * (ends - time[middle])), "--",
                      color="tab:red", label=rf"eigenvalue, {rate:.1f} $\dot\gamma^0$")
        axes.set(xlabel=r"$t\,\dot\gamma^0$", ylabel=r"$(I_{max} - I_{min})/2I^0$",
                 ylim=(1e-4, 0.2))
        axes.legend(fontsize=8)
