"""Pictures of results as a paper prints them, by matplotlib: fields, profiles, curves, movies.

Fields are drawn on the deformed shape, smoothly between the Q2 nodes. The suffix of a path chooses
PNG, SVG or PDF. What writes files returns their paths.
"""

import os
import re
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
from .reader import ResultError
from .result import QUANTITIES, Result, cells

matplotlib.rcParams["svg.fonttype"] = "none"  # text of an SVG stays text

#: Formats of pictures and of movies.
FORMATS, MOVIES = ("png", "svg", "pdf"), (".gif", ".mp4")
COLOURS = "viridis"
#: Parts of units in the notation of matplotlib.
NOTATION = {"|sigma_1|": r"$|\sigma_1|$", "gdot0": r"$\dot\gamma_0$", "P_w": "$P_w$",
            "phi rho_s G d": r"$\phi\rho_s G d$", "^2": "$^2$"}
#: Inches of the longer side of a panel, and pixels an inch.
SIDE, DPI = 5.5, 150
#: Label of the steps of a steady flow.
STEP = "step in pseudo-time"
#: Characters in a line of the reason why there is no band.
WORDS = 28
#: Arrows along the longer side of a panel.
ARROWS = 24


@dataclass(frozen=True)
class Style:
    """How fields are drawn.

    Attributes
    ----------
    limits : tuple of float, optional
        Ends of the colour scale; the range of all that is drawn unless given.
    log : bool
        Whether the scale is logarithmic.
    mesh, arrows, band : bool
        Whether to draw the elements, the velocity, and the shear band with its angle and width.
    outline : bool
        Whether to draw where the material was at the start.
    """

    limits: tuple = None
    log: bool = False
    mesh: bool = False
    arrows: bool = False
    band: bool = False
    outline: bool = True


def label(result, name):
    """Return how a quantity or a field is labelled, with its unit."""
    symbol = f"${QUANTITIES[name].symbol}$" if name in QUANTITIES else name
    return with_unit(symbol, result.unit(name))


def with_unit(text, unit):
    """Return a label with its unit in the notation of matplotlib, (str)."""
    for part, notation in NOTATION.items():
        unit = unit.replace(part, notation)
    return f"{text} ({unit})" if unit else text


def scale(values, style):
    """Return the norm of the colours of arrays; raises `OptionError` where it cannot be."""
    low, high = style.limits or (min(v.min() for v in values), max(v.max() for v in values))
    if style.log:
        if style.limits is None:
            low = min((v[v > 0.0].min() for v in values if (v > 0.0).any()), default=0.0)
        if not 0.0 < low < high:
            raise OptionError(f"-log: the scale from {low:.3g} to {high:.3g} has no logarithm; "
                              "give -limits")
        return LogNorm(low, high)
    return Normalize(low, high if high > low else low + max(abs(low), 1.0) * 1e-12)


def draw(axes, snapshot, name, norm, style, values=None):
    """Draw a quantity of a snapshot into axes; return what `Figure.colorbar` takes.

    ``values`` are those of the quantity on the nodes of ``snapshot.whole``, if they are known.
    """
    result, whole = snapshot.result, snapshot.whole
    x, shown = whole.x, whole[name] if values is None else values
    if style.log:
        shown = np.maximum(shown, norm.vmin)
    drawn = axes.pcolormesh(x[..., 0], x[..., 1], shown, shading="gouraud", cmap=COLOURS,
                            norm=norm, rasterized=True)
    if style.mesh:
        lines = [*x[::2], *np.moveaxis(x, 1, 0)[::2]]
        axes.add_collection(LineCollection(lines, colors="0.5", linewidths=0.3))
    if style.outline and result.case.moving:
        outline(axes, result, snapshot)
    if style.arrows:
        step = max(1, max(x.shape[:2]) // ARROWS)
        (x1, x2), (v1, v2) = (np.moveaxis(field[::step, ::step], -1, 0)
                              for field in (x, whole.stored("velocity")))
        axes.quiver(x1, x2, v1, v2, color="white", edgecolor="black", linewidth=0.3, width=0.004)
    if style.band:
        band_line(axes, snapshot)
    axes.set_aspect("equal")
    axes.set_xlabel("$x_1$ (d)")
    axes.set_ylabel("$x_2$ (d)")
    axes.set_title(snapshot.label, fontsize=10)
    return drawn


def outline(axes, result, snapshot):
    """Draw where the sides of the material were at the start."""
    ny, nx = snapshot.whole.x.shape[:2]
    around = np.concatenate([
        [(i, 0) for i in range(nx)], [(nx - 1, j) for j in range(ny)],
        [(i, ny - 1) for i in reversed(range(nx))], [(0, j) for j in reversed(range(ny))]]).T
    axes.plot(*result.case.coordinates(*around), color="0.4", linewidth=0.8, linestyle="--")


def band_line(axes, snapshot):
    """Draw the middle and the two edges of each shear band, with its angle and width.

    Without a band the reason is written instead.
    """
    found, lines = snapshot.band(), []
    for each in found["each_band"]:
        angle = np.radians(each["angle"])
        along, normal = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        middle = each["centre"] + np.outer([-0.5, 0.5], each["length"] * along)
        axes.plot(*middle.T, color="white", linewidth=1.2)
        for edge in (-0.5, 0.5):
            axes.plot(*(middle + edge * each["width"] * normal).T, color="white", linewidth=0.8,
                      linestyle="--")
        lines.append(f"{each['angle']:.1f}° $\\pm$ {each['angle_error']:.1f}°, "
                     f"{each['width']:.1f} $\\pm$ {each['width_error']:.1f} d")
    if not lines:
        lines = textwrap.wrap(f"no band: {found['reason']}", WORDS)
    axes.text(0.5, 0.02, "\n".join(lines), transform=axes.transAxes, ha="center", fontsize=8,
              bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0})


def panels(chosen, name, style):
    """Return a figure of snapshots side by side on one scale.

    Parameters
    ----------
    chosen : list of pgran.output.result.Snapshot
    name : str
        The quantity.
    style : Style
    """
    fields = [snapshot.whole[name] for snapshot in chosen]
    norm = scale(fields, style)
    spans = [np.ptp(snapshot.whole.x.reshape(-1, 2), axis=0) for snapshot in chosen]
    unit = SIDE / max(max(span) for span in spans)
    wide = [max(span[0] * unit, 1.2) for span in spans]
    figure = Figure(figsize=(sum(wide) + 0.9 * len(wide) + 1.3,
                             max(span[1] for span in spans) * unit + 1.1),
                    layout="constrained", dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(chosen), squeeze=False, width_ratios=wide)[0]
    for ax, snapshot, values in zip(axes, chosen, fields):
        drawn = draw(ax, snapshot, name, norm, style, values)
    if len({snapshot.result.path for snapshot in chosen}) > 1:
        for ax, snapshot in zip(axes, chosen):
            ax.set_title(f"{snapshot.result.path.stem}\n{snapshot.label}", fontsize=9)
    figure.colorbar(drawn, ax=list(axes), label=label(chosen[0].result, name), shrink=0.8)
    return figure


def pictures(path, name="inertial_number", style=Style(), suffix=".png", which=None):
    """Draw each snapshot of a result beside it, NAME_0000.png and so on, on one colour scale.

    Parameters
    ----------
    path : str or Path
    name : str
        The quantity; if it is not I, the pictures are NAME_quantity_0000.png.
    style : Style
    suffix : str
    which : int, optional
        Only this snapshot; negative numbers count from the end.

    Raises
    ------
    ResultError, OptionError
        Where there is nothing to draw.
    """
    result, written = Result(path), []
    chosen = snapshots_of(result, which)
    norm = scale([snapshot.whole[name] for snapshot in result.snapshots], style)
    style = replace(style, limits=(norm.vmin, norm.vmax))
    more = "" if name == "inertial_number" else f"_{name}"
    for snapshot in chosen:
        target = result.path.with_name(f"{result.path.stem}{more}_{snapshot.name}{suffix}")
        panels([snapshot], name, style).savefig(target)
        written.append(target)
    return written


def snapshots_of(result, which):
    """Return the snapshots that are asked for, a list; ``which`` None means all of them."""
    count = len(result.snapshots)
    if not count:
        raise ResultError(result.path, "it holds 0 snapshots")
    if which is None:
        return result.snapshots
    if not -count <= which < count:
        raise OptionError(f"-snapshot {which}: {result.path} holds {count} snapshots")
    return [result.snapshots[which]]


def field(path, snapshot, name, title):
    """Draw a field of a snapshot beside the file, NAME.png; return the path."""
    result = Result(path)
    chosen = next(found for found in result.snapshots if found.name == snapshot)
    figure = panels([chosen], name, Style(outline=False))
    figure.axes[0].set_title(title, fontsize=10)
    target = result.path.with_suffix(".png")
    figure.savefig(target)
    return target


def along_line(snapshot, name, ends, points=400):
    """Return distances (points,) along a line and a quantity there, not a number outside.

    ``ends`` = x1, x2 of the first point and x1, x2 of the last one, d.
    """
    first, last = np.reshape(ends, (2, 2))
    share = np.linspace(0.0, 1.0, points)
    at = first + share[:, None] * (last - first)
    whole = snapshot.whole
    quads = cells(whole.x.shape[:2])
    mesh = Triangulation(*whole.x.reshape(-1, 2).T,
                         np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    found = LinearTriInterpolator(mesh, whole[name].ravel())(*at.T)
    return share * np.hypot(*(last - first)), found.filled(np.nan)


def check_field(result, name):
    """Raise `OptionError` unless the last snapshot of a result has a scalar field ``name``."""
    if name in QUANTITIES or not result.snapshots:
        return
    last = result.snapshots[-1]
    scalars = [*QUANTITIES, *(field for field in last.names
                              if field not in QUANTITIES and last.stored(field).ndim == 2)]
    if name in scalars:
        return
    if name in (*last.names, "coordinates"):
        parts = [quantity for quantity in QUANTITIES
                 if re.fullmatch(rf"{name.removesuffix('_tensor')}(_\d+)?", quantity)]
        if name == "velocity":
            parts.insert(0, "speed")
        raise OptionError(f"-field {name}: it has several components at a point; allowed are "
                          + ", ".join(parts or scalars))
    raise OptionError(f"-field {name}: {result.path} has no field {name}; "
                      + not_among(name, scalars))


def profiles(results, name, ends, target, which=-1):
    """Draw a quantity along a line, one curve for each result.

    Raises `OptionError` where the line does not meet the body.
    """
    figure, (axes,) = curves_figure("distance along the line (d)", [label(results[0], name)])
    for result in results:
        for snapshot in snapshots_of(result, which):
            distance, values = along_line(snapshot, name, ends)
            if np.isnan(values).all():
                (x1, x2), (y1, y2) = np.transpose([snapshot.x.min((0, 1)), snapshot.x.max((0, 1))])
                raise OptionError(
                    "-line {:g},{:g},{:g},{:g}: ".format(*ends)
                    + f"the line does not meet the body of {result.path} ({snapshot.label}), which "
                    f"lies within x1 = {x1:.4g} to {x2:.4g} d and x2 = {y1:.4g} to {y2:.4g} d")
            axes.plot(distance, values, label=f"{result.path.stem}, {snapshot.label}")
    axes.set_title("({:g}, {:g}) to ({:g}, {:g}) d".format(*ends), fontsize=10)
    axes.legend(fontsize=8)
    figure.savefig(target)
    return [Path(target)]


def curves(results, names, target):
    """Draw columns of the history against how far the run was: a panel for each, a curve a file."""
    for result in results:
        for column in names:
            if column not in result.history:
                raise OptionError(f"-history {column}: {result.path} has no such column; "
                                  + not_among(column, sorted(result.history)))
        if not len(result.history[names[0]]):
            raise ResultError(result.path, "it has no step yet")
    progress = [result.progress() for result in results]
    counted = progress[0][0]
    for result, (other, _) in zip(results, progress):
        if other != counted:
            raise OptionError(f"-history {','.join(names)}: the history of {results[0].path} is "
                              f"drawn against {counted}, and that of {result.path} against {other}")
    units = results[0].history_units
    across = STEP if counted == "step" else with_unit(counted, units[counted])
    figure, planes = curves_figure(across, [with_unit(name, units[name]) for name in names])
    for axes, name in zip(planes, names):
        for result, (_, values) in zip(results, progress):
            axes.plot(values, result.history[name], label=result.path.stem)
    planes[0].legend(fontsize=8)
    figure.savefig(target)
    return [Path(target)]


def curves_figure(across, up):
    """Return a figure with a plane of curves for each label ``up``, and its axes, a list."""
    figure = Figure(figsize=(6.4, 1.4 + 2.8 * len(up)), layout="constrained", dpi=DPI)
    FigureCanvasAgg(figure)
    planes = figure.subplots(len(up), sharex=True, squeeze=False)[:, 0]
    for axes, text in zip(planes, up):
        axes.set_ylabel(text)
        axes.grid(alpha=0.3)
    planes[-1].set_xlabel(across)
    if across == STEP:
        planes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure, list(planes)


def movie(result, name, style, target, rate=8):
    """Draw all snapshots as a movie, GIF or MP4; MP4 needs ffmpeg.

    Raises `OptionError` for other suffixes, without ffmpeg, and for fewer than two snapshots.
    """
    target = Path(target)
    if target.suffix not in MOVIES:
        raise OptionError(f"-movie {target}: allowed are files {' or '.join(MOVIES)}")
    if target.suffix == ".mp4" and not shutil.which("ffmpeg"):
        raise OptionError(f"-movie {target}: there is no ffmpeg; {target.with_suffix('.gif')} "
                          "needs none")
    if len(result.snapshots) < 2:
        raise OptionError(f"-movie {target}: {result.path} holds {len(result.snapshots)} snapshots;"
                          " a movie needs two, and better fifty (the option snapshots of a run)")
    norm = scale([snapshot.whole[name] for snapshot in result.snapshots], style)
    tallest = max(result.snapshots, key=lambda snapshot: np.ptp(snapshot.whole.x[..., 1]))
    figure = panels([tallest], name, replace(style, limits=(norm.vmin, norm.vmax)))
    axes = figure.axes[0]
    every = np.concatenate([snapshot.whole.x.reshape(-1, 2) for snapshot in result.snapshots])
    low, high = every.min(axis=0), every.max(axis=0)

    def frame(number):
        axes.clear()
        draw(axes, result.snapshots[number], name, norm, style)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])

    from matplotlib import animation

    frames = animation.FuncAnimation(figure, frame, frames=len(result.snapshots))
    writer = animation.PillowWriter if target.suffix == ".gif" else animation.FFMpegWriter
    frames.save(target, writer=writer(fps=rate), dpi=100)
    return [target]


def window(snapshot, name):
    """Show a snapshot in an interactive window of pyvista; raises `OptionError` without display."""
    import pyvista

    if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
        raise OptionError("-show: there is no display; without -show pictures are written")
    plotter = pyvista.Plotter(title=str(snapshot.result.path))
    plotter.add_mesh(snapshot.grid(name).tessellate(), scalars=name, cmap=COLOURS,
                     scalar_bar_args={"title": name})
    plotter.view_xy()
    plotter.show()
    return []
