"""The figures of section 4, from the results of plane-strain compression.

Each panel shows the inertial number on the deformed shape; one colour scale holds for
a figure. Dashed lines: the band of the linear theory, at 51 degrees and 24.5 d wide,
laid through the middle of the computed one; for LI, whose bands are many, both directions
through the centre. The runs are those of jobs/fig3.sh to
jobs/fig7.sh, and ``RUNS`` names their files.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from . import band as bands
from .result import Result

ANGLE, SPACING = 51.0, 24.5  # degrees and d, as the paper draws them
MESHES = "2", "1", "0.5", "0.25"
#: Figure to files, without ending, and the compression shown.
RUNS = {
    "fig3": [("ngf_L40_I0.001_h0.5", c) for c in (0.05, 0.10, 0.14)],
    "fig4": [(f"ngf_L{L}_I0.001_h0.5", 0.10) for L in (20, 40, 60)],
    "fig5": [(f"ngf_L40_I{I0}_h0.5", 0.10) for I0 in (0.001, 0.007, 0.03)],
    "fig6": [(f"ngf_L40_I0.001_h{h}", 0.10) for h in MESHES],
    "fig7": [(f"li_L40_I0.001_h{h}", 0.01) for h in MESHES]}
LETTERS = {"fig3": "bcd"}


def panels(name, directory):
    """Return the panels of a figure whose runs are there, a list of dictionaries, and the rest.

    Raises ValueError where none is.
    """
    found, missing = [], []
    for letter, (run, compression) in zip(LETTERS.get(name, "abcd"), RUNS[name]):
        path = Path(directory) / f"{run}.h5"
        row = None
        if path.exists():
            rows = bands.measure(path)
            row = next((k for k, r in enumerate(rows)
                        if abs(r.get("compression", -1.0) - compression) < 1e-6), None)
        if row is None:
            missing.append(run)
            continue
        result = Result(path)
        snapshot = result.snapshots[row]
        found.append({"letter": letter, "run": run, "x": snapshot.x,
                      "I": snapshot["inertial_number"], "band": rows[row],
                      "options": result.options, "cost": result.attributes})
    if not found:
        raise ValueError(f"{name}: no results in {directory}; bash jobs/{name}.sh makes them")
    return found, missing


def draw(name, save, directory, label, relative=False, more=lambda shown: []):
    """Draw a figure: ``label`` gives the title of a panel; ``relative`` shows I over I0.

    ``more`` gives further rows of the table for the panels.
    """
    shown, missing = panels(name, directory)
    data, table = {}, [(f"not drawn, as the run is missing: {run}", "", "-") for run in missing]
    fields = [p["I"] / p["options"]["inertial_number"] if relative else p["I"]
              for p in shown]
    largest = max(field.max() for field in fields)
    spans = [np.ptp(p["x"][..., 0]) for p in shown]
    tallest = max(np.ptp(p["x"][..., 1]) for p in shown)
    scale = 6.5 / tallest  # inches to the grain diameter, one for all panels
    figure, axes = plt.subplots(1, len(shown), squeeze=False, sharey=True,
                                figsize=(scale * sum(spans) + 0.4 * len(shown) + 1.6, 7.3),
                                gridspec_kw={"width_ratios": spans}, constrained_layout=True)
    for ax, p, field in zip(axes[0], shown, fields):
        x = p["x"]
        image = ax.pcolormesh(x[..., 0], x[..., 1], field, shading="gouraud", cmap="viridis",
                              vmin=0.0, vmax=largest)
        edge = np.concatenate([x[0], x[:, -1], x[-1, ::-1], x[::-1, 0]])
        ax.plot(*edge.T, "k", linewidth=0.6)
        limits = x[..., 0].min(), x[..., 0].max()
        for point, slope in dashed_lines(p):
            ax.axline(point, slope=slope, color="white", linestyle="dashed", linewidth=0.9)
        ax.set(xlim=limits, ylim=(0.0, tallest), aspect="equal", xlabel="$x_1/d$")
        ax.set_title(f"({p['letter']}) {label(p)}", fontsize=9)
        for key in ("x", "I"):
            data[f"{p['letter']}/{key}"] = p[key]
        table += numbers(p)
    axes[0, 0].set_ylabel("$x_2/d$")
    figure.colorbar(image, ax=axes, label="$I/I^0$" if relative else "$I$", shrink=0.7)
    save(figure, data, table + more(shown))


def one_band(panel):
    """Whether a panel has one band to be measured: LI has many, at both angles."""
    band = panel["band"]
    return panel["options"]["model"] != "li" and band["angle"] is not None


def dashed_lines(panel):
    """Return points and slopes of the lines of the theory: along the band, or for LI across."""
    x, band = panel["x"], panel["band"]
    middle, slope = (x[..., 0].min() + x[..., 0].max()) / 2.0, np.tan(np.radians(ANGLE))
    if panel["options"]["model"] == "li":
        centre = middle, x[..., 1].max() / 2.0
        return [(centre, slope), (centre, -slope)]
    if not one_band(panel):
        return []
    rise = SPACING / 2.0 / np.cos(np.radians(ANGLE))
    return [((band["centre"][0], band["centre"][1] + side), np.copysign(slope, band["angle"]))
            for side in (-rise, rise)]


def numbers(panel):
    """Return the rows (text, stated, found) of a panel's table."""
    band, cost = panel["band"], panel["cost"]
    text = f"({panel['letter']}) {panel['run']} at {100 * band['compression']:g} %"
    rows = [(f"{text}: I from", "-", band["inertial_number_min"]),
            (f"{text}: I to", "-", band["inertial_number_max"]),
            (f"{text}: localised", "-", "yes" if band["localised"] else "no")]
    if band["localised"] and band["reason"] and panel["options"]["model"] != "li":
        rows.append((f"{text}: no band: {band['reason']}", "-", "-"))
    if one_band(panel):
        rows += [(f"{text}: angle (degrees), +- {band['angle_error']:.1f}", "51 or -51",
                  band["angle"]),
                 (f"{text}: width (d), +- {band['width_error']:.1f}", "about 24.5",
                  band["width"]),
                 (f"{text}: bands", "1", band["bands"])]
    if "seconds" in cost:
        rows.append((f"{text}: steps/Newton/linear, s, MB", "-",
                     f"{cost['steps']}/{cost['newton_iterations']}/{cost['linear_iterations']}, "
                     f"{cost['seconds']:.0f}, {cost['memory']:.0f}"))
    return rows


def fig3(save, directory):
    """L = 40 d and I0 = 0.001 at 5, 10 and 14 % compression."""
    draw("fig3", save, directory, lambda p: f"{1 - p['band']['compression']:.2f} H")


def fig4(save, directory):
    """L = 20, 40 and 60 d at 10 % compression."""
    draw("fig4", save, directory, lambda p: f"L = {p['options']['width']:g} d")


def fig5(save, directory):
    """I0 = 0.001, 0.007 and 0.03 at 10 % compression, I over I0."""
    draw("fig5", save, directory,
         lambda p: f"$I^0$ = {p['options']['inertial_number']:g}", relative=True)


def fig6(save, directory):
    """NGF at element sizes 2 d to d/4, 10 % compression, and how they converge."""
    mesh_figure("fig6", save, directory)


def fig7(save, directory):
    """LI at element sizes 2 d to d/4, 1 % compression, and how they do not converge."""
    mesh_figure("fig7", save, directory, crossings)


def crossings(shown):
    """Return rows of a table: how many bands, where I > I0, a line up the specimen crosses."""
    rows = []
    for p in shown:
        column = p["I"][:, p["I"].shape[1] // 4] > p["options"]["inertial_number"]
        rows.append((f"({p['letter']}) {p['run']}: bands across the line at L/4",
                     "more with refinement", bands.stretches(column)))
    return rows


def mesh_figure(name, save, directory, more=lambda shown: []):
    """Draw a figure over meshes, with the differences between successive ones."""
    draw(name, save, directory, lambda p: f"{p['options']['element_size']:g} d",
         more=lambda shown: more(shown) + mesh_rows(shown))


def falls(panel):
    """Whether the one band of a panel falls towards the right."""
    return bool(one_band(panel) and panel["band"]["angle"] < 0.0)


def mesh_rows(shown):
    """Return rows of a table that compare successive meshes.

    See `pgran.output.band.mesh_differences`. A band that falls towards the right is mirrored first,
    because either direction may come out.
    """
    table = []
    for coarse, fine, row in zip(shown, shown[1:], bands.mesh_differences(
            [(p["x"][:, ::-1], p["I"][:, ::-1]) if falls(p) else (p["x"], p["I"])
             for p in shown])):
        sizes = [p["options"]["element_size"] for p in (coarse, fine)]
        text = (f"h{sizes[0]:g} to h{sizes[1]:g}"
                f"{', mirrored' if falls(coarse) != falls(fine) else ''}: difference of I over ")
        table += [(text + "its L2 norm", "-", row["l2"]),
                  (text + "its maximum", "-", row["maximum"])]
        if row["order"] is not None:
            table.append(("observed order in L2", "-", row["order"]))
    return table


FIGURES = {"fig3": fig3, "fig4": fig4, "fig5": fig5, "fig6": fig6, "fig7": fig7}
