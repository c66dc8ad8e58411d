"""Checkpoints: all that a run needs to go on, on any number of ranks.

A checkpoint of NAME.h5 is NAME.checkpoint_000120.h5, named by the steps that lie behind it. It is
written whole or not at all, and the last `KEPT` are kept. Arrays are those of the whole grid: of
its Q2 nodes (nj, ni, ...), corners and elements. Checksums of HDF5 tell a damaged file.
"""

import os
import re
from pathlib import Path

import h5py
import numpy as np

from ..options import PREFIX
from .files import Disk, Draft, blocks_of, local_part, private, told, write_blocks

#: How many checkpoints of a run are kept.
KEPT = 2
#: The name of a checkpoint, without the folder.
NAME = re.compile(r"(.+)\.checkpoint_(\d+)\.h5")


def checkpoints_of(path):
    """Return the checkpoints of a result file, newest first, a list of Path.

    They lie beside the target of a symbolic link.
    """
    path = Path(os.path.realpath(path) if os.path.islink(path) else path)
    found = [(int(match[2]), entry) for entry in path.parent.iterdir()
             if (match := NAME.fullmatch(entry.name)) and match[1] == path.stem]
    return [entry for _, entry in sorted(found, reverse=True)]


def write(path, grid, run, step, values, arrays, option=("output", PREFIX)):
    """Write a checkpoint, and remove those beyond the last `KEPT`. Collective.

    Parameters
    ----------
    path : Path
        The result file.
    grid : pgran.space.grid.Grid
    run : str
        What names the run.
    step : int
        Steps that lie behind.
    values : dict
        Numbers and texts, kept as attributes; those that are None are left out.
    arrays : dict of dict
        {"nodes" | "corners" | "elements": {name: (..., n_local)}}.
    option : tuple of str
        Name and prefix of the option that named the result file, for messages.

    Raises
    ------
    ParameterError
        If it cannot be written; the earlier checkpoints are then left alone.
    """
    comm, path = grid.comm.tompi4py(), Path(path)
    disk = Disk(comm, option[0], path, option[1])
    target = path.with_name(f"{path.stem}.checkpoint_{step:06d}.h5")
    lattices = {"nodes": grid.nodes, "corners": grid.corners, "elements": grid.elements}
    draft = None

    def prepare():
        nonlocal draft
        sizes = {(place, name): lattices[place].shape[::-1] + value.shape[:-1]
                 for place, fields in arrays.items() for name, value in fields.items()}
        # Chunks at the ends of an array are whole ones: twice the data is room enough.
        draft = Draft(target, 16 * sum(int(np.prod(size)) for size in sizes.values()),
                      unfinished=private(path.with_suffix(".checkpoint")))
        for (place, name), size in sizes.items():
            draft.file.create_dataset(f"{place}/{name}", size, dtype="f8", fletcher32=True)
        for name, value in {**values, "run": run}.items():
            if value is not None:
                draft.file.attrs[name] = value

    disk.do(prepare)
    problem = None
    for place, fields in arrays.items():
        group = None if comm.rank or problem else draft.file[place]
        problem = write_blocks(comm, group, blocks_of(lattices[place], fields)) or problem
    if problem:
        draft.drop()
    disk.agree(None, problem)

    def publish():
        draft.publish(flush=True)
        for old in checkpoints_of(path)[KEPT:]:
            old.unlink()

    disk.do(publish)


def newest(path, run, accept, disk):
    """Return what ``accept`` makes of the newest good checkpoint of a run. Collective.

    Parameters
    ----------
    path : Path
        The result file.
    run : str
        What names the run; checkpoints of other runs are passed over.
    accept : callable
        ``accept(file)`` reads an open checkpoint on every rank. It may raise OSError, KeyError,
        RuntimeError or ValueError for a checkpoint that is damaged.
    disk : pgran.output.files.Disk
        Whose option messages name.

    Returns
    -------
    answer : object
    found : Path
        The checkpoint.
    damaged : list of str
        Newer ones that could not be read, with the reasons.

    Raises
    ------
    ParameterError
        If there is no good one.
    """
    damaged, comm = [], disk.comm
    for entry in disk.do(lambda: checkpoints_of(path)):
        answer = error = None
        try:
            with h5py.File(entry, "r", locking=False) as file:
                if file.attrs["run"] != run:
                    error = "it belongs to another run"
                else:
                    answer = accept(file)
        except (OSError, KeyError, RuntimeError, ValueError) as problem:
            error = told(problem)
        errors = [text for text in comm.allgather(error) if text]
        if not errors:
            return answer, entry, damaged
        damaged.append(f"{entry.name}: {errors[0]}")
    disk.agree(None, "it has no checkpoint to go on from"
               + ("; " + "; ".join(damaged) if damaged else ""))


def read_numbers(file, names):
    """Return the numbers and texts of an open checkpoint, {name: value}.

    Raises ValueError where one of ``names`` is missing or a text, or a number is not finite.
    """
    if missing := sorted(set(names) - set(file.attrs)):
        raise ValueError(f"{', '.join(missing)} is missing")
    values = {}
    for name, value in file.attrs.items():
        text = isinstance(value, str) and name not in names
        if not text and not (np.asarray(value).dtype.kind in "iuf" and np.isfinite(value).all()):
            raise ValueError(f"{name} is not a number")
        values[name] = value.item() if np.ndim(value) == 0 and hasattr(value, "item") else value
    return values


def read_arrays(file, grid, like):
    """Return arrays of an open checkpoint at the local points of a grid, as `write` has them.

    ``like`` are arrays of the same names and components. Raises OSError or ValueError where one is
    missing, damaged, of another shape or not finite.
    """
    arrays = {}
    for place, lattice in (("nodes", grid.nodes), ("corners", grid.corners),
                           ("elements", grid.elements)):
        arrays[place] = {}
        for name, values in like[place].items():
            data, shape = file.get(f"{place}/{name}"), lattice.shape[::-1] + values.shape[:-1]
            if not isinstance(data, h5py.Dataset) or data.dtype.kind != "f" or data.shape != shape:
                raise ValueError(f"{name} is no array of {' x '.join(map(str, shape))} numbers")
            found = arrays[place][name] = local_part(data, lattice.i, lattice.j)
            if not np.isfinite(found).all():
                raise ValueError(f"{name} is not a number everywhere")
    return arrays
