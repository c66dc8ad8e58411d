"""Pictures of a running simulation, without a snapshot in its file."""

from types import SimpleNamespace

import numpy as np

from .files import Disk, blocks_of, write_blocks
from .result import Snapshot


def gathered(grid, fields):
    """Return nodal fields {name: (ny, nx, ...)} on rank 0, None elsewhere. Collective.

    ``fields`` = {name: (..., n_local)}, as for `pgran.output.writer.Writer.snapshot`.
    """
    lattice, comm = grid.nodes, grid.comm.tompi4py()
    arrays = None if comm.rank else {
        name: np.empty(lattice.shape[::-1] + values.shape[:-1]) for name, values in fields.items()}
    write_blocks(comm, arrays, blocks_of(lattice, fields))
    return arrays


def picture(writer, driver):
    """Draw the inertial number of a driver's last state, NAME_step0040.png. Collective.

    Raises `pgran.options.ParameterError` if rank 0 cannot.
    """
    case, name = driver.case, "inertial_number"
    number, time, fields = driver.ts.getStepNumber(), driver.state.time, driver.fields()
    period = driver.grid.period(fields["coordinates"])
    fields = gathered(driver.grid, {key: fields[key] for key in ("coordinates", name)})

    def draw():
        try:
            from .pictures import Style, panels
        except ImportError as problem:
            raise OSError(f"matplotlib is needed ({problem})") from None
        result = SimpleNamespace(path=writer.path, closed=case.closed, case=case,
                                 unit=lambda name: "")
        snapshot = Snapshot(result, f"{number}", {"time": time, "label": case.label(time)})
        snapshot.keep(fields, {"coordinates": period, name: np.zeros(2)})
        panels([snapshot], name, Style()).savefig(
            writer.path.with_name(f"{writer.path.stem}_step{number:04d}.png"))

    Disk(driver.comm, "picture_every", case.parameters.picture_every).do(draw)
