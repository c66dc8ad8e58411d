"""Spectra of steady flows, and the same rates in the nonlinear solver."""

import subprocess
from pathlib import Path

import numpy as np

from pgran.output.result import Result
from pgran.runs import run_on_ranks

from . import study
from .flows import mesh, steady

#: Title, case, options, the option that varies and its values, element sizes (d).
FLOWS = (
    ("planar shear", "planar_shear", ("-pgran_height", 10, "-pgran_gravity", 0.1),
     "inertial_number", (1e-3, 1e-2, 1e-1), (0.5, 0.25)),
    ("chute", "vertical_chute", ("-pgran_width", 10,), "gravity", (0.08, 0.09, 0.1), (0.5, 0.25)),
    ("annular shear", "annular_shear",
     ("-pgran_inner_radius", 5, "-pgran_outer_radius", 10, "-pgran_inertia", "true"),
     "inertial_number", (1e-3, 1e-2, 1e-1), (1, 0.5)),
    ("inclined plane", "inclined_plane", ("-pgran_height", 10,), "slope", (22, 24, 26, 28),
     (0.5, 0.25)))
#: Number of eigenvalues in the table.
LEADING = 3
#: Step of the nonlinear runs times the rate, and the steps between which the rate is measured.
SHARE, BETWEEN = 0.02, (10, 50)
#: Largest velocity of the disturbance over the largest velocity of the flow.
AMPLITUDE = 1e-4
#: Shear modulus of the nonlinear runs, large enough that elastic waves do not matter.
RIGID = 1e8
#: Planar shear that admits waves along the flow: side of the square (d), element sizes, I0.
SQUARE, SIZES, NUMBERS = 10, (1, 0.5, 0.25), (1e-3, 1e-2)
#: Targets of the search for unstable modes, gdot0.
TARGETS = "0,1e3,1e4,1e5,1e6"


def eigenvalues(result, *options):
    """Return the eigenvalues of the last snapshot of a result by pgran.eigen, dictionaries."""
    return study.json_of(1, "pgran.eigen", "-pgran_restart", result, "-json", *options)


def shown(rows, count=LEADING):
    """Return the leading eigenvalues as text; of a complex pair the first one."""
    rows = [row for row in rows if row["imaginary"] >= 0.0][:count]
    return ", ".join(f"{row['computed']:.5g}" + (f"+-{row['imaginary']:.3g}i" if row["imaginary"]
                                                 else "") for row in rows)


def measured(result, case, rate, *options):
    """Return the rate, gdot0, of the mode of a real eigenvalue in the nonlinear solver.

    Backward Euler changes a rate to -ln(1 - rate dt)/dt, which is corrected.
    """
    mode = result.with_name(f"{result.stem}_mode.h5")
    if not (mode.exists() and mode.stat().st_mtime > result.stat().st_mtime):
        run_on_ranks.python(1, "-m", "pgran.eigen", "-pgran_restart", result, "-pgran_output", mode,
                            stdout=subprocess.DEVNULL)
    shape, base = (Result(mode).snapshots[0][name] for name in ("velocity", "base_velocity"))
    dt = SHARE / abs(rate)
    first, end = (dt * count for count in BETWEEN)
    run = study.run(
        result.with_name(f"{result.stem}_run.h5"), case, *options, "-ts_type", "beuler",
        "-pgran_inertia", "true", "-pgran_shear_modulus", RIGID, "-pgran_mode_file", mode,
        "-pgran_mode_amplitude", float(AMPLITUDE * np.abs(base).max()), "-pgran_step_first", dt,
        "-pgran_step_max", dt, "-pgran_step_error", 1e6, "-pgran_end_time", end,
        "-pgran_snapshots", first)
    sizes = [((snapshot["velocity"] - base) * shape).sum() for snapshot in run.snapshots]
    expected = -np.log(1.0 - rate * dt) / dt
    return float(np.log(sizes[1] / sizes[0]) / (end - first)) * rate / expected


def decay_rows(directory, *options):
    """Yield the leading eigenvalues of all flows."""
    for title, case, flow, name, values, sizes in FLOWS:
        for value in values:
            previous = None
            for size in sizes:
                varied = (*flow, f"-pgran_{name}", value)
                path = directory / f"{case}_{value:g}_{size:g}.h5"
                if steady(path, case, size, *varied, *options) is None:
                    yield title, f"{name} {value:g}", "no steady flow"
                    continue
                rows = eigenvalues(path)
                rate, found = rows[0]["computed"], None
                if size == sizes[0] and not rows[0]["imaginary"]:
                    found = measured(path, case, rate, *varied, *mesh(case, size), *options)
                yield (title, f"{name} {value:g}", size, shown(rows), rows[0]["residual"],
                       100 * abs(rate / previous - 1) if previous else None, found,
                       100 * (found / rate - 1) if found else None)
                previous = rate


def growth_rows(directory, *options):
    """Yield the unstable waves of planar shear for LI and NGF."""
    for model in ("li", "ngf"):
        for number in NUMBERS:
            for size in SIZES:
                path = directory / f"square_{model}_{number:g}_{size:g}.h5"
                study.run(path, "planar_shear", "-pgran_gravity", 0, "-pgran_grading", 1,
                          "-pgran_law", "jop", "-pgran_model", model, "-pgran_width", SQUARE,
                          "-pgran_height", SQUARE, "-pgran_element_size", size,
                          "-pgran_inertial_number", number, *options)
                rows = eigenvalues(path, "-target", TARGETS)
                yield (model, number, size, sum(row["computed"] > 0.0 for row in rows),
                       shown(rows, 1), rows[0]["residual"])


def flow_spectra(directory="results/flow_spectra", *, options=()):
    """Spectra of steady flows: flow_spectra [directory]

    The leading eigenvalues of planar shear with gravity, the chute, annular shear and the inclined
    plane on two meshes (pgran.eigen, with inertia), and the rate of the first mode in the nonlinear
    solver. The second table contains the unstable waves of planar shear for LI and NGF. Three
    minutes on two cores.
    """
    directory = Path(directory)
    study.write_table(directory / "flow_spectra_decay.csv", {
        "flow": "", "parameter": "", "element (d)": "g", "leading eigenvalues": "",
        "residual": ".0e", "change from previous mesh (%)": ".2f", "nonlinear solver": ".5g",
        "difference (%)": "+.2f"}, decay_rows(directory, *options))
    study.write_table(directory / "flow_spectra_growth.csv", {
        "model": "", "I0": "g", "element (d)": "g", "unstable modes": "d", "fastest": "",
        "residual": ".0e"}, growth_rows(directory, *options))
