"""Checkpoints NAME.checkpoint_000120.h5: files to continue a run on any number of ranks.

The number counts the accepted steps. The arrays cover the complete grid: Q2 nodes (nj, ni, ...),
corners and elements. Checksums of HDF5 detect damaged files.
"""

import os
import re
from pathlib import Path

import h5py
import numpy as np

from . import files
from .files import Disk, Draft

#: Number of checkpoints of a run that are kept.
KEPT = 2
#: Name of a checkpoint without its folder.
NAME = re.compile(r"(.+)\.checkpoint_(\d+)\.h5")


def checkpoints_of(path):
    """Return the checkpoints of a result file or a link to one, newest first, a list of Path."""
    path = Path(os.path.realpath(path) if os.path.islink(path) else path)
    found = [(int(match[2]), entry) for entry in path.parent.iterdir()
             if (match := NAME.fullmatch(entry.name)) and match[1] == path.stem]
    return [entry for _, entry in sorted(found, reverse=True)]


def write(path, grid, run, step, values, arrays):
    """Write a checkpoint of the result ``path`` and remove older ones beyond `KEPT`. Collective.

    ``values`` are numbers and texts, stored as attributes; None is left out. ``arrays`` =
    {"nodes" | "corners" | "elements": {name: (..., n_local)}}. Raises `ParameterError` if the
    checkpoint cannot be written; the earlier ones then remain.
    """
    def prepare():
        sizes = {f"{kind}/{name}": getattr(grid, kind).shape[::-1] + value.shape[:-1]
                 for kind, fields in arrays.items() for name, value in fields.items()}
        # Chunks at the ends of an array are stored in full: reserve twice the size of the data.
        draft = Draft(path.with_name(f"{path.stem}.checkpoint_{step:06d}.h5"),
                      16 * sum(int(np.prod(size)) for size in sizes.values()),
                      files.private(path.with_suffix(".checkpoint")))
        with draft:
            for name, size in sizes.items():
                draft.file.create_dataset(name, size, dtype="f8", fletcher32=True)
            draft.file.attrs.update({name: value for name, value in {**values, "run": run}.items()
                                     if value is not None})
        return draft

    def finish(draft):
        draft.publish(flush=True)
        for old in checkpoints_of(path)[KEPT:]:
            old.unlink()

    files.write_draft(Disk(grid.comm.tompi4py(), "output", path), prepare, (
        entry for kind, fields in arrays.items()
        for entry in files.blocks_of(getattr(grid, kind), fields, f"{kind}/")), finish)


def newest(path, run, accept, disk):
    """Return ``accept(file)`` of the newest valid checkpoint of a run. Collective.

    ``accept`` raises an error for a damaged checkpoint. Also returns the checkpoint (Path) and the
    reasons why newer ones cannot be read. Raises `ParameterError` if there is no valid checkpoint.
    """
    damaged, comm = [], disk.comm
    for entry in disk.do(lambda: checkpoints_of(path)):
        result = error = None
        try:
            with h5py.File(entry, "r", locking=False) as file:
                if file.attrs["run"] != run:
                    raise ValueError("it belongs to another run")
                result = accept(file)
        except files.FILE_ERRORS as problem:
            error = files.error_text(problem)
        errors = [text for text in comm.allgather(error) if text]
        if not errors:
            return result, entry, damaged
        damaged.append(f"{entry.name}: {errors[0]}")
    disk.agree(None, "; ".join(["it has no checkpoint to resume from", *damaged]))


def read_numbers(file, names):
    """Return the numbers and texts of an open checkpoint, {name: value}.

    Raises ValueError if one of ``names`` is missing or a text, or if a number is not finite.
    """
    if missing := sorted(set(names) - set(file.attrs)):
        raise ValueError(f"{', '.join(missing)} is missing")
    values = {}
    for name, value in file.attrs.items():
        text = isinstance(value, str) and name not in names
        if not text and not (np.asarray(value).dtype.kind in "iuf" and np.isfinite(value).all()):
            raise ValueError(f"{name} is not a finite number")
        values[name] = value.item() if np.ndim(value) == 0 and hasattr(value, "item") else value
    return values


def read_arrays(file, grid, like):
    """Return arrays of an open checkpoint in the form of `write`, with the names of ``like``.

    Raises OSError or ValueError if an array is missing, damaged, of another shape or not finite.
    """
    arrays = {kind: {} for kind in like}
    for kind, fields in like.items():
        lattice = getattr(grid, kind)
        for name, values in fields.items():
            data, shape = file.get(f"{kind}/{name}"), lattice.shape[::-1] + values.shape[:-1]
            if not isinstance(data, h5py.Dataset) or data.dtype.kind != "f" or data.shape != shape:
                raise ValueError(f"{name} is not an array of {' x '.join(map(str, shape))} numbers")
            found = arrays[kind][name] = files.local_part(data, lattice.index)
            if not np.isfinite(found).all():
                raise ValueError(f"{name} contains NaN or infinite values")
    return arrays
