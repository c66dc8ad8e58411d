"""Files of snapshots: each snapshot is written once, to a file of its own beside NAME.h5.

The file NAME.snapshot_RUN_0003.h5, with the identifier RUN of the run and a serial number, holds
the group `GROUP` with the fields. Its root attributes repeat its own name (``file``) and ``run``.
It is never changed, and its name is never used again. NAME.h5 has an external link to it by its
name alone, so that a folder can be moved as a whole.
"""

import os
import re
from pathlib import Path

import h5py

from . import checkpoint

#: The group of a snapshot in its own file.
GROUP = "snapshot"
#: The group of its fields where the first nodes of a periodic grid are repeated at the end.
REPEATED = "repeated"
#: The name of such a file, without the folder: stem of the result, run and serial number.
NAME = re.compile(r"(.+)\.snapshot_([0-9A-Za-z]+)_(\d+)\.h5")


def ordered(groups):
    """Return the names of snapshots in the order of their numbers."""
    return sorted(groups, key=lambda name: (len(name), name))


def folder(path):
    """Return the folder that holds the snapshot files of a result, also behind a symbolic link."""
    return Path(os.path.realpath(path)).parent


def linked(file):
    """Return {name: file name} of the snapshots of an open result; None for one inside it."""
    groups, found = file["snapshots"], {}
    for name in ordered(groups):
        link = groups.get(name, getlink=True)
        found[name] = link.filename if isinstance(link, h5py.ExternalLink) else None
    return found


def add_link(file, name, target, ends=(False, False)):
    """Link snapshot ``name`` of an open result to the file named ``target``.

    ``ends`` says along which of x1 and x2 the file has repeated nodes.
    """
    file["snapshots"][name] = h5py.ExternalLink(target, f"/{GROUP}")
    if any(ends):
        file.require_group(REPEATED)[name] = h5py.ExternalLink(target, f"/{REPEATED}")


def files_of(path, run):
    """Return the snapshot files that a run wrote under the name of a result, oldest first."""
    path = Path(path)
    found = [(int(match[3]), entry) for entry in path.parent.iterdir()
             if (match := NAME.fullmatch(entry.name)) and match[1] == path.stem
             and match[2] == run]
    return [entry for _, entry in sorted(found)]


def file_name(path, run, serial):
    """Return the path of the snapshot file with a serial number that belongs to a result."""
    path = Path(path)
    return path.with_name(f"{path.stem}.snapshot_{run}_{serial:04d}.h5")


def next_serial(path, run):
    """Return a serial number above those of all `files_of` the run."""
    return max((int(NAME.fullmatch(entry.name)[3]) + 1 for entry in files_of(path, run)),
               default=0)


def remove_unlinked(path, run, kept):
    """Remove the `files_of` a run whose names are not among ``kept``.

    Nothing is removed where another result in the folder holds the same run, as a copy of the
    result does: it may link to them.
    """
    path = Path(path)
    extra = [entry for entry in files_of(path, run) if entry.name not in kept]
    if extra and not any(_run_of(entry) == run for entry in path.parent.glob("*.h5")
                         if entry.name != path.name and not NAME.fullmatch(entry.name)
                         and not checkpoint.NAME.fullmatch(entry.name)):
        for entry in extra:
            entry.unlink()


def _run_of(path):
    """Return the identifier of the run in a file, or None."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            return file.attrs.get("run")
    except OSError:
        return None


def problem_of(path, run, target):
    """Return what is wrong with the file ``target`` of a snapshot, a text, or None.

    Parameters
    ----------
    path : str or Path
        The result.
    run : str
        The identifier of its run.
    target : str
        The name that the result links to.
    """
    entry = folder(path) / target
    if not entry.is_file():
        return f"its file {entry} is missing"
    with h5py.File(entry, "r", locking=False) as file:
        theirs = file.attrs.get("run"), file.attrs.get("file")
    if theirs != (run, target):
        return (f"its file {entry} is another one: it was written as {theirs[1]} by run "
                f"{theirs[0]}, not by run {run}")
    return None
