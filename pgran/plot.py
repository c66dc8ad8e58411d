"""Draw results: python -m pgran.plot NAME.h5 [NAME.h5 ...] [options]

Without options each snapshot is drawn beside its file, NAME_0000.png and so on: the inertial number
on the deformed shape, with one colour scale for a file. A file may still be written.

    python -m pgran.plot biaxial.h5 -field strain -snapshot -1 -band -arrows
    python -m pgran.plot biaxial.h5 -together -format pdf       # all snapshots side by side
    python -m pgran.plot coarse.h5 fine.h5 -together -snapshot -1
    python -m pgran.plot biaxial.h5 -line 0,54,40,54            # a profile along a line
    python -m pgran.plot biaxial.h5 -history top_stress         # stress against compression
    python -m pgran.plot biaxial.h5 -movie biaxial.gif

Quantities:
"""

import sys
from pathlib import Path

from .cli import command_option, run_without_petsc
from .options import OptionError
from .output.result import QUANTITIES, Result

OPTIONS = (
    command_option("field", "str", "quantities to draw, with commas between them", "inertial_number"),
    command_option("snapshot", "int", "only this one; a negative number counts from the end"),
    command_option("together", "flag", "one picture of all files and snapshots on one scale", False),
    command_option("format", "str", "png, svg or pdf", "png"),
    command_option("output", "str", "name of the picture of -together, -line and -history"),
    command_option("limits", "floats", "two ends of the colour scale"),
    command_option("log", "flag", "a logarithmic scale", False),
    command_option("mesh", "flag", "draw the elements", False),
    command_option("arrows", "flag", "draw the velocity", False),
    command_option("band", "flag", "draw the shear band, its angle and its width", False),
    command_option("no_outline", "flag", "leave out where the material was at the start", False),
    command_option("line", "floats", "a profile from x1,x2 to x1,x2 instead of a picture", unit="d"),
    command_option("history", "str", "curves of these columns of the history, with commas between them, "
        "instead of a picture"),
    command_option("movie", "str", "a movie of all snapshots instead of pictures, NAME.gif or NAME.mp4"),
    command_option("show", "flag", "an interactive window instead of a picture", False))
__doc__ += "".join(f"\n    {name:16} {quantity.meaning}" for name, quantity in QUANTITIES.items())
__doc__ += "\n"


def run(asked, paths):
    """Draw the files and print the names of the pictures."""
    check(asked)
    print("\n".join(map(str, drawn(asked, paths))))


def check(asked):
    """Raise `OptionError` for values that are not allowed."""
    from .output.pictures import FORMATS

    if asked.format not in FORMATS:
        raise OptionError(f"-format {asked.format}: allowed is {' | '.join(FORMATS)}")
    for name, count in (("limits", 2), ("line", 4)):
        values = getattr(asked, name)
        if values is not None and len(values) != count:
            raise OptionError(f"-{name} {','.join(map(str, values))}: allowed are {count} numbers")
    if asked.line and asked.line[:2] == asked.line[2:]:
        raise OptionError(f"-line {','.join(f'{value:g}' for value in asked.line)}: the two points "
                          "must differ")
    if asked.limits and not asked.limits[0] < asked.limits[1]:
        raise OptionError(f"-limits {asked.limits[0]:g},{asked.limits[1]:g}: the first must be "
                          "the smaller one")


def drawn(asked, paths):
    """Draw what is asked for; return the paths of the pictures."""
    from .output import pictures

    style = pictures.Style(asked.limits, asked.log, asked.mesh, asked.arrows, asked.band,
                           not asked.no_outline)
    suffix, one = f".{asked.format}", -1 if asked.snapshot is None else asked.snapshot

    def target(words):
        return Path(asked.output or Path(paths[0]).with_name(
            f"{Path(paths[0]).stem}_{words}{suffix}"))

    if asked.history:
        names = asked.history.split(",")
        return pictures.curves([Result(path) for path in paths], names, target("_".join(names)))
    written = []
    names = asked.field.split(",")
    for name in names:
        for path in paths:
            pictures.check_field(Result(path), name)
    for name in names:
        if asked.show:
            snapshot, = pictures.snapshots_of(Result(paths[0]), one)
            written += pictures.window(snapshot, name)
        elif asked.movie:
            written += pictures.movie(Result(paths[0]), name, style, asked.movie)
        elif asked.line:
            written += pictures.profiles(
                [Result(path) for path in paths], name, asked.line, target(f"{name}_line"), one)
        elif asked.together:
            chosen = [snapshot for path in paths
                      for snapshot in pictures.snapshots_of(Result(path), asked.snapshot)]
            pictures.panels(chosen, name, style).savefig(target(name))
            written.append(target(name))
        else:
            for path in paths:
                written += pictures.pictures(path, name, style, suffix, asked.snapshot)
    return written


def main(arguments):
    """Draw the files named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "plot", run, __doc__, OPTIONS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
