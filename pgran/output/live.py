"""A picture of a run while it goes on, without a snapshot in its file."""

from types import SimpleNamespace

import numpy as np

from .files import Disk, blocks_of, write_blocks
from .result import Snapshot

#: What is drawn.
FIELD = "inertial_number"


def gathered(grid, fields):
    """Return nodal fields (ny, nx, ...) on rank 0 from those at local nodes; None elsewhere.

    Collective. ``fields`` = {name: (..., n_local)}, as for `pgran.output.writer.Writer.snapshot`.
    """
    lattice, comm = grid.nodes, grid.comm.tompi4py()
    whole = None if comm.rank else {
        name: np.empty(lattice.shape[::-1] + values.shape[:-1]) for name, values in fields.items()}
    write_blocks(comm, whole, blocks_of(lattice, fields))
    return whole


def picture(writer, driver):
    """Draw the inertial number of the last state of a driver, NAME_step0040.png. Collective.

    Raises `pgran.options.ParameterError` where rank 0 cannot.
    """
    case, number = driver.case, driver.ts.getStepNumber()
    fields = driver.fields()
    period = driver.grid.period(fields["coordinates"])
    fields = gathered(driver.grid, {name: fields[name] for name in ("coordinates", FIELD)})

    def draw():
        try:
            from .pictures import Style, panels
        except ImportError as problem:
            raise OSError(f"matplotlib is needed ({problem})") from None
        result = SimpleNamespace(path=writer.path, closed=case.closed, case=case,
                                 unit=lambda name: "")
        snapshot = Snapshot(result, f"{number}", {"time": driver.state.time,
                                                  "label": case.label(driver.state.time)})
        snapshot.keep(fields, {"coordinates": period, FIELD: np.zeros(2)})
        panels([snapshot], FIELD, Style()).savefig(
            writer.path.with_name(f"{writer.path.stem}_step{number:04d}.png"))

    Disk(driver.comm, "picture_every", case.parameters.picture_every).do(draw)
