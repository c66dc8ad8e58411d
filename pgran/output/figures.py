"""The paper's figures of the linear theory: 1, 2, 8 and 9; figures 3 to 7 are in `section4`.

Each function draws one figure and passes it to ``save(figure, data, table)``, with the numbers
behind it, {name: array}, and the rows (text, what the paper says, what was computed) of a table.
"""

from pathlib import Path

import h5py
import matplotlib
import matplotlib.ticker
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from ..material.laws.bingham import Bingham
from ..material.laws.jop import Jop
from ..theory import specimen, waves
from ..theory.waves import (
    BASE_FLOWS,
    PURE_SHEAR as PURE,
    Coefficients,
)

#: The paper's glass beads, as the captions of its figures state them.
MU_S, MU_2, B, A, PHI = 0.3819, 0.6435, 0.9377, 0.48, 0.6
JOP, BINGHAM = Jop(MU_S, MU_2, B), Bingham(MU_S, B)


#: Decay from slow (light, yet not the white of growth) to fast (dark).
GREYS = matplotlib.colors.ListedColormap(plt.get_cmap("Greys_r")(np.linspace(0.25, 0.88, 256)))


def plane(size, points=601):
    """Return k1 and k2 (points, points) over a square of half side ``size``, the origin left out.

    An even count would leave it out too, but would not be symmetric about the axes.
    """
    ticks = np.linspace(-size, size, points)
    k1, k2 = np.meshgrid(ticks, ticks)
    origin = (k1 == 0.0) & (k2 == 0.0)
    k1[origin] = 1e-9 * size
    return k1, k2


def growth_map(axes, k1, k2, rate, levels):
    """Draw decaying growth rates in colour, growing ones white, the threshold as a solid line."""
    shown = np.where(rate > 0.0, np.nan, rate)
    filled = axes.contourf(k1, k2, shown, levels=levels, cmap=GREYS, extend="min")
    axes.contour(k1, k2, rate, levels=[0.0], colors="black", linewidths=1.0)
    axes.set_aspect("equal")
    return filled


def label_wave_vectors(axes, title):
    """Label the axes of a plane of wave vectors."""
    axes.set_xlabel(r"$\tilde k_1$")
    axes.set_ylabel(r"$\tilde k_2$")
    axes.set_title(title, fontsize=10)


def fig1(save):
    """Growth rates in pure shear at I0 = 0.001 for NGF and LI, with SLEPc's points if there."""
    size, data, table = 0.2, {}, []
    k1, k2 = plane(size)
    figure, panels = plt.subplots(1, 2, figsize=(10, 4.6), constrained_layout=True)
    for axes, model in zip(panels, ("ngf", "li")):
        coefficients = Coefficients.of(JOP, model, 0.001)
        rate = waves.pure_shear_growth(k1, k2, coefficients)
        filled = growth_map(axes, k1, k2, rate, np.linspace(-0.04, 0.0, 17))
        label_wave_vectors(axes, f"({'ab'[model == 'li']}) {model.upper()}, $I^0$ = 0.001")
        data[f"growth_rate_{model}"] = rate
        points = _spectra(Path("results") / f"spectra_{model}.csv")
        if points is not None:
            # In the colours of the contours: of a point that agrees only the rim is seen.
            computed = points["computed"] / float(
                waves.viscous_rate(coefficients.mu, A, PHI, 0.001))
            shades = GREYS(np.clip(1.0 + computed / 0.04, 0.0, 1.0))
            shades[computed > 0.0] = 1.0
            axes.scatter(points["k1"], points["k2"], s=26, zorder=3, c=shades,
                         edgecolors="tab:red", linewidths=0.7)
            data[f"slepc_{model}"] = np.stack([points["k1"], points["k2"], computed])
            table.append((f"SLEPc on figure 1, {model}: largest relative error", "-",
                          points["relative_error"].max()))
    figure.colorbar(filled, ax=panels, label=r"$\tilde\lambda$", shrink=0.8)
    ngf = Coefficients.of(JOP, "ngf", 0.001)
    k_cut = float(waves.cutoff(ngf))
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    panels[0].plot(k_cut * np.cos(angle), k_cut * np.sin(angle), "k--", linewidth=1.0)
    data.update(k1=k1, k2=k2, k_cut=k_cut)
    low, high = sorted(float(waves.direction_angle(m, PURE))
                       for m in waves.unstable_directions(ngf))
    table += [("unstable directions at I0 = 0.001, from (degrees)", 34, low),
              ("unstable directions at I0 = 0.001, to (degrees)", 45, high),
              ("fastest direction at I0 = 0.001 (degrees)", 39,
               float(waves.direction_angle(waves.fastest(ngf)[2], PURE))),
              ("radius of the dashed circle, I0 = 0.001", "-", k_cut)]
    save(figure, data, table)


def _spectra(path):
    if not path.exists():
        return None
    return np.genfromtxt(path, delimiter=",", names=True)


def fig2(save):
    """The cut-off over mu_2 - mu_s and I0/I_0, over mu_s, and over b I0 (Bingham)."""
    rise, ratio = np.meshgrid(np.linspace(0.003, 0.6, 200), np.geomspace(1e-3, 1e2, 200))
    law = Jop(MU_S, MU_S + rise, B)
    k_cut = waves.cutoff(Coefficients.of(law, "ngf", ratio * law.I_0))
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.2), constrained_layout=True)
    filled = left.contourf(rise, ratio, np.where(k_cut > 0.0, k_cut, np.nan),
                           levels=np.linspace(0.0, 1.0, 11), cmap="viridis", extend="max")
    # The boundary of the stable region is where the growth of long waves changes sign.
    excess = waves.long_wave_excess(Coefficients.of(law, "li", ratio * law.I_0))
    left.contour(rise, ratio, excess, levels=[0.0], colors="black")
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
    low = ratio <= 0.1
    k_at_10 = float(waves.cutoff(Coefficients.of(JOP, "ngf", 10.0 * JOP.I_0)))
    save(figure, {"mu_2_minus_mu_s": rise, "I0_over_I_0": ratio, "k_cut": k_cut, "mu_s": mu_s,
                  "k_cut_quasi_static": quasi_static, "b_I0": bI, "k_cut_bingham": bingham},
         [("quasi-static cut-off, mu_s = 0.3819", 0.123, limit),
          ("quasi-static cut-off wavelength, A = 0.48 (d)", 24.5, 2.0 * np.pi * A / limit),
          ("largest cut-off for I0/I_0 <= 0.1, below", 0.2, float(k_cut[low].max())),
          ("cut-off at I0/I_0 = 10, glass beads", "beyond the plot", k_at_10),
          ("quasi-static cut-off increases with mu_s", "yes",
           "yes" if (np.diff(quasi_static) > 0.0).all() else "no"),
          ("quasi-static cut-off at mu_s = 0.002", "to 0", float(quasi_static[0])),
          ("b I0 where the Bingham cut-off vanishes", 0.0158, critical),
          ("largest cut-off for 0.0158 <= b I0 < 0.6181", 0,
           float(bingham[bI >= 0.0158].max()))])


def fig8(save):
    """Growth rates of the IG model in pure shear at I0 = 0.001 and 0.1."""
    size, data, table = 6.0, {}, []
    k1, k2 = plane(size, 801)
    figure, panels = plt.subplots(1, 2, figsize=(10.5, 5.0), constrained_layout=True)
    for axes, I0, name in zip(panels, (0.001, 0.1), "ab"):
        coefficients = Coefficients.of(JOP, "ig", I0)
        rate = waves.pure_shear_growth(k1, k2, coefficients)
        k = np.stack([k1, k2], axis=-1)
        _, denominator = waves.tensor(k, PURE, *coefficients.r_q(k1**2 + k2**2))
        # Growth without bound: positive in the limit of short waves, along the same direction.
        far = waves.asymptotic_tensor(k, PURE, coefficients)
        across = waves.transverse_basis(k)
        unbounded = (across @ far @ np.swapaxes(across, -1, -2))[..., 0, 0] > 0.0
        axes.contourf(k1, k2, np.where(rate > 0.0, np.nan, rate), cmap=GREYS,
                      levels=np.linspace(-40.0, 0.0, 9), extend="min")
        axes.contourf(k1, k2, np.where((rate > 0.0) & unbounded, 1.0, np.nan), levels=[0.5, 1.5],
                      colors="none", hatches=["--"])
        axes.contour(k1, k2, np.where(np.abs(denominator) < 0.02, np.nan, rate), levels=[0.0],
                     colors="black", linewidths=1.0)
        axes.contour(k1, k2, denominator, levels=[0.0], colors="grey", linewidths=1.2)
        axes.set_aspect("equal")
        label_wave_vectors(axes, f"({name}) IG, $I^0$ = {I0}")
        data.update({f"growth_rate_{name}": rate, f"denominator_{name}": denominator})
        near = waves.pure_shear_growth(*plane(0.3), coefficients)
        ray = 1e4 * np.array([[np.cos(a), np.sin(a)] for a in np.radians(np.arange(1.0, 90.0))])
        steep = waves.growth_rates(ray, PURE, coefficients)[:, 0]
        table += [(f"IG, I0 = {I0}: unstable near the origin", "yes" if name == "a" else "no",
                   "yes" if near.max() > 0.0 else "no"),
                  (f"IG, I0 = {I0}: growth without bound in some directions", "yes",
                   "yes" if (steep > 1e6).any() else "no"),
                  (f"IG, I0 = {I0}: smallest |k| where growth is discontinuous", "-",
                   float(np.sqrt(2.0 * (1.0 - coefficients.nu / 2.0 + 1.0 / coefficients.mu))))]
        if name == "a":
            inset = axes.inset_axes([0.60, 0.62, 0.38, 0.36])
            small = plane(0.3)
            growth_map(inset, *small, near, np.linspace(-0.1, 0.0, 6))
            inset.tick_params(labelsize=6)
            data["growth_rate_close_up"] = near
    for model in ("li", "ngf"):
        k = np.stack(plane(3.0), axis=-1)
        rate = waves.growth_rates(k, PURE, Coefficients.of(JOP, model, 0.1))
        table.append((f"{model.upper()}, I0 = 0.1: unstable anywhere", "no",
                      "yes" if rate.max() > 0.0 else "no"))
    data.update(k1=k1, k2=k2)
    save(figure, data, table)


def fig9(save):
    """Initial stability thresholds in simple shear with and without convection (A 7)."""
    gradient = BASE_FLOWS["simple_shear"]
    N = waves.flow_direction(gradient)
    figure, panels = plt.subplots(1, 2, figsize=(10, 4.8), constrained_layout=True)
    data, table = {}, []
    for axes, I0, name in zip(panels, (0.001, 1.0), "ab"):
        coefficients = Coefficients.of(JOP, "ngf", I0)
        number = 1.0 / float(waves.viscous_rate(coefficients.mu, A, PHI, I0))
        k1, k2 = plane(1.6 * float(waves.cutoff(coefficients)), 401)
        k = np.stack([k1, k2], axis=-1)
        plain = waves.growth_rates(k, N, coefficients)[..., 0].real
        full, reduced = (function(k, N, coefficients, number, gradient)[..., 0].real
                         for function in (waves.tensor_growth_rates, waves.growth_rates))
        for values, style, color in ((plain, "solid", "black"), (full, "dashed", "black"),
                                     (reduced, "dotted", "tab:red")):
            axes.contour(k1, k2, values, levels=[0.0], colors=color, linestyles=style,
                         linewidths=1.2)
        axes.set_aspect("equal")
        label_wave_vectors(axes, f"({name}) simple shear, $I^0$ = {I0:g}")
        data.update({f"k1_{name}": k1, f"k2_{name}": k2, f"without_{name}": plain,
                     f"with_{name}": full, f"with_incompressible_{name}": reduced})
        table.append((f"A^2 phi I0^2/mu_loc at I0 = {I0:g}", "<< 1" if name == "a" else "order 1",
                      number))
        stated = "indistinguishable" if name == "a" else "quite different"
        for text, values in (("", full), (", v.k = 0", reduced)):
            changed = np.mean((plain > 0.0) != (values > 0.0)) / np.mean(plain > 0.0)
            table.append((f"wave vectors that change sides at I0 = {I0:g}, over the unstable "
                          f"ones{text}", stated, float(changed)))
    for label, style, color in (("without convection", "solid", "black"),
                                ("(A 7), as the paper", "dashed", "black"),
                                ("(A 7) on v.k = 0", "dotted", "tab:red")):
        panels[0].plot([], [], color=color, linestyle=style, label=label)
    panels[0].legend(fontsize=8)
    save(figure, data, table)


#: Width and inertial numbers of the figure of the specimen, and the aspect ratios that it marks.
WIDTH, INERTIAL_NUMBERS, MARKED = 40.0, (1e-4, 1e-3, 3e-3, 1e-2, 3e-2), (1.5, 3.0, 6.0)


def specimen_rates(save):
    """Growth rates of a specimen of 40 d over n pi L/H, for both parities and several I0."""
    wave = np.geomspace(0.25, 12.0, 400)
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), constrained_layout=True)
    shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(INERTIAL_NUMBERS)))
    data, table = {"n_pi_L_over_H": wave}, []
    for axis, parity, title in zip(axes, specimen.PARITIES, (
            "both faces the same way (sway)", "faces opposite ways (barrel)")):
        for I0, shade in zip(INERTIAL_NUMBERS, shades):
            def rate(height, I0=I0, parity=parity):
                return specimen.growth_rate(BINGHAM, "ngf", inertial_number=I0, width=WIDTH,
                                            height=height, parity=parity)

            rates = data[f"{parity}_{I0:g}"] = np.array([rate(np.pi * WIDTH / k) for k in wave])
            axis.plot(wave, rates, color=shade, label=f"$I^0$ = {I0:g}")
            table.append((f"{parity}, I0 = {I0:g}: growth rate at H = 3 L, n = 1 (gdot0)", "-",
                          float(rate(3.0 * WIDTH))))
        axis.set(xscale="log", xlim=(wave[0], wave[-1]), title=title, xlabel=r"$n\pi L/H$",
                 xticks=[0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0])
        axis.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
        axis.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    sway, barrel = axes
    sway.set(yscale="log", ylim=(0.4, 1e4), ylabel=r"growth rate / $\dot\gamma^0$")
    for ratio in MARKED:
        sway.axvline(np.pi / ratio, color="0.75", linewidth=0.8, zorder=0)
        sway.text(np.pi / ratio, 0.46, f" H = {ratio:g} L", rotation=90, fontsize=7, color="0.4",
                  va="bottom", ha="right")
    barrel.set_ylim(-45.0, 45.0)
    barrel.axhline(0.0, color="0.6", linewidth=0.8)
    sway.legend(fontsize=8)
    save(figure, data, table)


FIGURES = {"fig1": fig1, "fig2": fig2, "fig8": fig8, "fig9": fig9, "specimen": specimen_rates}


def draw(names, directory, results):
    """Draw figures and print their tables.

    Parameters
    ----------
    names : list of str
        fig1 ... fig9 or specimen.
    directory : str or Path
        Where NAME.png and, as NAME.h5, the numbers behind it go.
    results : str or Path
        Where the runs of section 4 are.

    Raises
    ------
    ValueError
        If there is no such figure, or none of its runs.
    """
    from . import section4

    known = {**FIGURES, **{name: lambda save, draw=draw_runs: draw(save, results)
                           for name, draw_runs in section4.FIGURES.items()}}
    if wrong := [name for name in names if name not in known]:
        raise ValueError(f"{' '.join(wrong)}: allowed is {' '.join(sorted(known))}")
    directory = Path(directory)
    for name in names:
        def save(figure, data, table, name=name):
            directory.mkdir(parents=True, exist_ok=True)
            figure.savefig(directory / f"{name}.png", dpi=150)
            plt.close(figure)
            with h5py.File(directory / f"{name}.h5", "w") as file:
                for key, value in data.items():
                    file[key] = value
            print(f"{directory / name}.png, {directory / name}.h5")
            for text, stated, found in table:
                shown = f"{found:.5g}" if isinstance(found, float) else found
                print(f"  {text:76} paper {stated!s:>18}  computed {shown}")

        known[name](save)
