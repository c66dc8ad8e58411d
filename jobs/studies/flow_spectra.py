"""Spectra of steady flows about snapshots: flow_spectra [directory]

The leading eigenvalues of planar shear with gravity, the chute, the annulus and the inclined plane,
from the solver's Jacobian with inertia (pgran.eigen), on two meshes, and the rate at which a small
disturbance of the leading mode changes in the nonlinear solver. The second table has the waves that
grow along planar shear with LI and with NGF. About three minutes on two cores.
"""

import subprocess
from pathlib import Path

import numpy as np

from pgran.output.result import Result
from pgran.runs import run_on_ranks

from .flows import mesh, steady
from .study import FAILED, Report, command, run

#: Title, case, options, the option that varies and its values, element sizes (d).
FLOWS = (
    ("planar shear", "planar_shear", ("-pgran_height", 10, "-pgran_gravity", 0.1),
     "inertial_number", (1e-3, 1e-2, 1e-1), (0.5, 0.25)),
    ("chute", "vertical_chute", ("-pgran_width", 10,), "gravity", (0.08, 0.09, 0.1), (0.5, 0.25)),
    ("annulus", "annular_shear",
     ("-pgran_inner_radius", 5, "-pgran_outer_radius", 10, "-pgran_inertia", "true"),
     "inertial_number", (1e-3, 1e-2, 1e-1), (1, 0.5)),
    ("inclined plane", "inclined_plane", ("-pgran_height", 10,), "slope", (22, 24, 26, 28),
     (0.5, 0.25)))
#: How many eigenvalues are shown.
LEADING = 3
#: Step of the nonlinear runs times the rate, and the steps between which the rate is measured.
SHARE, BETWEEN = 0.02, (10, 50)
#: Largest velocity of the disturbance over the largest velocity of the flow.
SIZE = 1e-4
#: Shear modulus of the nonlinear runs: elastic waves must not matter.
RIGID = 1e8
#: Planar shear with room for waves along the flow: side of the square (d), element sizes, I0.
SQUARE, SIZES, NUMBERS = 10, (1, 0.5, 0.25), (1e-3, 1e-2)
#: Where growing waves are sought, gdot0.
TARGETS = "0,1e3,1e4,1e5,1e6"


def eigenvalues(result, *options):
    """Return what pgran.eigen finds about the last snapshot of a result, a list of dictionaries."""
    return command(1, "pgran.eigen", "-pgran_restart", result, *options)


def shown(rows, count=LEADING):
    """Return the leading eigenvalues as text, the first of each complex pair."""
    rows = [row for row in rows if row["imaginary"] >= 0.0][:count]
    return ", ".join(f"{row['computed']:.5g}" + (f"+-{row['imaginary']:.3g}i" if row["imaginary"]
                                                 else "") for row in rows)


def as_stepped(rate, dt):
    """Return the growth rate, gdot0, of backward Euler with steps ``dt`` for an exact rate."""
    return -np.log(1.0 - rate * dt) / dt


def measured(result, case, rate, *options):
    """Return the rate, gdot0, at which the mode of a real eigenvalue changes in the solver.

    The error of backward Euler is removed. ``options`` are the options of the result.
    """
    result = Path(result)
    mode = result.with_name(f"{result.stem}_mode.h5")
    if not (mode.exists() and mode.stat().st_mtime > result.stat().st_mtime):
        run_on_ranks.python(1, "-m", "pgran.eigen", "-pgran_restart", result, "-pgran_output",
                            mode, stdout=subprocess.DEVNULL)
    shape, base = (Result(mode).snapshots[0][name] for name in ("velocity", "base_velocity"))
    dt = SHARE / abs(rate)
    first, end = (dt * count for count in BETWEEN)
    path = result.with_name(f"{result.stem}_run.h5")
    followed = run(
        path, case, *options, "-ts_type", "beuler",
        "-pgran_inertia", "true", "-pgran_shear_modulus", RIGID, "-pgran_mode_file", mode,
        "-pgran_mode_amplitude", float(SIZE * np.abs(base).max()), "-pgran_step_first", dt,
        "-pgran_step_max", dt, "-pgran_step_error", 1e6, "-pgran_end_time", end,
        "-pgran_snapshots", first)
    sizes = [((snapshot["velocity"] - base) * shape).sum() for snapshot in followed.snapshots]
    return float(np.log(sizes[1] / sizes[0]) / (end - first)) * rate / as_stepped(rate, dt)


def decay(directory, *options):
    """Make the table of leading eigenvalues."""
    table = Report(directory / "decay.csv", {
        "flow": "", "of": "", "element (d)": "g", "leading": "", "residual": ".0e",
        "change from previous mesh (%)": ".2f", "nonlinear": ".5g", "difference (%)": "+.2f"},
        "flow_spectra_decay")
    for title, case, flow, name, values, sizes in FLOWS:
        for value in values:
            previous = None
            for size in sizes:
                varied = (*flow, f"-pgran_{name}", value)
                path = directory / f"{case}_{value:g}_{size:g}.h5"
                if steady(path, case, size, *varied, *options) is None:
                    table.note(title, f"{name} {value:g}", FAILED)
                    continue
                rows = eigenvalues(path)
                rate, found = rows[0]["computed"], None
                if size == sizes[0] and not rows[0]["imaginary"]:
                    found = measured(path, case, rate, *varied, *mesh(case, size), *options)
                table.row(title, f"{name} {value:g}", size, shown(rows), rows[0]["residual"],
                          100 * abs(rate / previous - 1) if previous else None, found,
                          100 * (found / rate - 1) if found else None)
                previous = rate


def growth(directory, *options):
    """Make the table of waves that grow along planar shear, for LI and NGF."""
    table = Report(directory / "growth.csv", {
        "model": "", "I0": "g", "element (d)": "g", "unstable modes found": "d",
        "fastest": "", "residual": ".0e"}, "flow_spectra_growth")
    for model in ("li", "ngf"):
        for number in NUMBERS:
            for size in SIZES:
                path = directory / f"square_{model}_{number:g}_{size:g}.h5"
                run(path, "planar_shear", "-pgran_gravity", 0, "-pgran_grading", 1, "-pgran_law",
                    "jop", "-pgran_model", model, "-pgran_width", SQUARE, "-pgran_height", SQUARE,
                    "-pgran_element_size", size, "-pgran_inertial_number", number, *options)
                rows = eigenvalues(path, "-target", TARGETS)
                table.row(model, number, size, sum(row["computed"] > 0.0 for row in rows),
                          shown(rows, 1), rows[0]["residual"])


def main(directory="results/flow_spectra", *, options=()):
    """Make both tables."""
    decay(Path(directory), *options)
    growth(Path(directory), *options)
