"""Follow a run from another terminal: python -m pgran.watch NAME.h5 [-every 5] [-once]

Shows how far the run is, how long it will still take, the last step, and a curve of the history as
text, until the run is complete, stopped, failed or killed. On the machine of rank 0 a killed run is
noticed at the next look. On another machine a run counts as ended when its file has not changed for
``-silence`` seconds. Ctrl-C ends the watching, not the run.
"""

import os
import sys
import time

import numpy as np

from .cli import command_option, run_without_petsc
from .options import OptionError, not_among
from .output import progress
from .output.files import is_running
from .output.result import Result

OPTIONS = (
    command_option("every", "float", "seconds between two looks", 5.0, unit="s", low=0.1),
    command_option("silence", "float", "seconds without a change of the file after which a run of another "
        "machine counts as ended", 1800.0, unit="s", low=1.0),
    command_option("once", "flag", "look once", False),
    command_option("column", "str", "column of the history that is drawn", "inertial_number_max"))
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


def ending(result, silence):
    """Return how the run of a `Result` ended, in words, or None while it runs.

    ``silence`` is the time in seconds without a change of the file after which a run of another
    machine counts as ended.
    """
    attributes = result.attributes
    if result.complete:
        return f"complete after {progress.words(attributes['seconds'])}" if "seconds" in attributes \
            else "complete"
    if attributes.get("state", "running") != "running":
        return attributes["state"]
    alive = is_running(str(attributes.get("process", "")))
    if alive is None:
        still = time.time() - os.path.getmtime(result.path)
        return f"ended: its file has not changed for {progress.words(still)}" if still > silence \
            else None
    return None if alive else "killed: its process has ended"


def look(path, column, silence):
    """Return what is to be seen of a run, lines of text, and whether it has ended.

    ``silence`` is that of `ending`. Raises `OptionError` where the history has no such column.
    """
    result = Result(path)
    history, case, steps = result.history, result.case, len(result.history["time"])
    lines = [f"{path}: {result.parameters.case}, {result.parameters.model}, "
             f"{result.parameters.law}; {len(result.snapshots)} snapshots"]
    if column not in history:
        raise OptionError(f"-column {column}: {path} has no such column; "
                          + not_among(column, sorted(history)))
    state = ending(result, silence)
    ended = state is not None
    if not steps:
        return [*lines, f"  no step; {state}" if ended else "  no step yet"], ended
    done = np.array([case.progress(time) for time in history["time"]]) / \
                    case.progress(case.targets[-1])
    if not ended:
        spent = os.path.getmtime(path) - float(result.attributes.get("begun", "nan"))
        work = progress.work(history)
        more = progress.left(done, work) if done[-1] >= progress.EARLY else None
        state = "under way" if more is None or not np.isfinite(spent) else (
            f"{progress.words(spent)} so far, some {progress.words(spent * more / work[-1])} left")
    label = "steady flow" if result.steady else case.label(history["time"][-1])
    across, along = result.progress() if result.steady else ("time", history["time"])
    filled = 40 if result.complete else int(40 * min(float(done[-1]), 1.0))
    lines += [f"  [{'#' * filled}{'.' * (40 - filled)}] {label}, {state}",
              f"  step {steps}, size {history['step_size'][-1]:.2e}, "
              f"{history['newton_iterations'][-1]} Newton and {history['linear_iterations'][-1]} "
              f"linear iterations, I {history['inertial_number_min'][-1]:.2e} to "
              f"{history['inertial_number_max'][-1]:.2e}",
              f"  {column} over {across}:", *curve(along, history[column])]
    return lines, ended


def run(asked, paths):
    """Look at the files until all have ended."""
    while True:
        seen = [look(path, asked.column, asked.silence) for path in paths]
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
    return run_without_petsc(arguments, "watch", run, __doc__, OPTIONS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
