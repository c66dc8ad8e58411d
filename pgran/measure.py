"""Measure the shear band in result files: python -m pgran.measure NAME.h5 ... [-json]

``python -m pgran.measure -meshes COARSE.h5 FINE.h5 ...`` compares the last snapshots of runs on
meshes that divide each other, at common material points. The runs must not differ otherwise.

For each snapshot it prints the range of I, whether the flow is localised, and the angle of each
band with the x1 axis and its width (full width at half maximum of the inertial number, normal to
the band, averaged along it), or why there is no band. `pgran.output.band` describes the method.
"""

import sys

from .cli import JSON, as_json, command_option, run_without_petsc
from .options import OptionError, plain
from .output import band
from .output.reader import ResultError
from .output.result import Result

#: Options of the mesh. They are allowed to differ between runs whose meshes are compared.
MESH = "element_size", "cell_elements", "grading", "imperfection_size"
#: Options that change the solution, although a run may begin from a result with other values.
MATERIAL = "shear_modulus", "inertia"
#: Decimals to which a snapshot's place in the run is compared.
DIGITS = 9
OPTIONS = command_option("meshes", "flag", "compare successive files instead", False), JSON


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


def check_same_problem(results):
    """Raise `OptionError` unless the last snapshots of results differ by their meshes only."""
    problems = [problem(result) for result in results]
    for result, other in zip(results[1:], problems[1:]):
        differing = [f"{name} ({plain(here)} and {plain(other[name])})"
                     for name, here in problems[0].items()
                     if name in other and here != other[name] and None not in (here, other[name])]
        if differing:
            raise OptionError(f"-meshes {results[0].path} {result.path}: allowed are runs that "
                              "differ by their meshes only; these differ in "
                              + ", ".join(differing))


def problem(result):
    """Return what the last snapshot of a result shows, {name: value}, without its mesh."""
    if not result.snapshots:
        raise ResultError(result.path, "it holds 0 snapshots")
    counted, parameters = result.case.progress_name, result.parameters
    found = {f"-{row.prefix}{row.name}": getattr(parameters, row.name) for row in parameters.options
             if (row.shared or row.name in MATERIAL) and row.name not in MESH}
    found[counted] = round(float(result.snapshots[-1].attributes[counted]), DIGITS)
    return found


def describe(row):
    """Return the line that tells what was measured in a snapshot."""
    line = (f"  {row.get('label', ''):>20}  I {row['inertial_number_min']:.3e} to "
            f"{row['inertial_number_max']:.3e}  "
            f"{'localised' if row['localised'] else 'not localised'}")
    if row["reason"]:
        return f"{line}  no band: {row['reason']}"
    line += f"  {row['bands']} band{'s' if row['bands'] != 1 else ''}" + ";".join(
        f"  angle {each['angle']:.1f} +- {each['angle_error']:.1f} degrees  "
        f"width {each['width']:.1f} +- {each['width_error']:.1f} d" for each in row["each_band"])
    return line + (f"; parts of other bands: {row['parts']}" if row["parts"] else "")


def run(asked, paths):
    """Measure the files and print the result."""
    if asked.meshes:
        if len(paths) < 2:
            raise OptionError(f"-meshes {paths[0]}: allowed are two files or more")
        check_same_problem([Result(path) for path in paths])
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
    return run_without_petsc(arguments, "measure", run, __doc__, OPTIONS, operands="NAME.h5")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
