"""Runs of many points, commands, tables and figures that studies share."""

import functools
import io
import json
import os
import platform
import subprocess
import time
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from pgran import __version__
from pgran.runs import run_on_ranks
from pgran.runs.table import Table

FAILED = "failed"


class Report(Table):
    """A `Table` that is also written as a page of the documentation, docs/generated/NAME.md.

    Only where the environment variable PGRAN_DOCS names the folder ``docs``, as jobs/study.sh does.
    The page ends with the release, the machine and the date.

    Parameters
    ----------
    path : str or Path
        The CSV file.
    columns : dict
        Titles, and the format of the numbers below them.
    name : str
        Name of the page, the stem of the CSV file unless given.
    """

    def __init__(self, path, columns, name=None):
        self._lines, self._page = [], docs_file("generated", f"{name or Path(path).stem}.md")
        super().__init__(path, columns)

    def _show(self, cells):
        cells = list(cells)
        super()._show(cells)
        self._lines.append(f"| {' | '.join(cells)} |")
        write_page(self._page, self._lines)


def docs_file(folder, name):
    """Return the path of a file of the documentation, or None without PGRAN_DOCS."""
    docs = os.environ.get("PGRAN_DOCS")
    if not docs:
        return None
    path = Path(docs, folder, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def write_page(path, lines):
    """Write lines of Markdown and the stamp to ``path``, unless it is None."""
    if path:
        path.write_text("\n".join([*lines, "", stamp()]) + "\n")


def write_text(name, text):
    """Print text, and write it to docs/generated/NAME.md as it is."""
    print(text)
    write_page(docs_file("generated", f"{name}.md"), ["```text", text.rstrip(), "```"])


def write_tables(name, action):
    """Call ``action()``, and write the tables that it prints to docs/generated/NAME.md."""
    with redirect_stdout(io.StringIO()) as output:
        action()
    text = output.getvalue()
    print(text)
    write_page(docs_file("generated", f"{name}.md"),
               [line for line in text.splitlines() if line.startswith("|") or not line])


@functools.cache
def stamp():
    """Return release, PETSc, machine and date as text."""
    code = "from petsc4py import PETSc; print(*PETSc.Sys.getVersion(), sep='.')"
    petsc = run_on_ranks.python(0, "-c", code, stdout=subprocess.PIPE, text=True).stdout.strip()
    with open("/proc/cpuinfo") as file:
        model = next((line.split(":")[1].strip() for line in file if "model name" in line),
                     platform.machine())
    return (f"pgran {__version__}, PETSc {petsc}, {model} ({os.cpu_count()} cores), "
            f"{time.strftime('%Y-%m-%d')}")


@contextmanager
def figure(path, *arguments, **options):
    """Yield the figure and axes of ``pyplot.subplots``, and save them to ``path``.

    With PGRAN_DOCS they are also saved to docs/figures.
    """
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    canvas, axes = plt.subplots(*arguments, constrained_layout=True, **options)
    yield canvas, axes
    for target in filter(None, (Path(path), docs_file("figures", Path(path).name))):
        canvas.savefig(target, dpi=130)
        print(target)
    plt.close(canvas)


def command(ranks, module, *arguments):
    """Return what ``python -m module arguments -json`` prints, on ranks, as Python objects."""
    return json.loads(run_on_ranks.python(ranks, "-m", module, *arguments, "-json",
                                          stdout=subprocess.PIPE, text=True).stdout)


def run(path, file, *options, **more):
    """Make a run that prints only errors, unless it is complete; return its result."""
    return run_on_ranks.run(path, f"options/{file}.opts", *run_on_ranks.QUIET, *options, **more)


def attempt(table, names, path, file, *options):
    """Return the result of a run, or None after a note in the table that the run failed."""
    result = run(path, file, *options, needed=False)
    if result is None:
        table.note(*names, FAILED)
    return result
