"""Tables that are written row by row, so that a study that stops loses none."""

import csv
import re
from pathlib import Path

from ..options import SolutionError

#: Columns of what a run took: time steps, repeated ones, iterations, seconds and memory.
COST = {"steps": "d", "repeated": "d", "Newton": "d", "linear": "d", "s": ".0f", "MB": ".0f"}


def cost(result):
    """Return the values of the columns `COST` of a `pgran.output.result.Result`."""
    return [result.attributes[name] for name in (
        "steps", "steps_repeated", "newton_iterations", "linear_iterations", "seconds", "memory")]


def result_file(directory, name):
    """Return the path of the result file of a case that is named in words."""
    return Path(directory) / (re.sub("[^A-Za-z0-9.-]+", "_", name) + ".h5")


class Table:
    """A table in Markdown on the terminal, and with all digits in a CSV file.

    Parameters
    ----------
    path : str or Path
        The CSV file, which replaces an earlier one.
    columns : dict
        Titles, and the format in which the numbers below them are shown.
    """

    def __init__(self, path, columns):
        self.path, self.columns = Path(path), columns
        self._rows = self._notes = 0
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text("")
        self._write(columns)
        self._show(columns)
        self._show(["---"] * len(columns))

    def row(self, *values):
        """Add a row. Texts are shown as they are, and None, a missing value, as a dash."""
        if len(values) != len(self.columns):
            raise ValueError(f"{len(values)} values for {len(self.columns)} columns")
        self._rows += 1
        self._write("" if value is None else value for value in values)
        self._show("-" if value is None else value if isinstance(value, str)
                   else format(value, form) for value, form in zip(values, self.columns.values()))

    def note(self, *words):
        """Add a row that has texts in its first columns and nothing else."""
        self.row(*words, *[None] * (len(self.columns) - len(words)))
        self._rows, self._notes = self._rows - 1, self._notes + 1

    def close(self):
        """Raise `pgran.options.SolutionError` if the table has nothing but notes."""
        if self._notes and not self._rows:
            raise SolutionError(f"no run came to its end; {self.path} has nothing to tell")

    def _write(self, values):
        with open(self.path, "a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(list(values))

    @staticmethod
    def _show(cells):
        print(f"| {' | '.join(cells)} |", flush=True)
