"""Steady flows compared with one-dimensional references: flows [directory]

Planar shear with gravity, the chute, the annulus and the inclined plane for LI and NGF with both
laws, the inclined plane for dynamic NGF, on graded meshes, and the inputs that Henann & Kamrin
(2016) published. The table has the largest errors of velocity and fluidity at the nodes over their
maxima, and the orders of convergence. flow_CASE.png compares each flow with its profile. About ten
minutes on two cores.
"""

from itertools import product
from pathlib import Path

import numpy as np

from pgran import cases
from pgran.output.result import Result
from pgran.runs.table import result_file

from .study import FAILED, Report, figure, run

#: Henann & Kamrin: the pressure of the plate over phi rho_s G d, phi, the plate's speed over
#: sqrt(G d), the height of the layer and the inner radius of the annulus, d.
PLATE, PHI, SPEED, LAYER, RING = 6.67, 0.62, 1e-3, 20.0, 60.0
#: Length along the flow, which has two elements.
ALONG = {"planar_shear": "width", "inclined_plane": "width", "vertical_chute": "height"}
LAWS, MODELS = ("bingham", "jop"), ("li", "ngf")
GAP = "-pgran_inner_radius", 2, "-pgran_outer_radius", 4, "-pgran_grading", 1.5
#: Title, case, options, element sizes (d), models.
FLOWS = (
    ("planar shear", "planar_shear",
     ("-pgran_height", 10, "-pgran_gravity", 0.05, "-pgran_grading", 2),
     (0.5, 0.25, 0.125, 0.0625), MODELS),
    ("chute", "vertical_chute", ("-pgran_width", 10, "-pgran_gravity", 0.1, "-pgran_grading", 1.5),
     (0.25, 0.125, 0.0625, 0.03125), MODELS),
    ("chute, yield between elements", "vertical_chute",
     ("-pgran_width", 10, "-pgran_gravity", cases.read({}).mu_s / 4), (0.1, 0.05, 0.025), MODELS),
    ("annulus", "annular_shear", GAP, (0.25, 0.125), ("li",)),
    ("annulus", "annular_shear", GAP, (0.25, 0.125, 0.0625), ("ngf",)),
    ("annulus, all yielding", "annular_shear",
     ("-pgran_inner_radius", 2, "-pgran_outer_radius", 2.25), (0.0625, 0.03125, 0.015625),
     ("ngf",)),
    ("inclined plane", "inclined_plane",
     ("-pgran_height", 10, "-pgran_slope", 24, "-pgran_grading", 2),
     (0.5, 0.25, 0.125, 0.0625), MODELS),
    ("inclined plane, 26 degrees", "inclined_plane",
     ("-pgran_height", 10, "-pgran_slope", 26, "-pgran_grading", 2),
     (0.5, 0.25, 0.125, 0.0625), ("ngf_primitive",)),
    ("inclined plane, 23 degrees", "inclined_plane",
     ("-pgran_height", 4, "-pgran_slope", 23, "-pgran_grading", 2),
     (0.5, 0.25, 0.125, 0.0625), ("ngf_primitive",)),
    ("planar shear, published", "planar_shear",
     ("-pgran_height", LAYER, "-pgran_gravity", 1.0 / PLATE, "-pgran_phi", PHI, "-pgran_grading", 2,
      "-pgran_inertial_number", SPEED / (LAYER * np.sqrt(PLATE * PHI))),
     (LAYER / 60, LAYER / 120, LAYER / 240), ("ngf",)),
    ("annulus, published", "annular_shear",
     ("-pgran_inner_radius", RING, "-pgran_outer_radius", RING + 20, "-pgran_phi", PHI,
      "-pgran_inertial_number", SPEED / RING, "-pgran_grading", 3), (2, 1), ("ngf",)))
COLUMNS = {"flow": "", "law": "", "model": "", "element (d)": ".4g", "velocity": ".1e",
           "order ": ".1f", "fluidity": ".1e", "order": ".1f", "Newton": "d", "s": ".1f"}


def errors(path):
    """Return the largest errors of the last snapshot's velocity and fluidity over their maxima.

    The reference is the profile of the case. Raises ValueError where it has none.
    """
    case, last = Result(path).case, Result(path).snapshots[-1]
    x, v = (np.moveaxis(part, 2, 0) for part in (last.x, last["velocity"]))
    velocity, fluidity, _, _ = case.steady(case.profile(), x)
    return tuple(float(np.abs(found - exact).max() / np.abs(exact).max())
                 for found, exact in ((v, velocity), (last["fluidity"], fluidity)))


def mesh(case, size):
    """Return the options of a mesh of elements of ``size``, d, two of them along the flow."""
    along = ALONG.get(case)
    return ("-pgran_element_size", size, *((f"-pgran_{along}", 2 * size) if along else ()))


def steady(path, case, size, *options):
    """Find a steady flow on elements of ``size``, d; return its result, or None."""
    return run(path, case, *mesh(case, size), *options, needed=False)


def main(directory="results/flows", *, options=()):
    """Make the runs, the table and the pictures."""
    directory = Path(directory)
    table = Report(directory / "flows.csv", COLUMNS)
    for title, case, flow, sizes, models in FLOWS:
        for law, model in product(LAWS, models):
            previous = None
            for size in sizes:
                path = result_file(directory, f"{title} {law} {model} {size:.4g}".replace(",", ""))
                took = steady(path, case, size, *flow, "-pgran_law", law, "-pgran_model", model,
                              *options)
                if took is None:
                    table.note(title, law, model, f"{size:.4g} {FAILED}")
                    continue
                found = errors(path)
                orders = [float(np.log2(a / b)) for a, b in zip(previous, found)] if previous \
                    else [None, None]
                previous = found
                table.row(title, law, model, size, found[0], orders[0], found[1], orders[1],
                          *(took.attributes[name] for name in ("newton_iterations", "seconds")))
    table.close()
    for case in sorted({case for _, case, *_ in FLOWS}):
        path = directory / f"{case}.h5"
        run(path, case, *options)
        draw(path, directory / f"flow_{case}.png")


def draw(path, target):
    """Draw speed and inertial number of a result, and its profile and reference."""
    result = Result(path)
    case, last = result.case, result.snapshots[-1]
    # The last nodes of a closed grid neighbour the first ones.
    wraps = [(0, int(wrap)) for wrap in reversed(result.closed)]
    x, v = (np.moveaxis(part, 2, 0) for part in (last.x, last["velocity"]))
    g, I = last["fluidity"], last["inertial_number"]
    place, along, _ = case.along(x)
    speed, profile = (v * along).sum(axis=0), case.profile()
    line, order = np.linspace(place.min(), place.max(), 400), np.argsort(place.ravel())
    with figure(target, 1, 4, figsize=(12.0, 3.4)) as (canvas, axes):
        for panel, field, label in zip(axes, (speed, I), ("speed / $d\\,\\dot\\gamma_0$", "I")):
            image = panel.pcolormesh(*(np.pad(part, wraps, mode="wrap") for part in (*x, field)),
                                     shading="gouraud", cmap="viridis")
            canvas.colorbar(image, ax=panel, label=label)
            panel.set(xlabel="$x_1/d$", ylabel="$x_2/d$", aspect="equal")
        for panel, field, exact, label in (
                (axes[2], speed, profile.velocity(line), "speed / $d\\,\\dot\\gamma_0$"),
                (axes[3], g, profile.fluidity(line), "$g/\\dot\\gamma_0$")):
            panel.plot(line, exact, "k", lw=1, label="one-dimensional problem")
            panel.plot(place.ravel()[order][::7], field.ravel()[order][::7], ".", ms=3,
                       color="tab:red", label="finite elements")
            panel.set(xlabel="position across the flow / d", ylabel=label)
        axes[3].set_yscale("log")
        axes[2].legend(fontsize=7)
