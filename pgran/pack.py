"""Pack a result into one file, for moving and archiving: python -m pgran.pack NAME.h5 OUT.h5

A run writes each snapshot to a file of its own beside NAME.h5. OUT.h5 holds the history, the
options and all snapshots under the same paths, and links to no other file. Checkpoints are not
packed. An existing OUT.h5 is refused.
"""

import os
import sys
from pathlib import Path

from .cli import run_without_petsc
from .options import OptionError
from .output import vtkhdf
from .output.files import Draft
from .output.reader import FORMAT, opened
from .output.snapshots import ordered


def pack(path, target):
    """Copy a result with all its snapshots into one file.

    Parameters
    ----------
    path : str or Path
        The result.
    target : str or Path
        The new file, which must not exist.

    Raises
    ------
    ResultError
        If ``path`` is not a result, or one of its snapshot files is missing or of another run.
    OSError
        If ``target`` exists, or cannot be written.
    """
    target = Path(target)
    if os.path.lexists(target):
        raise FileExistsError(f"{target}: this file exists already")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target}: there is no folder {target.parent}")
    with opened(path) as file:
        names = ordered(file["snapshots"])
        room = sum(data.nbytes for name in names for data in file["snapshots"][name].values())
        draft = Draft(target, room + os.path.getsize(path))
        with draft:
            draft.file.attrs.update({**file.attrs, "format": FORMAT})
            for name in ("history", "cells"):
                if name in file:
                    file.copy(name, draft.file)
            inside = draft.file.create_group("snapshots", track_order=True)
            for name in names:
                file.copy(file["snapshots"][name], inside, name)
            vtkhdf.link(draft.file, tuple(map(bool, file.attrs.get("closed", (False, False)))))
        draft.publish(flush=True)


def run(asked, paths):
    """Pack the first of two paths into the second."""
    if len(paths) != 2:
        raise OptionError(f"{' '.join(paths)}: allowed are two files, NAME.h5 and OUT.h5")
    pack(*paths)
    print(f"{paths[1]}: {os.path.getsize(paths[1])} bytes")


def main(arguments):
    """Pack the file named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "pack", run, __doc__, (), operands="NAME.h5 OUT.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
