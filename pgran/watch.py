"""Monitor a run from another terminal: python -m pgran.watch NAME.h5 [-every 5] [-once]

Shows the progress, the estimated remaining time, the last step, and a curve of the history, until
the run is complete, stopped, failed or killed. Ctrl-C ends the monitor, not the run.
"""

import os
import sys
import time

import numpy as np

from .cli import run_without_petsc
from .options import OptionError, command_option, not_among
from .output import progress
from .output.files import is_running
from .output.result import Result

OPTIONS = (
    command_option("every", "float", "seconds between two updates", 5.0, unit="s", low=0.1),
    command_option("silence", "float", "time without a change of the file after which a run on "
                   "another machine counts as ended", 1800.0, unit="s", low=1.0),
    command_option("once", "flag", "show the state once", False),
    command_option("column", "str", "column of the history in the curve", "inertial_number_max"))


def curve(x, y, size=(64, 12)):
    """Return a curve through points (n,) as lines of text of a size in characters, with scales."""
    def scaled(values, count):
        span = np.ptp(values) or 1.0
        return np.rint((values - values.min()) / span * (count - 1)).astype(int)

    wide, high = size
    characters = np.full((high, wide), " ")
    characters[high - 1 - scaled(y, high), scaled(x, wide)] = "*"
    marks = [f"{y.max():.3g}", *[""] * (high - 2), f"{y.min():.3g}"]
    return [*(f"{mark:>10} |{''.join(row)}" for mark, row in zip(marks, characters)),
            f"{'':>10} +{'-' * wide}", f"{'':>10}  {x[0]:<12.4g}{x[-1]:>{wide - 12}.4g}"]


def ending(result, silence):
    """Return how the run of a `Result` ended as text, or None while it runs."""
    attributes = result.attributes
    if result.complete:
        seconds = attributes.get("seconds")
        return f"complete after {progress.words(seconds)}" if seconds else "complete"
    if attributes.get("state", "running") != "running":
        return attributes["state"]
    running = is_running(str(attributes.get("process", "")))
    if running is False:
        return "killed: its process has ended"
    silent = time.time() - os.path.getmtime(result.path)
    if running or silent <= silence:
        return None
    return f"ended: its file has not changed for {progress.words(silent)}"


def look(path, column, silence):
    """Return the state of a run as lines of text, and whether it has ended."""
    result = Result(path)
    history, case, steps = result.history, result.case, len(result.history["time"])
    lines = [f"{path}: {result.parameters.case}, {result.parameters.model}, "
             f"{result.parameters.law}; {len(result.snapshots)} snapshots"]
    if column not in history:
        raise OptionError(f"-column {column}: {path} has no column {column}; "
                          + not_among(column, sorted(history)))
    state = ending(result, silence)
    ended = bool(state)
    if not steps:
        return [*lines, f"  no step{f'; {state}' if ended else ' yet'}"], ended
    done = np.array([case.progress(time) for time in history["time"]]) / case.progress(
        case.targets[-1])
    if not ended:
        state, work = "running", progress.work(history)
        spent = os.path.getmtime(path) - float(result.attributes.get("begun", "nan"))
        left = progress.left(done, work) if done[-1] >= progress.EARLY else None
        if left is not None and np.isfinite(spent):
            state = (f"running for {progress.words(spent)}, about "
                     f"{progress.words(spent * left / work[-1])} left")
    label, across, x = case.label(history["time"][-1]), "time", history["time"]
    if result.steady:
        label, (across, x) = "steady flow", result.progress()
    filled = 40 if result.complete else int(40 * min(float(done[-1]), 1.0))
    last = {name: values[-1] for name, values in history.items()}
    lines += [f"  [{'#' * filled}{'.' * (40 - filled)}] {label}, {state}",
              f"  {progress.step_text(steps, last)}",
              f"  {column} over {across}:", *curve(x, history[column])]
    return lines, ended


def run(args, paths):
    """Show the state of the files until all runs have ended."""
    while True:
        shown = [look(path, args.column, args.silence) for path in paths]
        if not args.once and sys.stdout.isatty():
            print("\033[2J\033[H", end="")  # clear the screen
        print("\n".join(line for lines, _ in shown for line in lines), flush=True)
        if args.once or all(ended for _, ended in shown):
            return
        try:
            time.sleep(args.every)
        except KeyboardInterrupt:
            return


def main(arguments):
    """Monitor the files named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "watch", run, __doc__, OPTIONS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
