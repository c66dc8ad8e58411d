"""Measure the shear band in result files: python -m pgran.measure NAME.h5 ... [-json]

``python -m pgran.measure -meshes COARSE.h5 FINE.h5 ...`` compares the last snapshots of runs on
meshes that divide each other, at common material points.

For each snapshot it prints the angle of the band with the x1 axis, its width (full width at half
maximum of the inertial number, normal to the band, averaged along it), the range of I, and whether
the flow is localised. `pgran.output.band` says how these are found.
"""

import sys

from .cli import JSON, answer, as_json, own
from .options import OptionError
from .output import band

ROWS = own("meshes", "flag", "compare successive files instead", False), JSON


def compare(paths, in_json):
    """Print how far I changes from each mesh to the next, as JSON if ``in_json``."""
    rows = band.compare(paths)
    if in_json:
        print(as_json(rows))
        return
    print("difference of I from the next mesh, over its L2 norm and over its maximum")
    for path, row in zip(paths, rows):
        order = "" if row["order"] is None else f"  order {row['order']:.2f}"
        print(f"  {path}: {100 * row['l2']:.2f} %  {100 * row['maximum']:.2f} %{order}")


def describe(row):
    """Return the line that tells what was measured in a snapshot."""
    line = (f"  {row.get('label', ''):>20}  I {row['inertial_number_min']:.3e} to "
            f"{row['inertial_number_max']:.3e}  "
            f"{'localised' if row['localised'] else 'not localised'}")
    if row["localised"] and row["angle"] is not None:
        line += (f"  {row['bands']} band{'s' if row['bands'] != 1 else ''}  "
                 f"angle {row['angle']:.1f} +- {row['angle_error']:.1f} degrees  "
                 f"width {row['width']:.1f} +- {row['width_error']:.1f} d")
    return line


def run(asked, paths):
    """Measure the files and print the result."""
    if asked.meshes:
        if len(paths) < 2:
            raise OptionError(f"-meshes {paths[0]}: allowed are two files or more")
        compare(paths, asked.json)
        return
    found = {path: band.measure(path) for path in paths}
    if asked.json:
        print(as_json(found[paths[0]] if len(paths) == 1 else found))
        return
    for path, rows in found.items():
        print("\n".join([path, *map(describe, rows)]))


def main(arguments):
    """Measure the files named in ``arguments``; return the exit code."""
    return answer(arguments, "measure", run, __doc__, ROWS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
