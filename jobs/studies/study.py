"""Common functions of the studies: runs, commands, tables and figures."""

import csv
import io
import json
import os
import platform
import re
import shutil
import subprocess
from contextlib import contextmanager, redirect_stdout
from datetime import date
from functools import lru_cache
from pathlib import Path

from pgran import __version__, cases
from pgran.options import SolutionError
from pgran.runs import run_on_ranks
from pgran.runs.sweep import cell, line, result_file

__all__ = ["COST", "cost", "result_file"]

#: Columns of the cost of a run and their formats: steps, Newton and linear iterations, and memory.
#: Only the benchmarks contain times, because they need an idle machine.
COST = {"steps": "d", "repeated": "d", "Newton": "d", "linear": "d", "MB": ".0f"}
#: Options of runs that print only errors.
QUIET = "-pgran_progress", "quiet"
#: Directory of the generated pages and figures.
DOCS = Path(os.environ.get("PGRAN_DOCS", "docs"))


def run(path, name, *options, **how):
    """Run pgran with options/NAME.opts unless that is done; see `pgran.runs.run_on_ranks.run`."""
    return run_on_ranks.run(path, f"options/{name}.opts", *QUIET, *options, **how)


def json_of(ranks, module, *arguments, **how):
    """Run ``python -m module`` on ranks (0: without mpiexec); return the JSON that it prints."""
    return json.loads(run_on_ranks.python(ranks, "-m", module, *arguments, stdout=subprocess.PIPE,
                                          text=True, **how).stdout)


def cost(result):
    """Return the values of the columns `COST` of a `pgran.output.result.Result`."""
    return [result.attributes[name] for name in (
        "steps", "steps_repeated", "newton_iterations", "linear_iterations", "memory")]


def parameters(name, *options):
    """Return the `pgran.options.Parameters` of options/NAME.opts (or None) and further options."""
    file = f"options/{name}.opts" if name else None
    return cases.read(run_on_ranks.combined_options(file, *options))


def write_table(path, columns, rows, page=None):
    """Write a table to a CSV file row by row, and when complete to docs/generated; return its rows.

    ``columns`` are titles and formats of numbers. A row that is shorter is a note about a run that
    failed. ``page`` is the name of the page, by default the stem of the CSV file. Raises
    SolutionError if all runs failed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lines, rows_written = [line(columns), line(["---"] * len(columns))], []
    print(*lines, sep="\n", flush=True)
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            cells = [*row, *[None] * (len(columns) - len(row))]
            writer.writerow(cells)
            file.flush()
            lines.append(line(map(cell, cells, columns.values())))
            print(lines[-1], flush=True)
            rows_written.append(row)
    if rows_written and max(map(len, rows_written)) < len(columns):
        raise SolutionError(f"all runs failed; {path} has no results")
    write_page(page or path.stem, "\n".join(lines))
    return rows_written


def write_page(name, text):
    """Write a text to docs/generated/NAME.md with a stamp of versions, machine and date."""
    page = DOCS / "generated" / f"{name}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(f"{text}\n\n{stamp()}\n")
    print(f"{page}\n")


@lru_cache
def stamp():
    """Return versions, machine and date as one line."""
    code = "from petsc4py import PETSc; print(*PETSc.Sys.getVersion(), sep='.')"
    petsc = run_on_ranks.python(0, "-c", code, stdout=subprocess.PIPE, text=True).stdout.strip()
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text() if info.exists() else "")
    machine = found.group(1) if found else platform.machine()
    return (f"pgran {__version__}, PETSc {petsc}, {machine} ({os.cpu_count()} cores), "
            f"{date.today():%Y-%m-%d}")


def paper_figures(names, results):
    """Draw figures of the paper, copy them to docs/figures, and return their numbers as text."""
    from pgran.output import figures

    pictures, text = Path("results/figures"), io.StringIO()
    with redirect_stdout(text):
        figures.draw(names, pictures, results)
    (DOCS / "figures").mkdir(parents=True, exist_ok=True)
    for name in names:
        shutil.copy(pictures / f"{name}.png", DOCS / "figures")
    print(text.getvalue())
    return text.getvalue()


@contextmanager
def figure(name, *shape, **options):
    """Provide a figure and axes of matplotlib, and save them to docs/figures/NAME.png."""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(*shape, constrained_layout=True, **options)
    yield fig, axes
    path = DOCS / "figures" / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=130)
    plt.close(fig)
    print(path)
