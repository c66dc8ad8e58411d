"""Pack a result into one file: python -m pgran.pack NAME.h5 OUT.h5

A run writes each snapshot to a separate file in the directory of NAME.h5. OUT.h5 contains the
history, the options and all snapshots under the same paths, without external links. Checkpoints are
not packed. An existing OUT.h5 is not overwritten.
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
    """Copy a result with all its snapshots into one new file ``target``.

    Raises `ResultError` if ``path`` is not a complete result, and OSError if ``target`` exists or
    cannot be written.
    """
    target = Path(target)
    if os.path.lexists(target):
        raise FileExistsError(f"{target}: this file exists already")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target}: there is no folder {target.parent}")
    with opened(path) as file:
        snapshots = file["snapshots"]
        size = sum(data.nbytes for group in snapshots.values() for data in group.values())
        draft = Draft(target, size + os.path.getsize(path))
        with draft:
            draft.file.attrs.update({**file.attrs, "format": FORMAT})
            for name in ("history", "cells"):
                if name in file:
                    file.copy(name, draft.file)
            copies = draft.file.create_group("snapshots", track_order=True)
            for name in ordered(snapshots):
                file.copy(snapshots[name], copies, name)
            vtkhdf.link(draft.file, tuple(map(bool, file.attrs.get("closed", (False, False)))))
        draft.publish(flush=True)


def run(args, paths):
    """Pack the first of two paths into the second."""
    if len(paths) != 2:
        raise OptionError(f"{' '.join(paths)}: must be two files, NAME.h5 OUT.h5")
    pack(*paths)
    print(f"{paths[1]}: {os.path.getsize(paths[1])} bytes")


def main(arguments):
    """Pack the file named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "pack", run, __doc__, (), operands="NAME.h5 OUT.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
