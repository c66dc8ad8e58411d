"""Measure shear bands: python -m pgran.measure NAME.h5 ... [-json]

For each snapshot it prints the range of I, whether flow is localised, and the angle of each band
with the x1 axis and its full width at half maximum of I, or why there is no band. -meshes compares
the last snapshots of runs that differ only by meshes; each mesh must divide the previous elements.
"""

import sys

from .cli import JSON, as_json, run_without_petsc
from .options import OptionError, command_option, plain
from .output import band
from .output.reader import ResultError
from .output.result import Result

#: Options of the mesh, which may differ between the compared runs.
MESH = "element_size", "cell_elements", "grading", "imperfection_size"
#: Options that must not differ, although a restart may change them.
MATERIAL = "shear_modulus", "inertia"
OPTIONS = command_option("meshes", "flag", "compare runs on successive meshes", False), JSON


def check_same_problem(results):
    """Raise `OptionError` unless the last snapshots of results differ only by their meshes."""
    first = problem(results[0])
    for result in results[1:]:
        other = problem(result)
        differing = [f"{name} ({plain(value)} and {plain(other[name])})"
                     for name, value in first.items()
                     if None not in (value, other.get(name)) and value != other[name]]
        if differing:
            raise OptionError(f"-meshes {results[0].path} {result.path}: the runs must differ only "
                              f"by their meshes, but differ in {', '.join(differing)}")


def problem(result):
    """Return the options and the progress of the last snapshot, {name: value}, without its mesh."""
    if not result.snapshots:
        raise ResultError(result.path, "it holds 0 snapshots")
    name, parameters = result.case.progress_name, result.parameters
    found = {f"-{option.prefix}{option.name}": getattr(parameters, option.name)
             for option in parameters.options
             if (option.shared or option.name in MATERIAL) and option.name not in MESH}
    return {**found, name: round(float(result.snapshots[-1].attributes[name]), 9)}


def describe(row):
    """Return the measurements of a snapshot as a line of text."""
    line = (f"  {row.get('label', ''):>20}  I {row['inertial_number_min']:.3e} to "
            f"{row['inertial_number_max']:.3e}  "
            f"{'localised' if row['localised'] else 'not localised'}")
    if row["reason"]:
        return f"{line}  no band: {row['reason']}"
    line += f"  {row['bands']} band{'s' if row['bands'] != 1 else ''}" + ";".join(
        f"  angle {each['angle']:.1f} +- {each['angle_error']:.1f} degrees  "
        f"width {each['width']:.1f} +- {each['width_error']:.1f} d" for each in row["each_band"])
    return line + (f"; parts of other bands: {row['parts']}" if row["parts"] else "")


def run(args, paths):
    """Measure the files and print the result."""
    if args.meshes:
        if len(paths) < 2:
            raise OptionError(f"-meshes {paths[0]}: requires at least two files")
        check_same_problem([Result(path) for path in paths])
        found = band.compare(paths)
        lines = ["difference of I from the next mesh, over its L2 norm and over its maximum"]
        for path, row in zip(paths, found):
            order = f"  order {row['order']:.2f}" if row["order"] else ""
            lines.append(f"  {path}: {100 * row['l2']:.2f} %  {100 * row['maximum']:.2f} %{order}")
    else:
        found = {path: band.measure(path) for path in paths}
        lines = [line for path, rows in found.items() for line in (path, *map(describe, rows))]
        found = found[paths[0]] if len(paths) == 1 else found
    print(as_json(found) if args.json else "\n".join(lines))


def main(arguments):
    """Measure the files named in ``arguments``; return the exit code."""
    return run_without_petsc(arguments, "measure", run, __doc__, OPTIONS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
