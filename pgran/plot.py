"""Plot results: python -m pgran.plot NAME.h5 [NAME.h5 ...] [options]

By default each snapshot is drawn to a file NAME_0000.png, ... in the directory of NAME.h5: the
inertial number on the deformed shape, with one colour scale per file. Files of running jobs can be
plotted.

    python -m pgran.plot biaxial.h5 -field strain -snapshot -1 -band -arrows
    python -m pgran.plot biaxial.h5 -together -format pdf       # all snapshots in one picture
    python -m pgran.plot coarse.h5 fine.h5 -together -snapshot -1
    python -m pgran.plot biaxial.h5 -line 0,54,40,54            # a profile along a line
    python -m pgran.plot biaxial.h5 -history top_stress         # stress over compression
    python -m pgran.plot biaxial.h5 -movie biaxial.gif

Quantities:
"""

import sys
from pathlib import Path

from .cli import run_without_petsc
from .options import OptionError, command_option
from .output.result import QUANTITIES, Result

OPTIONS = (
    command_option("field", "str", "quantities, separated by commas", "inertial_number"),
    command_option("snapshot", "int", "number of the only snapshot; negative from the end"),
    command_option("together", "flag", "one picture of all files and snapshots", False),
    command_option("format", "str", "format of the pictures", "png",
                   choices=("png", "svg", "pdf")),
    command_option("output", "str", "file of the picture of -together, -line and -history"),
    command_option("limits", "floats", "smallest and largest value of the colour scale", length=2),
    command_option("log", "flag", "logarithmic colour scale", False),
    command_option("mesh", "flag", "draw the elements", False),
    command_option("arrows", "flag", "draw the velocity", False),
    command_option("band", "flag", "draw the shear band, its angle and its width", False),
    command_option("no_outline", "flag", "omit the initial outline of the material", False),
    command_option("line", "floats", "draw a profile from x1,x2 to x1,x2", unit="d", length=4),
    command_option("history", "str", "draw curves of columns of the history, separated by commas"),
    command_option("movie", "str", "draw a movie of all snapshots, NAME.gif or NAME.mp4"),
    command_option("show", "flag", "open an interactive window", False))
__doc__ += "".join(f"\n    {name:16} {quantity.meaning}" for name, quantity in QUANTITIES.items())
__doc__ += "\n"


def run(args, paths):
    """Draw the files and print the names of the pictures."""
    from .output import pictures

    if args.line and args.line[:2] == args.line[2:]:
        raise OptionError("-line {:g},{:g},{:g},{:g}: the two points must differ".format(
            *args.line))
    if args.limits and not args.limits[0] < args.limits[1]:
        raise OptionError("-limits {:g},{:g}: the first number must be < the second".format(
            *args.limits))
    style = pictures.Style(args.limits, args.log, args.mesh, args.arrows, args.band,
                           not args.no_outline)
    suffix, one = f".{args.format}", -1 if args.snapshot is None else args.snapshot
    results = [Result(path) for path in paths]

    def save(figure, words):
        path = Path(args.output or f"{Path(paths[0]).with_suffix('')}_{words}{suffix}")
        figure.savefig(path)
        print(path)

    if args.history:
        names = args.history.split(",")
        save(pictures.curves(results, names), "_".join(names))
        return
    names = args.field.split(",")
    for name in names:
        for result in results:
            pictures.check_field(result, name)
    for name in names:
        if args.show:
            snapshot, = pictures.snapshots_of(results[0], one)
            pictures.window(snapshot, name)
        elif args.movie:
            pictures.movie(results[0], name, style, args.movie)
            print(args.movie)
        elif args.line:
            save(pictures.profiles(results, name, args.line, one), f"{name}_line")
        elif args.together:
            chosen = [snapshot for result in results
                      for snapshot in pictures.snapshots_of(result, args.snapshot)]
            save(pictures.panels(chosen, name, style), name)
        else:
            for path in paths:
                print(*pictures.pictures(path, name, style, suffix, args.snapshot), sep="\n")


def main(arguments):
    """Draw the files named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "plot", run, __doc__, OPTIONS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
