"""pgran: parallel dense granular flow with non-local rheology.

From the linear stability of a rheology to its shear bands: the local inertial
rheology mu(I) and the non-local granular fluidity model on structured Q2-Q1
grids, solved with PETSc.
"""

__version__ = "0.2.0"


def open(path):
    """Return the `pgran.output.result.Result` of a result file, which may still be written.

    Raises `pgran.output.reader.ResultError` where it is none.
    """
    from .output.result import Result

    return Result(path)


def run(output=None, **options):
    """Run pgran and return its result, as `pgran.runs.sweep.run` says.

    ``pgran.run(inertial_number=0.003)`` runs the specimen in this process, and with ``ranks=2`` on
    two ranks of its own.
    """
    from .runs import sweep as runs

    return runs.run(output, **options)


def sweep(parameters, **common):
    """Run pgran for each point of {name: values}, as `pgran.runs.sweep.sweep` says."""
    from .runs import sweep as runs

    return runs.sweep(parameters, **common)
