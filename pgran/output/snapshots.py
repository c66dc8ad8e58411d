"""Snapshot files NAME.snapshot_RUN_0003.h5, with identifier of the run and serial number.

Such a file holds the fields in the group `GROUP`, and its name (``file``) and ``run`` as root
attributes. NAME.h5 has an external link to it without a folder, so that all files can be moved.
"""

import os
import re
from pathlib import Path

import h5py

from . import checkpoint

#: The group of a snapshot in its file.
GROUP = "snapshot"
#: The group of its fields at the repeated nodes of a periodic grid.
REPEATED = "repeated"
#: Name of a snapshot file: stem of the result, run and serial number.
NAME = re.compile(r"(.+)\.snapshot_([0-9A-Za-z]+)_(\d+)\.h5")


def ordered(groups):
    """Return the names of snapshots in the order of their numbers."""
    return sorted(groups, key=lambda name: (len(name), name))


def linked(file):
    """Return {name: file name} of the snapshots of a result; None for those inside the result."""
    groups = file["snapshots"]
    return {name: getattr(groups.get(name, getlink=True), "filename", None)
            for name in ordered(groups)}


def add_link(file, name, target, ends=(False, False)):
    """Link snapshot ``name`` of an open result to the file named ``target``."""
    file["snapshots"][name] = h5py.ExternalLink(target, f"/{GROUP}")
    if any(ends):
        file.require_group(REPEATED)[name] = h5py.ExternalLink(target, f"/{REPEATED}")


def files_of(path, run):
    """Return {serial number: Path} of the snapshot files of a run under the name of a result."""
    return {int(match[3]): entry for entry in path.parent.iterdir()
            if (match := NAME.fullmatch(entry.name)) and match[1] == path.stem and match[2] == run}


def file_name(path, run, serial):
    """Return the path of the snapshot file with a serial number that belongs to a result."""
    return path.with_name(f"{path.stem}.snapshot_{run}_{serial:04d}.h5")


def remove_unlinked(path, run, kept):
    """Remove the `files_of` a run whose names are not in ``kept``.

    Nothing is removed if the folder has another result of the run, such as a copy that links to
    these files.
    """
    extra = [entry for entry in files_of(path, run).values() if entry.name not in kept]
    results = (entry for entry in path.parent.glob("*.h5") if entry.name != path.name
               and not NAME.fullmatch(entry.name) and not checkpoint.NAME.fullmatch(entry.name))
    if extra and all(_run_of(entry) != run for entry in results):
        for entry in extra:
            entry.unlink()


def _run_of(path):
    try:
        with h5py.File(path, "r", locking=False) as file:
            return file.attrs.get("run")
    except OSError:
        return None


def problem_of(path, run, target):
    """Return what is wrong with the snapshot file ``target`` of a result, a text, or None."""
    entry = Path(os.path.realpath(path)).parent / target
    if not entry.is_file():
        return f"its file {entry} is missing"
    with h5py.File(entry, "r", locking=False) as file:
        found_run, name = file.attrs.get("run"), file.attrs.get("file")
    if (found_run, name) != (run, target):
        return f"its file {entry} was written as {name} by run {found_run}, not by run {run}"
    return None
