"""Interpolation of a snapshot to a finer mesh, exact for piecewise polynomials."""

import json
import sys

import numpy as np

from pgran.cli import start
from pgran.options import OptionError, command_option
from pgran.output.reader import ResultError
from pgran.output.result import Result
from pgran.solve.state import State
from pgran.space.element import linear, quadratic

#: Options of commands that start from a snapshot.
SNAPSHOT = (
    command_option("from", "str", "result file with the snapshot"),
    command_option("snapshot", "int", "number of the snapshot; negative: from the end", -1))
#: Option of commands with one time step.
STEP = command_option("dt", "float", "time step", 1e-3, unit="1/gdot0", low=0.0, open_low=True)


def main(function, description, option=STEP):
    """Run a command on ranks and print its result as JSON; return the exit code.

    It calls ``function(parameters, comm, path, number, dt)`` with the options `SNAPSHOT` and
    ``option``, which is named ``-dt``.
    """
    def action(parameters, args, comm):
        found = function(parameters, comm, getattr(args, "from"), args.snapshot, args.dt)
        if comm.rank == 0:
            print(json.dumps(found), flush=True)

    return start(sys.argv, action, description, (*SNAPSHOT, option))


def along(fine, coarse, index, nodal):
    """Return the weights (n, m) of the m nodes of a coarse grid at nodes of a fine one, in 1D."""
    ratio = 2 * fine // coarse
    element = np.minimum(index // ratio, coarse - 1)
    weights = nodal(2.0 * (index - ratio * element) / ratio - 1.0)
    per_element = weights.shape[1] - 1
    nodes = per_element * element[:, None] + np.arange(per_element + 1)
    table = np.zeros((index.size, per_element * coarse + 1))
    np.put_along_axis(table, nodes, weights, axis=1)
    return table


def interpolated(form, path, number):
    """Return the `State` on the grid of a `WeakForm` from a snapshot on a coarser grid."""
    if path is None:
        raise OptionError("-from NAME.h5: a result file is needed")
    grid = form.grid
    try:
        snapshot = Result(path).snapshots[number]
        fields = {name: snapshot[name] for name in (
            "coordinates", "velocity", "fluidity", "pressure", "deviator")}
        time = snapshot.time
    except (ResultError, KeyError, IndexError) as error:
        raise OptionError(f"-from {path}: cannot read snapshot {number} ({error})") from None
    coarse = [(size - 1) // 2 for size in fields["fluidity"].shape[::-1]]
    if any(n % m for n, m in zip(grid.shape, coarse)):
        raise OptionError(f"-from {path}: its {coarse[0]} x {coarse[1]} elements are not "
                          f"divided by the {grid.shape[0]} x {grid.shape[1]} of this grid")

    def at(values, lattice, factor, nodal):
        first, second = (
            along(n, m, factor * np.arange(index.min(), index.max() + 1), nodal)
            for n, m, index in zip(grid.shape, coarse, lattice.index))
        values = values.reshape(values.shape[:2] + (-1,))
        return np.einsum("ja,abc,ib->cji", second, values, first, optimize=True).reshape(
            values.shape[2], -1)

    pressure = at(fields["pressure"][::2, ::2], grid.corners, 2, linear)[0]
    x, velocity, deviator, fluidity = (
        at(fields[name], grid.nodes, 1, lambda points: quadratic(points)[0])
        for name in ("coordinates", "velocity", "deviator", "fluidity"))
    fluidity = np.maximum(fluidity[0], fields["fluidity"].min())
    return State(time, x, grid.join(velocity, fluidity, pressure),
                 form.kinematics.mandel(form.element.shape @ deviator[:, grid.element_nodes]))
