"""Steady flows compared with their one-dimensional references."""

from pathlib import Path

import numpy as np

from pgran import cases
from pgran.output.result import Result

from . import study

#: Henann & Kamrin (2016): pressure of the plate over phi rho_s G d, phi, speed of the plate over
#: sqrt(G d), height of the layer and inner radius, d.
PLATE, PHI, SPEED, LAYER, RADIUS = 6.67, 0.62, 1e-3, 20.0, 60.0
#: The option of the length along the flow. A graded mesh needs two elements along it.
ALONG = {"planar_shear": "width", "inclined_plane": "width", "vertical_chute": "height"}
LAWS, MODELS, DYNAMIC = ("bingham", "jop"), ("li", "ngf"), ("ngf_primitive",)
FINE = 0.5, 0.25, 0.125, 0.0625
GAP = "-pgran_inner_radius", 2, "-pgran_outer_radius", 4, "-pgran_grading", 1.5
#: Title, case, options, element sizes (d), models.
FLOWS = (
    ("planar shear", "planar_shear",
     ("-pgran_height", 10, "-pgran_gravity", 0.05, "-pgran_grading", 2), FINE, MODELS),
    ("chute", "vertical_chute", ("-pgran_width", 10, "-pgran_gravity", 0.1, "-pgran_grading", 1.5),
     (0.25, 0.125, 0.0625, 0.03125), MODELS),
    ("chute, yield between elements", "vertical_chute",
     ("-pgran_width", 10, "-pgran_gravity", cases.read({}).mu_s / 4), (0.1, 0.05, 0.025), MODELS),
    ("annular shear", "annular_shear", GAP, (0.25, 0.125), ("li",)),
    ("annular shear", "annular_shear", GAP, (0.25, 0.125, 0.0625), ("ngf",)),
    ("annular shear, all yielding", "annular_shear",
     ("-pgran_inner_radius", 2, "-pgran_outer_radius", 2.25), (0.0625, 0.03125, 0.015625),
     ("ngf",)),
    *((f"inclined plane, {slope} degrees", "inclined_plane",
       ("-pgran_height", height, "-pgran_slope", slope, "-pgran_grading", 2), FINE, models)
      for height, slope, models in ((10, 24, MODELS), (10, 26, DYNAMIC), (4, 23, DYNAMIC))),
    ("planar shear, published", "planar_shear",
     ("-pgran_height", LAYER, "-pgran_gravity", 1.0 / PLATE, "-pgran_phi", PHI, "-pgran_grading", 2,
      "-pgran_inertial_number", SPEED / (LAYER * np.sqrt(PLATE * PHI))),
     (LAYER / 60, LAYER / 120, LAYER / 240), ("ngf",)),
    ("annular shear, published", "annular_shear",
     ("-pgran_inner_radius", RADIUS, "-pgran_outer_radius", RADIUS + 20, "-pgran_phi", PHI,
      "-pgran_inertial_number", SPEED / RADIUS, "-pgran_grading", 3), (2, 1), ("ngf",)))
COLUMNS = {"flow": "", "law": "", "model": "", "element (d)": ".4g", "velocity": ".1e",
           "order": ".1f", "fluidity": ".1e", "order ": ".1f", "Newton": "d"}


def errors(path):
    """Return the maximum errors of velocity and fluidity at the end, over their maxima."""
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
    """Run a steady flow on elements of ``size``, d; return its result, or None if it fails."""
    return study.run(path, case, *mesh(case, size), *options, needed=False)


def rows(directory, *options):
    """Yield the errors and the orders of convergence of all flows."""
    for title, case, flow, sizes, models in FLOWS:
        for law, model in ((law, model) for law in LAWS for model in models):
            previous = None
            for size in sizes:
                path = study.result_file(directory, f"{title} {law} {model} {size:.4g}")
                result = steady(path, case, size, *flow, "-pgran_law", law, "-pgran_model", model,
                                *options)
                if result is None:
                    yield title, law, model, f"{size:.4g}"
                    continue
                found, orders = errors(path), (None, None)
                if previous:
                    orders = [float(np.log2(a / b)) for a, b in zip(previous, found)]
                previous = found
                yield (title, law, model, size, found[0], orders[0], found[1], orders[1],
                       result.attributes["newton_iterations"])


def flows(directory="results/flows", *, options=()):
    """Steady flows and their one-dimensional references: flows [directory]

    Planar shear with gravity, chute, annular shear and inclined plane for LI and NGF with both
    laws, dynamic NGF on the inclined plane, and the parameters of Henann & Kamrin (2016). The table
    contains the maximum errors of velocity and fluidity at the nodes over their maxima, and the
    orders of convergence. A figure shows each flow and its profile. Ten minutes on two cores.
    """
    directory = Path(directory)
    study.write_table(directory / "flows.csv", COLUMNS, rows(directory, *options))
    for case in sorted({case for _, case, *_ in FLOWS}):
        draw(study.run(directory / f"{case}.h5", case, *options))


def draw(result):
    """Draw speed and inertial number of a result, and its profile with the reference."""
    case, last = result.case, result.snapshots[-1]
    # In a periodic direction the last nodes neighbour the first ones.
    wraps = [(0, int(wrap)) for wrap in reversed(result.closed)]
    x, v = (np.moveaxis(part, 2, 0) for part in (last.x, last["velocity"]))
    g, I = last["fluidity"], last["inertial_number"]
    position, along, _ = case.along(x)
    speed, profile = (v * along).sum(axis=0), case.profile()
    line = np.linspace(position.min(), position.max(), 400)
    order, label = np.argsort(position.ravel())[::7], "speed / $d\\,\\dot\\gamma_0$"
    with study.figure(f"flow_{result.options['case']}", 1, 4, figsize=(12.0, 3.4)) as (fig, axes):
        for panel, field, name in zip(axes, (speed, I), (label, "I")):
            image = panel.pcolormesh(*(np.pad(part, wraps, mode="wrap") for part in (*x, field)),
                                     shading="gouraud", cmap="viridis")
            fig.colorbar(image, ax=panel, label=name)
            panel.set(xlabel="$x_1/d$", ylabel="$x_2/d$", aspect="equal")
        for panel, field, exact, name in zip(axes[2:], (speed, g), (profile.velocity(line),
                                             profile.fluidity(line)),
                                             (label, "$g/\\dot\\gamma_0$")):
            panel.plot(line, exact, "k", lw=1, label="one-dimensional problem")
            panel.plot(position.ravel()[order], field.ravel()[order], ".", ms=3, color="tab:red",
                       label="finite elements")
            panel.set(xlabel="position across the flow / d", ylabel=name)
        axes[3].set_yscale("log")
        axes[2].legend(fontsize=7)
