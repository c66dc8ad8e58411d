"""The paper's figures 1 to 9, and growth rates of a specimen, with the numbers behind them.

The function of a figure returns a matplotlib figure, its numbers {name: array}, and a table of rows
(text, value in the paper, computed value).
"""

from pathlib import Path

import h5py
import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap

from ..material.laws.bingham import Bingham
from ..material.laws.jop import Jop
from ..theory import specimen, waves
from ..theory.waves import BASE_FLOWS, PURE_SHEAR, Coefficients
from . import band as bands, pictures
from .result import Result

#: The paper's parameters of glass beads.
MU_S, MU_2, B, A, PHI = 0.3819, 0.6435, 0.9377, 0.48, 0.6
JOP, BINGHAM = Jop(MU_S, MU_2, B), Bingham(MU_S, B)
#: Negative growth rates, from slow (light) to fast decay (dark); growth is white.
GREYS = ListedColormap(colormaps["Greys_r"](np.linspace(0.25, 0.88, 256)))

#: Element sizes of figures 6 and 7, d.
MESHES = "2", "1", "0.5", "0.25"
#: File names, without suffix, and compressions of the panels of figures 3 to 7.
RUNS = {
    "fig3": [("ngf_L40_I0.001_h0.5", c) for c in (0.05, 0.10, 0.14)],
    "fig4": [(f"ngf_L{L}_I0.001_h0.5", 0.10) for L in (20, 40, 60)],
    "fig5": [(f"ngf_L40_I{I0}_h0.5", 0.10) for I0 in (0.001, 0.007, 0.03)],
    "fig6": [(f"ngf_L40_I0.001_h{h}", 0.10) for h in MESHES],
    "fig7": [(f"li_L40_I0.001_h{h}", 0.01) for h in MESHES]}
#: Titles of their panels.
TITLES = {"fig3": "{remaining:.2f} H", "fig4": "L = {width:g} d",
          "fig5": "$I^0$ = {inertial_number:g}",
          "fig6": "{element_size:g} d", "fig7": "{element_size:g} d"}
#: Angle (degrees) and width (d) of the band in the paper, drawn as dashed lines.
ANGLE, WIDTH = 51.0, 24.5


def plane(size, points=601):
    """Return k1 and k2 (points, points) over a square of half side ``size`` without the origin."""
    k1, k2 = np.meshgrid(*2 * [np.linspace(-size, size, points)])
    k1[(k1 == 0.0) & (k2 == 0.0)] = 1e-9 * size
    return k1, k2


def growth_map(axes, k1, k2, rate, levels):
    """Draw negative growth rates in grey, positive ones white, and the threshold as a line."""
    filled = axes.contourf(k1, k2, np.where(rate > 0.0, np.nan, rate), levels=levels, cmap=GREYS,
                           extend="min")
    axes.contour(k1, k2, rate, levels=[0.0], colors="black", linewidths=1.0)
    return filled


def wave_vector_panels(width, height, titles):
    """Return a figure with two planes of wave vectors, and its axes."""
    figure, panels = pictures.new_figure(width, height, columns=2)
    for axes, title in zip(panels, titles):
        axes.set(xlabel=r"$\tilde k_1$", ylabel=r"$\tilde k_2$", aspect="equal")
        axes.set_title(title, fontsize=10)
    return figure, panels


def fig1():
    """Growth rates in pure shear at I0 = 0.001 for NGF and LI, with computed spectra if present."""
    k1, k2 = plane(0.2)
    ngf = Coefficients.of(JOP, "ngf", 0.001)
    k_cut, angle = float(waves.cutoff(ngf)), np.linspace(0.0, 2.0 * np.pi, 361)
    data, table = {"k1": k1, "k2": k2, "k_cut": k_cut}, []
    figure, panels = wave_vector_panels(10, 4.6, ("(a) NGF, $I^0$ = 0.001",
                                                  "(b) LI, $I^0$ = 0.001"))
    for axes, model in zip(panels, ("ngf", "li")):
        coefficients = Coefficients.of(JOP, model, 0.001)
        rate = data[f"growth_rate_{model}"] = waves.pure_shear_growth(k1, k2, coefficients)
        filled = growth_map(axes, k1, k2, rate, np.linspace(-0.04, 0.0, 17))
        path = Path("results") / f"spectra_{model}.csv"
        if path.exists():
            points = np.genfromtxt(path, delimiter=",", names=True)
            computed = points["computed"] / float(
                waves.viscous_rate(coefficients.mu, A, PHI, 0.001))
            shades = GREYS(np.clip(1.0 + computed / 0.04, 0.0, 1.0))  # as the contours
            shades[computed > 0.0] = 1.0
            axes.scatter(points["k1"], points["k2"], s=26, zorder=3, c=shades,
                         edgecolors="tab:red", linewidths=0.7)
            data[f"slepc_{model}"] = np.stack([points["k1"], points["k2"], computed])
            table.append((f"SLEPc on figure 1, {model}: largest relative error", "-",
                          points["relative_error"].max()))
    figure.colorbar(filled, ax=panels, label=r"$\tilde\lambda$", shrink=0.8)
    panels[0].plot(k_cut * np.cos(angle), k_cut * np.sin(angle), "k--", linewidth=1.0)
    low, high = sorted(float(waves.direction_angle(m, PURE_SHEAR))
                       for m in waves.unstable_directions(ngf))
    fastest = float(waves.direction_angle(waves.fastest(ngf)[2], PURE_SHEAR))
    return figure, data, [
        *table, ("unstable directions at I0 = 0.001, from (degrees)", 34, low),
        ("unstable directions at I0 = 0.001, to (degrees)", 45, high),
        ("fastest direction at I0 = 0.001 (degrees)", 39, fastest),
        ("radius of the dashed circle, I0 = 0.001", "-", k_cut)]


def fig2():
    """The cut-off over mu_2 - mu_s and I0/I_0, over mu_s, and over b I0 (Bingham)."""
    rise, ratio = np.meshgrid(np.linspace(0.003, 0.6, 200), np.geomspace(1e-3, 1e2, 200))
    law = Jop(MU_S, MU_S + rise, B)
    k_cut = waves.cutoff(Coefficients.of(law, "ngf", ratio * law.I_0))
    figure, (left, middle, right) = pictures.new_figure(14, 4.2, columns=3)
    filled = left.contourf(rise, ratio, np.where(k_cut > 0.0, k_cut, np.nan),
                           levels=np.linspace(0.0, 1.0, 11), cmap="viridis", extend="max")
    # Where the growth rate of long waves changes sign.
    left.contour(rise, ratio, waves.long_wave_excess(law, ratio * law.I_0),
                 levels=[0.0], colors="black")
    left.set(yscale="log", xlabel=r"$\mu_2 - \mu_s$", ylabel=r"$I^0/I_0$",
             title=r"(a) $\tilde k_{cut}$")
    figure.colorbar(filled, ax=left)

    mu_s = np.linspace(0.002, 0.998, 499)
    quasi_static = waves.cutoff(Coefficients.of(Bingham(mu_s, B), "ngf", 0.0 * mu_s))
    middle.plot(mu_s, quasi_static, "k")
    middle.set(xlabel=r"$\mu_s$", ylabel=r"$\tilde k_{cut}(I^0/I_0 \to 0)$", xlim=(0, 1),
               ylim=(0, None), title="(b)")

    critical = float(B * waves.critical_inertial_numbers(BINGHAM)[0])
    bI = np.unique(np.concatenate([np.geomspace(1e-4, (1.0 - MU_S) * (1.0 - 1e-9), 600),
                                   critical * (1.0 - np.geomspace(1e-8, 0.3, 200)), [critical]]))
    bingham = waves.cutoff(Coefficients.of(BINGHAM, "ngf", bI / B))
    right.plot(bI, bingham, "k")
    right.set(xscale="log", xlabel=r"$b I^0$", ylabel=r"$\tilde k_{cut}$", ylim=(0, None),
              xlim=(bI[0], bI[-1]), title="(c)")

    limit = float(waves.cutoff(Coefficients.of(BINGHAM, "ngf", 0.0)))
    k_at_10 = float(waves.cutoff(Coefficients.of(JOP, "ngf", 10.0 * JOP.I_0)))
    data = {"mu_2_minus_mu_s": rise, "I0_over_I_0": ratio, "k_cut": k_cut, "mu_s": mu_s,
            "k_cut_quasi_static": quasi_static, "b_I0": bI, "k_cut_bingham": bingham}
    return figure, data, [
        ("quasi-static cut-off, mu_s = 0.3819", 0.123, limit),
        ("quasi-static cut-off wavelength, A = 0.48 (d)", 24.5, 2.0 * np.pi * A / limit),
        ("largest cut-off for I0/I_0 <= 0.1", "below 0.2", float(k_cut[ratio <= 0.1].max())),
        ("cut-off at I0/I_0 = 10, glass beads", "beyond the plot", k_at_10),
        ("quasi-static cut-off increases with mu_s", "yes",
         (np.diff(quasi_static) > 0.0).all()),
        ("quasi-static cut-off at mu_s = 0.002", "to 0", float(quasi_static[0])),
        ("b I0 where the Bingham cut-off vanishes", 0.0158, critical),
        ("largest cut-off for 0.0158 <= b I0 < 0.6181", 0, float(bingham[bI >= 0.0158].max()))]


def fig8():
    """Growth rates of the IG model in pure shear at I0 = 0.001 and 0.1."""
    k1, k2 = plane(6.0, 801)
    k, close_up = np.stack([k1, k2], axis=-1), plane(0.3)
    data, table = {"k1": k1, "k2": k2}, []
    figure, panels = wave_vector_panels(10.5, 5.0, ("(a) IG, $I^0$ = 0.001", "(b) IG, $I^0$ = 0.1"))
    for axes, I0, name in zip(panels, (0.001, 0.1), "ab"):
        coefficients = Coefficients.of(JOP, "ig", I0)
        rate = waves.pure_shear_growth(k1, k2, coefficients)
        _, denominator = waves.tensor(k, PURE_SHEAR, *coefficients.r_q(k1**2 + k2**2))
        # Growth is unbounded where short waves of the same direction grow.
        across = waves.transverse_basis(k)
        limit = (across @ waves.asymptotic_tensor(k, PURE_SHEAR, coefficients)
                 @ np.swapaxes(across, -1, -2))[..., 0, 0]
        growth_map(axes, k1, k2, np.where(np.abs(denominator) < 0.02, np.nan, rate),
                   np.linspace(-40.0, 0.0, 9))
        axes.contourf(k1, k2, np.where((rate > 0.0) & (limit > 0.0), 1.0, np.nan),
                      levels=[0.5, 1.5], colors="none", hatches=["--"])
        axes.contour(k1, k2, denominator, levels=[0.0], colors="grey", linewidths=1.2)
        data.update({f"growth_rate_{name}": rate, f"denominator_{name}": denominator})
        near = waves.pure_shear_growth(*close_up, coefficients)
        angles = np.radians(np.arange(1.0, 90.0))
        short = waves.growth_rates(1e4 * np.stack([np.cos(angles), np.sin(angles)], axis=-1),
                                   PURE_SHEAR, coefficients)[:, 0]
        table += [(f"IG, I0 = {I0}: unstable near the origin", "yes" if name == "a" else "no",
                   near.max() > 0.0),
                  (f"IG, I0 = {I0}: growth without bound in some directions", "yes",
                   (short > 1e6).any()),
                  (f"IG, I0 = {I0}: smallest |k| where growth is discontinuous", "-",
                   float(np.sqrt(2.0 * (1.0 - coefficients.nu / 2.0 + 1.0 / coefficients.mu))))]
        if name == "a":
            inset = axes.inset_axes([0.60, 0.62, 0.38, 0.36])
            inset.set_aspect("equal")
            growth_map(inset, *close_up, near, np.linspace(-0.1, 0.0, 6))
            inset.tick_params(labelsize=6)
            data["growth_rate_close_up"] = near
    for model in ("li", "ngf"):
        rate = waves.growth_rates(np.stack(plane(3.0), axis=-1), PURE_SHEAR,
                                  Coefficients.of(JOP, model, 0.1))
        table.append((f"{model.upper()}, I0 = 0.1: unstable anywhere", "no", rate.max() > 0.0))
    return figure, data, table


def fig9():
    """Initial stability thresholds in simple shear with and without convection (A 7)."""
    gradient = BASE_FLOWS["simple_shear"]
    N = waves.flow_direction(gradient)
    data, table = {}, []
    figure, panels = wave_vector_panels(10, 4.8, ("(a) simple shear, $I^0$ = 0.001",
                                                  "(b) simple shear, $I^0$ = 1"))
    for axes, I0, name, size, stated in zip(panels, (0.001, 1.0), "ab", ("<< 1", "order 1"),
                                            ("indistinguishable", "quite different")):
        coefficients = Coefficients.of(JOP, "ngf", I0)
        number = 1.0 / float(waves.viscous_rate(coefficients.mu, A, PHI, I0))
        k1, k2 = plane(1.6 * float(waves.cutoff(coefficients)), 401)
        k = np.stack([k1, k2], axis=-1)
        plain = waves.growth_rates(k, N, coefficients)[..., 0].real
        full, reduced = (function(k, N, coefficients, number, gradient)[..., 0].real
                         for function in (waves.tensor_growth_rates, waves.growth_rates))
        data.update({f"k1_{name}": k1, f"k2_{name}": k2, f"without_{name}": plain,
                     f"with_{name}": full, f"with_incompressible_{name}": reduced})
        table.append((f"A^2 phi I0^2/mu_loc at I0 = {I0:g}", size, number))
        for values, style, color, label, text in (
                (plain, "solid", "black", "without convection", None),
                (full, "dashed", "black", "(A 7), as the paper", ""),
                (reduced, "dotted", "tab:red", "(A 7) on v.k = 0", ", v.k = 0")):
            axes.contour(k1, k2, values, levels=[0.0], colors=color, linestyles=style,
                         linewidths=1.2)
            axes.plot([], [], color=color, linestyle=style, label=label)
            if text is not None:
                changed = np.mean((plain > 0.0) != (values > 0.0)) / np.mean(plain > 0.0)
                table.append((f"wave vectors whose stability changes / unstable ones, I0 = {I0:g}"
                              f"{text}", stated, float(changed)))
    panels[0].legend(fontsize=8)
    return figure, data, table


def specimen_rates():
    """Growth rates of a specimen of width 40 d over n pi L/H, for both parities and several I0."""
    width, numbers, wave = 40.0, (1e-4, 1e-3, 3e-3, 1e-2, 3e-2), np.geomspace(0.25, 12.0, 400)
    data, table = {"n_pi_L_over_H": wave}, []
    figure, axes = pictures.new_figure(10.0, 4.2, columns=2)
    for axis, parity, title in zip(axes, specimen.PARITIES, (
            "both faces the same way (sway)", "faces opposite ways (barrel)")):
        for I0, shade in zip(numbers, colormaps["viridis"](np.linspace(0.0, 0.85, 5))):
            *rates, at_3 = (
                specimen.growth_rate(BINGHAM, "ngf", inertial_number=I0, width=width,
                                     height=height, parity=parity)
                for height in (*np.pi * width / wave, 3.0 * width))
            data[f"{parity}_{I0:g}"] = np.array(rates)
            axis.plot(wave, rates, color=shade, label=f"$I^0$ = {I0:g}")
            table.append((f"{parity}, I0 = {I0:g}: growth rate at H = 3 L, n = 1 (gdot0)", "-",
                          float(at_3)))
        axis.set(xscale="log", xlim=(wave[0], wave[-1]), title=title, xlabel=r"$n\pi L/H$",
                 xticks=[0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0])
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter("")
    sway, barrel = axes
    sway.set(yscale="log", ylim=(0.4, 1e4), ylabel=r"growth rate / $\dot\gamma^0$")
    for ratio in (1.5, 3.0, 6.0):
        sway.axvline(np.pi / ratio, color="0.75", linewidth=0.8, zorder=0)
        sway.text(np.pi / ratio, 0.46, f" H = {ratio:g} L", rotation=90, fontsize=7, color="0.4",
                  va="bottom", ha="right")
    sway.legend(fontsize=8)
    barrel.set_ylim(-45.0, 45.0)
    barrel.axhline(0.0, color="0.6", linewidth=0.8)
    return figure, data, table


def section4(name, directory):
    """The inertial number on the deformed shape, with one colour scale.

    The dashed lines are the band of the linear theory, centred on the computed band. LI has many
    bands; for LI they are both directions through the centre.
    """
    snapshots, data, table = {}, {}, []
    for letter, (run, compression) in zip("bcd" if name == "fig3" else "abcd", RUNS[name]):
        path = Path(directory) / f"{run}.h5"
        for snapshot in Result(path).snapshots if path.exists() else ():
            if abs(snapshot.attributes.get("compression", -1.0) - compression) < 1e-6:
                snapshots[letter] = snapshot
        if letter not in snapshots:
            table.append((f"not drawn, because the run is missing: {run}", "", "-"))
    if not snapshots:
        raise ValueError(
            f"{name}: no results in {directory}; run bash jobs/study.sh section4 {name}")
    quantity = "I/I0" if name == "fig5" else "inertial_number"
    for snapshot in snapshots.values():
        snapshot.keep({"I/I0": snapshot["inertial_number"]
                       / snapshot.result.options["inertial_number"]})
    figure = pictures.panels(list(snapshots.values()), quantity, pictures.Style(
        limits=(0.0, max(shown[quantity].max() for shown in snapshots.values())), outline=False))
    tallest = max(snapshot.x[..., 1].max() for snapshot in snapshots.values())
    for axes, (letter, snapshot) in zip(figure.axes, snapshots.items()):
        compression, I = snapshot.attributes["compression"], snapshot["inertial_number"]
        axes.set(xlim=axes.get_xlim(), ylim=(0.0, tallest))
        for point, slope in dashed_lines(snapshot):
            axes.axline(point, slope=slope, color="white", linestyle="dashed", linewidth=0.9)
        title = TITLES[name].format(remaining=1.0 - compression, **snapshot.result.options)
        axes.set_title(f"({letter}) {title}", fontsize=9)
        data.update({f"{letter}/x": snapshot.x, f"{letter}/I": I})
        prefix = f"({letter}) {snapshot.result.path.stem} at {100 * compression:g} %: "
        table += [(prefix + text, *values) for text, *values in panel_rows(snapshot)]
        if name == "fig7":
            number = bands.stretches(snapshot["I/I0"][:, I.shape[1] // 4] > 1.0)
            table.append((prefix + "bands across the line at L/4", "more with refinement", number))
    return figure, data, table


def dashed_lines(snapshot):
    """Return points and slopes of the lines of the theory."""
    slope, rise = np.tan(np.radians(ANGLE)), WIDTH / 2.0 / np.cos(np.radians(ANGLE))
    if snapshot.result.options["model"] == "li":
        centre = (snapshot.x.min((0, 1)) + snapshot.x.max((0, 1))) / 2.0
        return [(centre, slope), (centre, -slope)]
    band = snapshot.band()
    if not band["bands"]:
        return []
    slope = np.copysign(slope, band["angle"])
    return [(band["centre"] + np.array([0.0, side]), slope) for side in (-rise, rise)]


def panel_rows(snapshot):
    """Return the rows of the table for one panel."""
    band, I = snapshot.band(), snapshot["inertial_number"]
    rows = [("I from", "-", float(I.min())), ("I to", "-", float(I.max())),
            ("localised", "-", band["localised"])]
    if snapshot.result.options["model"] == "li" or not band["localised"]:
        return rows
    if not band["bands"]:
        return [*rows, (f"no band: {band['reason']}", "-", "-")]
    return [*rows, (f"angle (degrees), +- {band['angle_error']:.1f}", "51 or -51", band["angle"]),
            (f"width (d), +- {band['width_error']:.1f}", "about 24.5", band["width"]),
            ("bands", "1", band["bands"])]


#: Figures that need no simulation.
THEORY = {"fig1": fig1, "fig2": fig2, "fig8": fig8, "fig9": fig9, "specimen": specimen_rates}


def draw(names, directory, results):
    """Draw figures to files NAME.png and NAME.h5 (the numbers) and print their tables.

    ``results`` is the directory of the runs of figures 3 to 7.
    """
    directory, known = Path(directory), sorted({**THEORY, **RUNS})
    if unknown := set(names) - set(known):
        raise ValueError(f"unknown figure {' '.join(sorted(unknown))}; expected one of: "
                         + ", ".join(known))
    for name in names:
        figure, data, table = THEORY[name]() if name in THEORY else section4(name, results)
        directory.mkdir(parents=True, exist_ok=True)
        figure.savefig(directory / f"{name}.png")
        with h5py.File(directory / f"{name}.h5", "w") as file:
            for key, value in data.items():
                file[key] = value
        print(f"{directory / name}.png, {directory / name}.h5")
        print("\n| quantity | paper | computed |\n|---|---|---|")
        for text, stated, computed in table:
            if isinstance(computed, (bool, np.bool_)):
                computed = "yes" if computed else "no"
            shown = f"{computed:.5g}" if isinstance(computed, float) else computed
            print(f"| {text} | {stated} | {shown} |".replace("|k|", r"\|k\|"))
