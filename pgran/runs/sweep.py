"""Runs from Python: a single run, and a run for each point of a grid of parameters.

Completed runs are reused, and interrupted runs resume from their last checkpoint.
"""

import itertools
import os
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..options import PREFIX, OptionError, SolutionError, combined_options, read_file, shipped
from ..options.files import SOLVER, suits
from ..output.result import ANY, Result, options_of
from . import run_in_process, run_on_ranks

#: Environment variables with the number of a task in a job array.
TASKS = "SLURM_ARRAY_TASK_ID", "PBS_ARRAY_INDEX", "PBS_ARRAYID", "SGE_TASK_ID"
#: Costs of a run in the table of a sweep.
COSTS = "steps", "newton_iterations", "linear_iterations", "seconds", "memory"


def run(output=None, options_file=None, ranks=None, **options):
    """Run pgran and return its `pgran.output.result.Result`.

    Without ``ranks`` it runs in this process, collectively if the script runs on several ranks.
    Inconsistent options raise OptionError or ParameterError before the run. A run that fails raises
    SolutionError; separate processes print the reason to standard error. A run that a signal stops
    raises Interrupted, and the same call resumes it.

    Parameters
    ----------
    output : str or Path, optional
        The result file; results/CASE.h5 by default.
    options_file : str or Path, optional
        Options that the other ones override. By default the options file of the case, without a
        solver that does not suit the model or ``ts_type`` (`pgran.options.default_solver`).
    ranks : int, optional
        Run in this number of separate processes under mpiexec; 0 means one process without it.
    **options
        Options of pgran by their names without prefix, such as ``inertial_number=0.003``. Options
        of PETSc are given as ``petsc={"snes_atol": 1e-6}``.
    """
    case = str(options.get("case", "biaxial"))
    output = Path(output or Path("results") / f"{Path(case.split(':')[0]).stem}.h5")
    words = _checked(options_file=options_file, **options)
    if ranks is None:
        return run_in_process.run(output, *words)
    return run_on_ranks.run(output, *words, ranks=ranks)


def _checked(options_file=None, petsc=None, ranks=None, output=None, **options):
    """The options file and the other options, as words, of a run; raises errors in them."""
    petsc = {f"-{name}": value for name, value in (petsc or {}).items()}
    words = options_of({"progress": "quiet", **options, **petsc})
    if not options_file:
        options_file = shipped(str(options.get("case", "biaxial")))
        found = read_file(options_file) if options_file else {}
        if "pc_type" in found and not suits(found, {**found, **combined_options(None, *words)}):
            flow = {f"-{name}": text for name, text in found.items()
                    if name.startswith((PREFIX, "ts_type"))
                    and name not in (*SOLVER, f"{PREFIX}output")}
            options_file, words = None, options_of(flow) + words
    run_on_ranks.requested_parameters(options_file, *words)
    return options_file, *words


def result_file(directory, name):
    """Return the path of the result file of a run with the title ``name``."""
    return Path(directory) / (re.sub("[^A-Za-z0-9.-]+", "_", name) + ".h5")


def sweep(parameters, directory="results/sweep", workers=1, task=None, **common):
    """Run pgran for each point of a grid of parameters and return a `Sweep`.

    Inconsistent options of any point raise an error before the first run.

    Parameters
    ----------
    parameters : dict
        {name: values}; the points are all combinations.
    directory : str or Path
        Directory of the results, which are named after their points.
    workers : int
        Number of simultaneous runs.
    task : int, optional
        Run only this point, counted from 0. By default the task of a job array of Slurm, PBS or
        SGE, if there is one.
    **common
        Arguments of `run`: ``ranks`` (0 by default), ``options_file``, and options of all runs.
    """
    if not isinstance(parameters, Mapping) or not parameters:
        raise OptionError("a sweep needs {name: values}")
    grid = [dict(zip(parameters, values)) for values in itertools.product(*parameters.values())]
    directory = Path(os.path.abspath(directory))
    paths = [result_file(directory, " ".join(f"{name} {value}" for name, value in point.items()))
             for point in grid]
    if task is None:
        task = next((int(os.environ[name]) for name in TASKS if name in os.environ), None)
    if task is not None and not 0 <= task < len(grid):
        raise OptionError(f"task {task}: must be >= 0 and <= {len(grid) - 1}, a point of the sweep")
    numbers = range(len(grid)) if task is None else [task]
    if "output" in common:
        raise OptionError(f"output {common['output']}: results of a sweep are named after their "
                          "points; use directory")
    for number in numbers:
        _checked(**{**common, **grid[number]})
    directory.mkdir(parents=True, exist_ok=True)
    runs, failures = {}, {}

    def make(path):
        same = [number for number in numbers if paths[number] == path]
        try:
            result = run(path, **{"ranks": 0, **common, **grid[same[0]]})
            runs.update(dict.fromkeys(same, result.run))
        except SolutionError as error:
            failures.update(dict.fromkeys(same, str(error)))

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(make, dict.fromkeys(paths[number] for number in numbers)))
    return Sweep(grid, paths, dict(sorted(failures.items())), runs)


@dataclass
class Sweep:
    """The results of a sweep; a file of another run causes a `ResultError`."""

    points: list
    paths: list
    failures: dict  #: {number of a point: error message} of the runs that failed
    runs: dict  #: {number of a point: identifier of its run} of the runs that succeeded

    def __len__(self):
        return len(self.points)

    def __getitem__(self, number):
        """Return the `Result` of a point."""
        return Result(self.paths[number], self.runs.get(number, ANY))

    def rows(self):
        """Return a dictionary for each point: its parameters, the cost, and the band at its end.

        Missing values are None.
        """
        return [self._row(number) for number in range(len(self))]

    def _row(self, number):
        result = self[number] if self.paths[number].exists() else None
        last = result.snapshots[-1] if result and result.snapshots else None
        attributes = result.attributes if result else {}
        band = last.band() if last else {}
        return {**self.points[number], "complete": bool(result and result.complete),
                **{name: attributes.get(name) for name in COSTS},
                "inertial_number_max": float(last["inertial_number"].max()) if last else None,
                **{name: band.get(name) for name in ("localised", "angle", "width", "bands")}}

    def to_pandas(self):
        """Return `rows` as a pandas.DataFrame; requires pandas."""
        import pandas

        return pandas.DataFrame(self.rows())

    def to_xarray(self):
        """Return `rows` as an xarray.Dataset of the parameters; requires pandas and xarray."""
        return self.to_pandas().set_index(list(self.points[0])).to_xarray()

    def __str__(self):
        rows = self.rows()
        return "\n".join([line(rows[0]), line(["---"] * len(rows[0])),
                          *(line(map(cell, row.values())) for row in rows)])


def line(cells):
    """Return texts as a line of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def cell(value, form=None):
    """Return a value as text: None as a dash, and float as ``.4g`` unless a format is given."""
    if value is None or isinstance(value, str):
        return value or "-"
    return format(value, form or (".4g" if isinstance(value, float) else ""))
