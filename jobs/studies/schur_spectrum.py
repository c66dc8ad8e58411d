r"""The spectrum that a preconditioner of Schur type leaves of the first system of a time step.

    python -m studies.schur_spectrum -options_file options/li.opts -pgran_element_size 2 \
        -from results/bench/li.h5 -snapshot 1 -dt 3e-4 [options of fieldsplit]

The system is that of `studies.systems`, with its options. Where the block of the nodes is
solved exactly, an upper factorisation P leaves A P^-1 = [[1, 0], [*, S M^-1]], with the Schur
complement S and what stands for it, M. All eigenvalues of S M^-1 are found by numpy, so one rank
and some thousand pressures are what this can do. Prints one line of JSON: the pressures, the share
of eigenvalues with a negative real part, the least distance to zero, and the largest size.
"""

import json
import sys

import numpy as np

from pgran.cli import command_option, start
from pgran.options import OptionError

from .one_step import SNAPSHOT
from .systems import first_system, start_of_steps

OPTIONS = (
    *SNAPSHOT,
    command_option("dt", "float", "size of the step", 3e-4, unit="1/gdot0", low=0.0, open_low=True))


def eigenvalues(parameters, comm, path, number, dt):
    """Return the eigenvalues (n_corners,) of S M^-1.

    Parameters
    ----------
    parameters : pgran.options.Parameters
    comm : PETSc.Comm
        Of one rank.
    path, number
        File and snapshot, as for `studies.transfer.interpolated`.
    dt : float
        Size of the step, 1/gdot0.

    Raises
    ------
    OptionError
        On more ranks than one.
    """
    if comm.size > 1:
        raise OptionError(f"{comm.size} ranks: allowed is one, as the matrix is dense")
    driver = start_of_steps(parameters, comm, path, number, (dt,))
    ksp, vector = first_system(driver, dt)
    ksp.setUp()
    matrix, pc = ksp.getOperators()[0], ksp.getPC()
    pressures = driver.grid.field_sets()["pressure"].indices
    solved, product, dense = vector.duplicate(), vector.duplicate(), []
    for column in pressures:
        vector.set(0.0)
        vector.setValue(column, 1.0)
        vector.assemble()
        pc.apply(vector, solved)
        matrix.mult(solved, product)
        dense.append(product.getArray()[pressures])
    return np.linalg.eigvals(np.array(dense).T)


def action(parameters, asked, comm):
    """Answer the command line."""
    found = eigenvalues(parameters, comm, getattr(asked, "from"), asked.snapshot, asked.dt)
    print(json.dumps({
        "pressures": found.size, "negative": float(np.mean(found.real < 0.0)),
        "nearest": float(np.abs(found).min()), "largest": float(np.abs(found).max())}), flush=True)


if __name__ == "__main__":
    sys.exit(start(sys.argv, action, __doc__, OPTIONS))
