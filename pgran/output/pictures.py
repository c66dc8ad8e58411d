"""Pictures of results by matplotlib: fields on the deformed shape, profiles, curves and movies."""

import os
import shutil
import textwrap
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import LinearTriInterpolator, Triangulation

from ..options import OptionError, not_among
from .connectivity import cells
from .reader import ResultError
from .result import QUANTITIES, Result

matplotlib.rcParams["svg.fonttype"] = "none"  # SVG files contain text, not outlines

COLOURS = "viridis"
#: Units in the notation of matplotlib.
NOTATION = {"|sigma_1|": r"$|\sigma_1|$", "gdot0": r"$\dot\gamma_0$", "P_w": "$P_w$",
            "phi rho_s G d": r"$\phi\rho_s G d$", "^2": "$^2$"}
#: Longer side of a panel, inches, and pixels per inch.
SIDE, DPI = 5.5, 150
#: Horizontal axis of the history of a steady flow.
STEP = "step in pseudo-time"


@dataclass(frozen=True)
class Style:
    """How fields are drawn."""

    limits: tuple = None  # ends of the colour scale; by default the range of the drawn values
    log: bool = False  # logarithmic colour scale
    mesh: bool = False  # elements
    arrows: bool = False  # velocity
    band: bool = False  # shear bands with their angles and widths
    outline: bool = True  # initial outline of the material


def label(result, name):
    """Return the label of a quantity or a field, with its unit."""
    symbol = f"${QUANTITIES[name].symbol}$" if name in QUANTITIES else name
    return with_unit(symbol, result.unit(name))


def with_unit(text, unit):
    """Return a label with its unit in the notation of matplotlib."""
    for part, notation in NOTATION.items():
        unit = unit.replace(part, notation)
    return f"{text} ({unit})" if unit else text


def new_figure(width, height, rows=1, columns=1, **options):
    """Return a figure of a size in inches, and its axes, a list."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=DPI)
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(rows, columns, squeeze=False, **options).flat)


def scale(values, style):
    """Return the norm of the colour scale of arrays; `OptionError` if a log scale needs > 0."""
    low, high = style.limits or (min(v.min() for v in values), max(v.max() for v in values))
    if not style.log:
        return Normalize(low, high if high > low else low + max(abs(low), 1.0) * 1e-12)
    if style.limits is None:
        low = min((v[v > 0.0].min() for v in values if (v > 0.0).any()), default=0.0)
    if not 0.0 < low < high:
        raise OptionError(f"-log: the colour scale must be > 0, not {low:.3g} to {high:.3g}; set "
                          "-limits")
    return LogNorm(low, high)


def draw(axes, snapshot, name, norm, style):
    """Draw a quantity of a snapshot; return the artist for `Figure.colorbar`."""
    extended = snapshot.whole
    x, values = extended.x, extended[name]
    if style.log:
        values = np.maximum(values, norm.vmin)
    drawn = axes.pcolormesh(x[..., 0], x[..., 1], values, shading="gouraud", cmap=COLOURS,
                            norm=norm, rasterized=True)
    if style.mesh:
        lines = [*x[::2], *np.moveaxis(x, 1, 0)[::2]]
        axes.add_collection(LineCollection(lines, colors="0.5", linewidths=0.3))
    if style.outline and snapshot.result.case.moving:
        start = snapshot.initial_coordinates
        edge = np.concatenate([start[0], start[:, -1], start[-1, ::-1], start[::-1, 0]])
        axes.plot(*edge.T, color="0.4", linewidth=0.8, linestyle="--")
    if style.arrows:
        step = max(1, max(x.shape[:2]) // 24)  # 24 arrows along the longer side
        (x1, x2), (v1, v2) = (np.moveaxis(field[::step, ::step, :2], -1, 0)
                              for field in (x, extended.stored("velocity")))
        axes.quiver(x1, x2, v1, v2, color="white", edgecolor="black", linewidth=0.3, width=0.004)
    if style.band:
        band_line(axes, snapshot)
    across, up = snapshot.kinematics.axes
    axes.set(aspect="equal", xlabel=f"${across}$ (d)", ylabel=f"${up}$ (d)")
    axes.set_title(snapshot.label, fontsize=10)
    return drawn


def band_line(axes, snapshot):
    """Draw the middle and the edges of each shear band with its angle and width, or the reason."""
    found, lines = snapshot.band(), []
    for each in found["each_band"]:
        angle = np.radians(each["angle"])
        along, normal = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        middle = each["centre"] + np.outer([-0.5, 0.5], each["length"] * along)
        for share, width, style in ((0.0, 1.2, "-"), (-0.5, 0.8, "--"), (0.5, 0.8, "--")):
            axes.plot(*(middle + share * each["width"] * normal).T, color="white",
                      linewidth=width, linestyle=style)
        lines.append(f"{each['angle']:.1f}° $\\pm$ {each['angle_error']:.1f}°, "
                     f"{each['width']:.1f} $\\pm$ {each['width_error']:.1f} d")
    if not lines:
        lines = textwrap.wrap(f"no band: {found['reason']}", 28)
    axes.text(0.5, 0.02, "\n".join(lines), transform=axes.transAxes, ha="center", fontsize=8,
              bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0})


def panels(snapshots, name, style):
    """Return a figure of a quantity in snapshots, from left to right, on one colour scale."""
    norm = scale([snapshot.whole[name] for snapshot in snapshots], style)
    spans = np.array([np.ptp(snapshot.whole.x.reshape(-1, 2), axis=0) for snapshot in snapshots])
    unit = SIDE / spans.max()
    wide = np.maximum(spans[:, 0] * unit, 1.2)
    figure, axes = new_figure(wide.sum() + 0.9 * len(wide) + 1.3, spans[:, 1].max() * unit + 1.1,
                              columns=len(wide), width_ratios=wide)
    several = len({snapshot.result.path for snapshot in snapshots}) > 1
    for ax, snapshot in zip(axes, snapshots):
        drawn = draw(ax, snapshot, name, norm, style)
        if several:
            ax.set_title(f"{snapshot.result.path.stem}\n{snapshot.label}", fontsize=9)
    figure.colorbar(drawn, ax=axes, label=label(snapshots[0].result, name), shrink=0.8)
    return figure


def with_limits(style, result, name):
    """Return a style whose colour scale holds for all snapshots of a result."""
    norm = scale([snapshot.whole[name] for snapshot in result.snapshots], style)
    return replace(style, limits=(norm.vmin, norm.vmax))


def pictures(path, name="inertial_number", style=Style(), suffix=".png", which=None):
    """Draw each snapshot of a result, or only number ``which``, on one colour scale.

    Returns the paths NAME_0000.png, ... or, of another quantity than I, NAME_quantity_0000.png, ...
    """
    result, written = Result(path), []
    chosen, style = snapshots_of(result, which), with_limits(style, result, name)
    stem = result.path.stem if name == "inertial_number" else f"{result.path.stem}_{name}"
    for snapshot in chosen:
        written.append(result.path.with_name(f"{stem}_{snapshot.name}{suffix}"))
        panels([snapshot], name, style).savefig(written[-1])
    return written


def snapshots_of(result, which):
    """Return the snapshots of a result, or only number ``which``, a list."""
    count = len(result.snapshots)
    if not count:
        raise ResultError(result.path, "it holds 0 snapshots")
    if which is None:
        return result.snapshots
    if not -count <= which < count:
        raise OptionError(f"-snapshot {which}: {result.path} holds {count} snapshots")
    return [result.snapshots[which]]


def field(path, snapshot, name, title):
    """Draw a field of the snapshot named ``snapshot`` to NAME.png; return the path."""
    result = Result(path)
    chosen = next(found for found in result.snapshots if found.name == snapshot)
    figure = panels([chosen], name, Style(outline=False))
    figure.axes[0].set_title(title, fontsize=10)
    target = result.path.with_suffix(".png")
    figure.savefig(target)
    return target


def along_line(snapshot, name, ends, points=400):
    """Return distances (points,) along a line, d, and a quantity there, NaN outside the material.

    ``ends`` = x1, x2 of the first point and x1, x2 of the last one, d.
    """
    first, last = np.reshape(ends, (2, 2))
    extended = snapshot.whole
    quads = cells(extended.x.shape[:2])
    mesh = Triangulation(*extended.x.reshape(-1, 2).T,
                         np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    interpolate = LinearTriInterpolator(mesh, extended[name].ravel())
    values = interpolate(*np.linspace(first, last, points).T)
    return np.linspace(0.0, np.hypot(*(last - first)), points), values.filled(np.nan)


def check_field(result, name):
    """Raise `OptionError` unless the last snapshot of a result has a scalar field ``name``."""
    if name in QUANTITIES or not result.snapshots:
        return
    last = result.snapshots[-1]
    scalars = {*QUANTITIES, *(field for field in last.names if last.stored(field).ndim == 2)}
    if name in scalars:
        return
    if name in (*last.names, "coordinates"):
        raise OptionError(f"-field {name}: not a scalar field; expected one of: "
                          + ", ".join(sorted(scalars)))
    raise OptionError(f"-field {name}: {result.path} has no field {name}; "
                      + not_among(name, sorted(scalars)))


def profiles(results, name, ends, which=-1):
    """Return a figure of a quantity along a line, one curve per result; see `along_line`."""
    figure, (axes,) = curves_figure("distance along the line (d)", [label(results[0], name)])
    for result in results:
        for snapshot in snapshots_of(result, which):
            distance, values = along_line(snapshot, name, ends)
            if np.isnan(values).all():
                raise OptionError("-line {:g},{:g},{:g},{:g}: ".format(*ends) + "does not cross "
                                  f"the material of {result.path} ({snapshot.label})")
            axes.plot(distance, values, label=f"{result.path.stem}, {snapshot.label}")
    axes.set_title("({:g}, {:g}) to ({:g}, {:g}) d".format(*ends), fontsize=10)
    axes.legend(fontsize=8)
    return figure


def curves(results, names):
    """Return a figure of columns of the history over the progress, one panel per column."""
    for result in results:
        for column in names:
            if column not in result.history:
                raise OptionError(f"-history {column}: {result.path} has no column {column}; "
                                  + not_among(column, sorted(result.history)))
        if not len(result.history[names[0]]):
            raise ResultError(result.path, "it has no step yet")
    progress, units = [result.progress() for result in results], results[0].history_units
    across, *others = dict(progress)
    if others:
        raise OptionError(f"-history {','.join(names)}: the histories have different horizontal "
                          f"axes: {', '.join([across, *others])}")
    figure, planes = curves_figure(
        STEP if across == "step" else with_unit(across, units[across]),
        [with_unit(name, units[name]) for name in names])
    for axes, name in zip(planes, names):
        for result, (_, values) in zip(results, progress):
            axes.plot(values, result.history[name], label=result.path.stem)
    planes[0].legend(fontsize=8)
    return figure


def curves_figure(across, up):
    """Return a figure with one panel per vertical label in ``up``, and its axes, a list."""
    figure, planes = new_figure(6.4, 1.4 + 2.8 * len(up), rows=len(up), sharex=True)
    for axes, text in zip(planes, up):
        axes.set_ylabel(text)
        axes.grid(alpha=0.3)
    planes[-1].set_xlabel(across)
    if across == STEP:
        planes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure, planes


def movie(result, name, style, target, rate=8):
    """Draw all snapshots as a movie, GIF or (with ffmpeg) MP4, ``rate`` per second."""
    from matplotlib import animation

    target = Path(target)
    if target.suffix not in (".gif", ".mp4"):
        raise OptionError(f"-movie {target}: must be a file name that ends in .gif or .mp4")
    if target.suffix == ".mp4" and not shutil.which("ffmpeg"):
        raise OptionError(f"-movie {target}: MP4 needs ffmpeg, which is not installed; use "
                          f"{target.with_suffix('.gif')}")
    if len(result.snapshots) < 2:
        raise OptionError(f"-movie {target}: {result.path} holds fewer than 2 snapshots")
    style = with_limits(style, result, name)
    norm = scale([], style)
    tallest = max(result.snapshots, key=lambda snapshot: np.ptp(snapshot.whole.x[..., 1]))
    figure = panels([tallest], name, style)
    axes = figure.axes[0]
    nodes = np.concatenate([snapshot.whole.x.reshape(-1, 2) for snapshot in result.snapshots])

    writer = (animation.PillowWriter if target.suffix == ".gif" else animation.FFMpegWriter)(rate)
    with writer.saving(figure, target, 100):
        for snapshot in result.snapshots:
            axes.clear()
            draw(axes, snapshot, name, norm, style)
            axes.set(xlim=(nodes[:, 0].min(), nodes[:, 0].max()),
                     ylim=(nodes[:, 1].min(), nodes[:, 1].max()))
            writer.grab_frame()


def window(snapshot, name):
    """Show a snapshot in a window of pyvista."""
    import pyvista

    if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
        raise OptionError("-show: no display; omit -show to write pictures")
    plotter = pyvista.Plotter(title=str(snapshot.result.path))
    plotter.add_mesh(snapshot.grid(name).tessellate(), scalars=name, cmap=COLOURS)
    plotter.view_xy()
    plotter.show()
