"""Variations of the reference simulation: numerical parameters, material, I0 and size."""

from pathlib import Path

import numpy as np

from pgran import cases
from pgran.options import RUN, SolutionError
from pgran.output import band
from pgran.theory import specimen, waves

from . import study
from .study import COST, cost, result_file

#: Default of -pgran_step_error.
DEFAULT = next(row.default for row in RUN if row.name == "step_error")
SENSITIVITY = {
    "base": (),
    **{f"G = {G}": ("-pgran_shear_modulus", float(G)) for G in ("100", "300", "1e4", "1e5")},
    **{f"{value / DEFAULT:g} of the step error": ("-pgran_step_error", value)
       for value in (0.05, 0.025)},
    **{f"steps up to {step}": ("-pgran_step_max", float(step)) for step in ("1e-3", "5e-4")},
    **{f"imperfection {factor}": ("-pgran_imperfection", factor) for factor in (0.9, 0.95, 0.999)},
    "imperfection of 4 d": ("-pgran_imperfection_size", 4),
    "mirrored": ("-pgran_imperfection_mirrored", "true"),
    "Jop": ("-pgran_law", "jop"),
    "no slip at the plates": ("-pgran_plates_slip", "false")}
VERIFY = {
    "base": (),
    "stiff": ("-pgran_shear_modulus", 10000),
    "small_steps": ("-pgran_step_max", 0.001, "-pgran_step_error", 0.05),
    "fine": ("-pgran_element_size", 1),
    "inertial": ("-pgran_inertial_number", 0.03)}
#: Largest difference from the base, per cent of the largest I.
LIMITS = {"stiff": 3.0, "small_steps": 2.0, "fine": 10.0}
#: The run that remains homogeneous, and the limit of |I/I0 - 1|.
HOMOGENEOUS = "inertial", 0.02
NUMBERS = 1e-4, 3e-4, 1e-3, 3e-3, 5e-3, 7e-3, 1e-2, 3e-2, 1e-1
WIDTHS = 20, 40, 60, 80
#: Contours of the growth rate, gdot0.
LEVELS = 25, 50, 100, 200, 400, 800


def sensitivity(directory="results/sensitivity", *, options=()):
    """Sensitivity of the band of figure 3 to unspecified parameters: sensitivity [directory]

    Elastic modulus, step, imperfection, law and plates, on elements of 2 d. The table contains the
    band in each snapshot and the cost of each run. Ten minutes on two cores.
    """
    def rows():
        for name, varied in SENSITIVITY.items():
            path = result_file(directory, name)
            result = study.run(path, "biaxial", *options, *varied, needed=False)
            if result is None:
                yield name, "run failed"
                continue
            for row in band.measure(path):
                yield (name, row["compression"], row["inertial_number_max"], row["angle"],
                       row["width"], *cost(result))

    study.write_table(Path(directory) / "sensitivity.csv", {
        "case": "", "compression": "g", "I max": ".3e", "angle": ".1f", "width": ".1f", **COST},
        rows())


def verify(directory="results/verify", *, options=()):
    """Effect of step, stiffness and mesh on the reference simulation: verify [directory]

    Stiffer elasticity, smaller steps, half the element size, and a larger inertial number. The
    difference from the base is the maximum difference of I at the same material points, over the
    largest I of the base. The study fails beyond its limits. Three minutes on two cores.
    """
    beyond, base = [], None

    def rows():
        nonlocal base
        for name, varied in VERIFY.items():
            path = Path(directory) / f"{name}.h5"
            result = study.run(path, "biaxial", *options, *varied)
            row = band.measure(path)[-1]
            low, high = row["inertial_number_min"], row["inertial_number_max"]
            I, I0 = result.snapshots[-1]["inertial_number"], result.options["inertial_number"]
            if name == HOMOGENEOUS[0]:
                change = difference = None
                failed = max(abs(low / I0 - 1.0), abs(high / I0 - 1.0)) >= HOMOGENEOUS[1]
            else:
                base = I if base is None else base
                step = (len(I) - 1) // (len(base) - 1)
                scale = 100 / base.max()
                change = scale * high - 100
                difference = scale * float(np.abs(I[::step, ::step] - base).max())
                failed = difference > LIMITS.get(name, np.inf)
            if failed:
                beyond.append(name)
            yield name, low, high, change, difference, row["angle"], row["width"]

    study.write_table(Path(directory) / "verify.csv", {
        "run": "", "I min": ".4e", "I max": ".4e", "to base (%)": "+.2f",
        "difference (%)": ".2f", "angle": ".1f", "width": ".1f"}, rows())
    if beyond:
        raise SolutionError(f"beyond the limits: {', '.join(beyond)}")


def regime(directory="results/regime", *, options=()):
    """Map of localised and homogeneous flow over I0 and L at 10 % compression: regime [directory]

    NGF on elements of 2 d (3 d at L = 60 d, 4 d at 80 d). The figure shows the range of I over I0
    of each run. Red lines are analytical growth rates of the specimen (`pgran.theory.specimen`),
    and the dashed line is the shortest wavelength that grows in an infinite medium. Ten minutes on
    two cores.
    """
    def rows():
        for width in WIDTHS:
            for number in NUMBERS:
                path = result_file(directory, f"L{width}_I{number:g}")
                size = max(2, width // 20)
                if study.run(path, "biaxial", *options, "-pgran_width", width,
                             "-pgran_inertial_number", number, "-pgran_element_size", size,
                             needed=False) is None:
                    yield f"{width}", f"{number:g}", "run failed"
                    continue
                row = band.measure(path)[-1]
                yield (width, number, row["inertial_number_min"] / number,
                       row["inertial_number_max"] / number, row["localised"], row["angle"],
                       row["width"])

    rows = study.write_table(Path(directory) / "regime.csv", {
        "width": "g", "I0": "g", "I_min_over_I0": ".3f", "I_max_over_I0": ".3f", "localised": "d",
        "angle": ".1f", "band_width": ".1f"}, rows())
    draw_regime(np.array([row[:5] for row in rows if len(row) > 5], dtype=float))


def draw_regime(rows):
    """Draw the map of ``rows`` (n, 5): L, I0, extremes of I over I0, localised."""
    parameters = cases.read({})
    law = parameters.part("law").of(parameters)
    with study.figure("regime", figsize=(6.5, 4.6)) as (figure, axes):
        axes.set(xscale="log", xlabel="$I^0$", ylabel="$L/d$", xlim=(7e-5, 0.14), ylim=(10, 90))
        for localised, marker, label in ((1, "s", "localised"), (0, "o", "not localised")):
            width, number, low, high, _ = rows[rows[:, 4] == localised].T
            image = axes.scatter(number, width, c=np.log10(high - low), s=90, marker=marker,
                                 vmin=-3.0, vmax=1.0, edgecolors="black", label=label)
        I0 = np.geomspace(1e-4, 0.0167, 400)
        k_cut = waves.cutoff(waves.Coefficients.of(law, "ngf", I0))
        axes.plot(I0, np.divide(2.0 * np.pi * parameters.A, k_cut, where=k_cut > 0.0,
                                out=np.full_like(I0, np.nan)), "k--", label=r"$2\pi/k_{cut}$")
        numbers, widths = np.geomspace(7e-5, 0.14, 32), np.linspace(12.0, 90.0, 20)
        rates = [[specimen.growth_rate(law, "ngf", inertial_number=number, width=width,
                                       height=3.0 * width, amplitude=parameters.A)
                  for number in numbers] for width in widths]
        lines = axes.contour(numbers, widths, rates, levels=LEVELS, colors="tab:red",
                             linewidths=0.8)
        axes.clabel(lines, fontsize=7, fmt=r"%g $\dot\gamma^0$")
        axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3)
        figure.colorbar(image, label="$\\log_{10}((I_{max} - I_{min})/I^0)$")
