"""Tables that are written row by row, so that an interrupted study keeps its rows."""

import csv
import re
from pathlib import Path

from ..options import SolutionError

#: Columns of the cost of a run and their formats: time steps, repeated steps, iterations, seconds
#: and memory.
COST = {"steps": "d", "repeated": "d", "Newton": "d", "linear": "d", "s": ".0f", "MB": ".0f"}


def cost(result):
    """Return the values of the columns `COST` of a `pgran.output.result.Result`."""
    return [result.attributes[name] for name in (
        "steps", "steps_repeated", "newton_iterations", "linear_iterations", "seconds", "memory")]


def result_file(directory, name):
    """Return the path of the result file of a run with the title ``name``."""
    return Path(directory) / (re.sub("[^A-Za-z0-9.-]+", "_", name) + ".h5")


def line(cells):
    """Return texts as a line of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def cell(value, form=None):
    """Return a value as text: None as a dash, and float as ``.4g`` unless a format is given."""
    if value is None or isinstance(value, str):
        return value or "-"
    return format(value, form or (".4g" if isinstance(value, float) else ""))


class Table:
    """A table in Markdown on the terminal, and with all digits in a CSV file.

    Parameters
    ----------
    path : str or Path
        The CSV file; an existing file is replaced.
    columns : dict
        Titles of the columns, and formats of their numbers on the terminal.
    """

    def __init__(self, path, columns):
        self.path, self.columns = Path(path), columns
        self._rows = self._notes = 0
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text("")
        self._write(columns)
        print(line(columns), line(["---"] * len(columns)), sep="\n", flush=True)

    def row(self, *values):
        """Add a row. Texts are shown unmodified, and a missing value, None, as a dash."""
        if len(values) != len(self.columns):
            raise ValueError(f"{len(values)} values for {len(self.columns)} columns")
        self._rows += 1
        self._write("" if value is None else value for value in values)
        print(line(map(cell, values, self.columns.values())), flush=True)

    def note(self, *texts):
        """Add a row with texts in its first columns and nothing else."""
        self.row(*texts, *[None] * (len(self.columns) - len(texts)))
        self._rows, self._notes = self._rows - 1, self._notes + 1

    def close(self):
        """Raise `pgran.options.SolutionError` if the table contains only notes."""
        if self._notes and not self._rows:
            raise SolutionError(f"all runs failed; {self.path} has no results")

    def _write(self, values):
        with open(self.path, "a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(list(values))
