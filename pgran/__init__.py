"""pgran: parallel dense granular flow with non-local rheology.

From the linear stability of a rheology to its shear bands: the local inertial
rheology mu(I) and the non-local granular fluidity model on structured Q2-Q1
grids, solved with PETSc.
"""

__version__ = "0.3.0"


def open(path):
    """Return the `pgran.output.result.Result` of a result file, also of a run in progress.

    Raises `pgran.output.reader.ResultError` if it is not a pgran result file.
    """
    from .output.result import Result

    return Result(path)


def run(output=None, **options):
    """Run pgran and return its result; see `pgran.runs.sweep.run`."""
    from .runs import sweep as runs

    return runs.run(output, **options)


def sweep(parameters, **common):
    """Run pgran for each point of {name: values}; see `pgran.runs.sweep.sweep`."""
    from .runs import sweep as runs

    return runs.sweep(parameters, **common)
