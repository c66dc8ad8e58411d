"""Runs from Python: one, and one for each value of parameters, on a pool or as a job array.

`pgran.run` and `pgran.sweep` are these functions. Runs that are done are not made again, and runs
that were stopped go on from their last checkpoint.
"""

import itertools
import os
import sysconfig
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ..options import OptionError, SolutionError
from ..output.result import ANY, Result, options_of
from . import run_in_process, run_on_ranks
from .table import result_file

#: What batch systems call the number of a task in a job array.
TASKS = "SLURM_ARRAY_TASK_ID", "PBS_ARRAY_INDEX", "PBS_ARRAYID", "SGE_TASK_ID"
#: What a row of a sweep's table has besides parameters and the measured band.
TOOK = "steps", "newton_iterations", "linear_iterations", "seconds", "memory"


def shipped(name):
    """Return the path of options/NAME.opts, of the repository or an installation, or None."""
    places = (Path(__file__).resolve().parents[2] / "options",
              Path(sysconfig.get_path("data")) / "share" / "pgran" / "options")
    return next((place / f"{name}.opts" for place in places
                 if (place / f"{name}.opts").is_file()), None)


def run(output=None, options_file=None, ranks=None, **options):
    """Run pgran and return its `pgran.output.result.Result`.

    Without ``ranks`` it runs in this process. A script that ``mpiexec`` has started on ranks then
    runs on all of them, and each must call it.

    Parameters
    ----------
    output : str or Path, optional
        The result file; results/CASE.h5 unless given.
    options_file : str or Path, optional
        The options to begin with; those that pgran ships for the case unless given.
    ranks : int, optional
        Run in processes of its own: so many under mpiexec, or one without it for 0.
    **options
        Options of pgran by their names without prefix, such as ``inertial_number=0.003``. PETSc's
        go into ``petsc={"snes_atol": 1e-6}``.

    Raises
    ------
    OptionError, ParameterError
        Where options do not fit together, before anything runs.
    SolutionError
        If the run fails. Of a process of its own the message is on standard error.
    Interrupted
        If a signal stops it; the same call goes on.
    """
    case = str(options.get("case", "biaxial"))
    output = Path(output or Path("results") / f"{Path(case.split(':')[0]).stem}.h5")
    words = _checked(options_file=options_file, **options)
    if ranks is None:
        return run_in_process.run(output, *words)
    return run_on_ranks.run(output, *words, ranks=ranks)


def _checked(options_file=None, petsc=None, ranks=None, output=None, **options):
    """The options file and the words of the options of a run; raises what is wrong with them."""
    options_file = options_file or shipped(str(options.get("case", "biaxial")))
    petsc = {f"-{name}": value for name, value in (petsc or {}).items()}
    words = options_of({"progress": "quiet", **options, **petsc})
    run_on_ranks.asked(options_file, *words)
    return options_file, *words


def points(parameters):
    """Return the points of a grid, a list of {name: value}, from {name: values}."""
    if not isinstance(parameters, Mapping) or not parameters:
        raise OptionError("a sweep needs {name: values}")
    names = list(parameters)
    return [dict(zip(names, values)) for values in itertools.product(*parameters.values())]


def sweep(parameters, directory="results/sweep", workers=1, task=None, **common):
    """Run pgran for each point of a grid of parameters and return a `Sweep`.

    Parameters
    ----------
    parameters : dict
        {name: values}; the points are all combinations.
    directory : str or Path
        Where the results go, named by their points. It is made if it is missing.
    workers : int
        How many runs go on at a time.
    task : int, optional
        Only this point, counted from 0: that of a job array. Taken from the environment of Slurm,
        PBS or SGE where it is set there.
    **common
        As for `run`: ``ranks`` (0 unless given), ``options_file``, and options of all runs.

    Raises
    ------
    OptionError, ParameterError
        Where the options of a point do not fit together, before anything runs.
    """
    chosen, directory = points(parameters), Path(os.path.abspath(directory))
    paths = [result_file(directory, " ".join(f"{name} {value}" for name, value in point.items()))
             for point in chosen]
    if task is None:
        task = next((int(os.environ[name]) for name in TASKS if name in os.environ), None)
    if task is not None and not 0 <= task < len(chosen):
        raise OptionError(f"task {task}: allowed is 0 to {len(chosen) - 1}, the points of the "
                          "sweep")
    wanted = range(len(chosen)) if task is None else [task]
    if "output" in common:
        raise OptionError(f"output {common['output']}: results of a sweep are named by their "
                          "points; allowed is directory")
    for number in wanted:
        _checked(**{**common, **chosen[number]})
    directory.mkdir(parents=True, exist_ok=True)

    runs, failures = {}, {}

    def make(number):
        try:
            result = run(paths[number], **{"ranks": 0, **common, **chosen[number]})
            runs[number] = result.run
        except SolutionError as error:
            failures[number] = str(error)

    first = {paths[number]: number for number in reversed(wanted)}  # of points that are equal
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(make, first.values()))
    for number in wanted:  # points that are equal share a run
        for known in (runs, failures):
            if first[paths[number]] in known:
                known[number] = known[first[paths[number]]]
    return Sweep(chosen, paths, dict(sorted(failures.items())), runs)


class Sweep:
    """The results of a sweep.

    Attributes
    ----------
    points : list of dict
    paths : list of Path
        Absolute paths.
    failures : dict
        {number of a point: why it failed}, of those that did.
    runs : dict
        {number of a point: identifier of its run}, of those that succeeded. A file that holds
        another run by then is refused with a `ResultError`.
    """

    def __init__(self, points, paths, failures, runs):
        self.points, self.paths, self.failures, self.runs = points, paths, failures, runs

    def __len__(self):
        return len(self.points)

    def __getitem__(self, number):
        """Return the `Result` of a point."""
        return Result(self.paths[number], self.runs.get(number, ANY))

    def rows(self):
        """Return a row for each point, a list of dictionaries: the point and what came of it.

        The band and the extremes of I are those of the last snapshot; what is not there is None.
        """
        return [self._row(number) for number in range(len(self))]

    def _row(self, number):
        row = dict(self.points[number])
        done = self.paths[number].exists()
        result = self[number] if done else None
        row["complete"] = bool(done and result.complete)
        row.update({name: result.attributes.get(name) if done else None for name in TOOK})
        last = result.snapshots[-1] if done and result.snapshots else None
        I = last["inertial_number"] if last else None
        row["inertial_number_max"] = None if I is None else float(I.max())
        band = last.band() if last else {}
        row.update({name: band.get(name) for name in ("localised", "angle", "width", "bands")})
        return row

    def to_pandas(self):
        """Return `rows` as a pandas.DataFrame; needs pandas."""
        import pandas

        return pandas.DataFrame(self.rows())

    def to_xarray(self):
        """Return `rows` as an xarray.Dataset over the parameters; needs pandas and xarray."""
        return self.to_pandas().set_index(list(self.points[0])).to_xarray()

    def __str__(self):
        rows = self.rows()

        def shown(value):
            if value is None:
                return "-"
            return f"{value:.4g}" if isinstance(value, float) else str(value)

        names = list(rows[0])
        lines = [[shown(row[name]) for name in names] for row in rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in (
            names, ["---"] * len(names), *lines))
