"""Draw result files: python -m pgran.plot NAME.h5 ...

Writes, beside each file, one picture for each snapshot, NAME_0000.png and so on, of the inertial
number on the deformed shape. One colour scale holds for all pictures of a file.
"""

import sys

from .cli import answer


def run(asked, paths):
    """Draw the files and print the names of the pictures."""
    from .output import pictures

    for path in paths:
        print("\n".join(str(picture) for picture in pictures.pictures(path)))


def main(arguments):
    """Draw the files named in ``arguments``; return the exit code."""
    return answer(arguments, "plot", run, __doc__, (), operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
