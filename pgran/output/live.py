"""Pictures of a running simulation, without a snapshot in its file."""

from types import SimpleNamespace

import numpy as np

from .files import Disk, blocks_of, write_blocks
from .result import Snapshot


def picture(writer, driver):
    """Draw the inertial number of a driver's last state, NAME_step0040.png. Collective."""
    case, name, nodes = driver.case, "inertial_number", driver.grid.nodes
    number, time, fields = driver.ts.getStepNumber(), driver.state.time, driver.fields()
    period = driver.grid.period(fields["coordinates"])
    fields = {key: fields[key] for key in ("coordinates", name)}  # (..., n_local)
    gathered = None if driver.comm.rank else {
        key: np.empty(nodes.shape[::-1] + values.shape[:-1]) for key, values in fields.items()}
    write_blocks(driver.comm, gathered, blocks_of(nodes, fields))

    def draw():
        try:
            from .pictures import Style, panels
        except ImportError as problem:
            raise OSError(f"matplotlib is needed ({problem})") from None
        result = SimpleNamespace(path=writer.path, closed=case.closed, case=case, attributes={},
                                 unit=lambda name: "")
        snapshot = Snapshot(result, f"{number}", {"time": time, "label": case.label(time)})
        snapshot.keep(gathered, {"coordinates": period, name: np.zeros(2)})
        panels([snapshot], name, Style()).savefig(
            writer.path.with_name(f"{writer.path.stem}_step{number:04d}.png"))

    Disk(driver.comm, "picture_every", case.parameters.picture_every).do(draw)
