"""Follow a run from another terminal: python -m pgran.watch NAME.h5 [-every 5] [-once]

Shows how far the run is, how long it will still take, the last step, and a curve of the history as
text, until the run has ended. Ctrl-C ends the watching, not the run.
"""

import os
import sys
import time

import numpy as np

from .cli import answer, own
from .options import OptionError, not_among
from .output import pace
from .output.result import Result

ROWS = (
    own("every", "float", "seconds between two looks", 5.0, unit="s", low=0.1),
    own("once", "flag", "look once", False),
    own("column", "str", "column of the history that is drawn", "inertial_number_max"))
#: Characters of the curve, across and up.
SIZE = 64, 12


def curve(x, y, size=SIZE):
    """Return a curve through points (n,) as lines of text, with the ends of its scales."""
    wide, high = size
    low, top = float(np.min(y)), float(np.max(y))
    columns = np.zeros(len(x), dtype=int) if np.ptp(x) == 0.0 else np.rint(
        (x - x[0]) / (x[-1] - x[0]) * (wide - 1)).astype(int)
    rows = np.zeros(len(y), dtype=int) if top == low else np.rint(
        (y - low) / (top - low) * (high - 1)).astype(int)
    paper = np.full((high, wide), " ")
    paper[high - 1 - rows, columns] = "*"
    marks = [f"{top:.3g}", *[""] * (high - 2), f"{low:.3g}"]
    lines = [f"{mark:>10} |{''.join(row)}" for mark, row in zip(marks, paper)]
    return [*lines, f"{'':>10} +{'-' * wide}",
            f"{'':>10}  {x[0]:<12.4g}{x[-1]:>{wide - 12}.4g}"]


def look(path, column):
    """Return what is to be seen of a run, lines of text, and whether it has ended.

    Raises `OptionError` where the history has no such column.
    """
    result = Result(path)
    history, case, steps = result.history, result.case, len(result.history["time"])
    lines = [f"{path}: {result.parameters.case}, {result.parameters.model}, "
             f"{result.parameters.law}; {len(result.snapshots)} snapshots"]
    if column not in history:
        raise OptionError(f"-column {column}: {path} has no such column; "
                          + not_among(column, sorted(history)))
    if not steps:
        return [*lines, "  no step yet"], False
    done = np.array([case.count(time) for time in history["time"]]) / case.count(case.targets[-1])
    if result.complete:
        state = f"complete after {pace.words(result.attributes['seconds'])}"
    else:
        spent = os.path.getmtime(path) - float(result.attributes.get("begun", "nan"))
        work = pace.work(history)
        more = pace.left(done, work) if done[-1] >= pace.EARLY else None
        state = "under way" if more is None or not np.isfinite(spent) else (
            f"{pace.words(spent)} so far, some {pace.words(spent * more / work[-1])} left")
    label = "steady flow" if result.steady else case.label(history["time"][-1])
    across, along = result.progress() if result.steady else ("time", history["time"])
    filled = 40 if result.complete else int(40 * min(float(done[-1]), 1.0))
    lines += [f"  [{'#' * filled}{'.' * (40 - filled)}] {label}, {state}",
              f"  step {steps}, size {history['step_size'][-1]:.2e}, "
              f"{history['newton_iterations'][-1]} Newton and {history['linear_iterations'][-1]} "
              f"linear iterations, I {history['inertial_number_min'][-1]:.2e} to "
              f"{history['inertial_number_max'][-1]:.2e}",
              f"  {column} over {across}:", *curve(along, history[column])]
    return lines, result.complete


def run(asked, paths):
    """Look at the files until all have ended."""
    while True:
        seen = [look(path, asked.column) for path in paths]
        if not asked.once and sys.stdout.isatty():
            print("\033[2J\033[H", end="")
        print("\n".join(line for lines, _ in seen for line in lines), flush=True)
        if asked.once or all(ended for _, ended in seen):
            return
        try:
            time.sleep(asked.every)
        except KeyboardInterrupt:
            return


def main(arguments):
    """Watch the files named in ``arguments``; return the exit code."""
    return answer(arguments, "watch", run, __doc__, ROWS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
