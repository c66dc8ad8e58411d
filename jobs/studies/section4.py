"""Runs of plane-strain compression as in section 4 of the paper, and comparisons of meshes."""

import os
from pathlib import Path

from pgran.output import band

from . import study
from .study import COST, cost

RESULTS = Path(os.environ.get("PGRAN_RESULTS", "results/section4"))
FIGURES = "fig3", "fig4", "fig5", "fig6", "fig7"
#: Width (d), I0 and element size (d) of the NGF runs, as in the names of their files.
RUNS = {"fig3": [("40", "0.001", "0.5")],
        "fig4": [(width, "0.001", "0.5") for width in ("20", "40", "60")],
        "fig5": [("40", I0, "0.5") for I0 in ("0.001", "0.007", "0.03")]}
MESHES = {"over L2 norm (%)": ".2f", "over maximum (%)": ".2f"}


def section4(figure=None, sizes="2 1 0.5", *, options=()):
    """Figures 3 to 7 of the paper: section4 [fig3 ... fig7] [element sizes]

    All figures unless one is named. Element sizes, d, apply to figures 6 and 7. The tables contain
    the band and the cost of each run. Results go to PGRAN_RESULTS (results/section4); figures share
    runs. Half an hour on two cores; elements of d/4 need another half hour.
    """
    if figure not in (None, *FIGURES):
        raise ValueError(f"unknown figure {figure}; expected one of: {', '.join(FIGURES)}")
    for name in [figure] if figure else FIGURES:
        results = runs(name, sizes.split(), options)
        columns = {"run": "", "compression (%)": "g", "I from": ".1e", "I to": ".3e",
                   "localised": "", "angle (degrees)": "+.1f", "width (d)": ".1f", "bands": "d",
                   **COST}
        study.write_table(RESULTS / f"section4_{name}.csv", columns, band_rows(name, results))
        if name in ("fig6", "fig7"):
            study.write_table(RESULTS / f"section4_{name}_meshes.csv",
                              {"from (d)": "", "to (d)": "", **MESHES, "order": ".2f"},
                              mesh_rows(sizes.split(), results))
        study.paper_figures([name], RESULTS)


def runs(figure, sizes, options=()):
    """Run the simulations of a figure; return {name: `pgran.output.result.Result`}."""
    results = {}
    if figure == "fig7":
        for size in sizes:
            name = f"li_L40_I0.001_h{size}"
            results[name] = study.run(RESULTS / f"{name}.h5", "li", *options,
                                      "-pgran_element_size", size)
        return results
    for point in RUNS.get(figure) or [("40", "0.001", size) for size in sizes]:
        width, I0, size = point
        # Figures 4 to 6 share the run of figure 3, which ends at 14 %.
        end, at = ("0.14", "0.05,0.10,0.14") if point in RUNS["fig3"] else ("0.10", "0.05,0.10")
        name = f"ngf_L{width}_I{I0}_h{size}"
        results[name] = study.run(
            RESULTS / f"{name}.h5", "biaxial", *options, "-pgran_width", width,
            "-pgran_inertial_number", I0, "-pgran_element_size", size, "-pgran_compression", end,
            "-pgran_snapshots", at)
    return results


def band_rows(figure, results):
    """Yield the band of each snapshot of figure 3, and at 10 % (NGF) or 1 % (LI) of the others."""
    for name, result in results.items():
        for row in band.measure(result.path):
            if figure in ("fig3", "fig7") or abs(row["compression"] - 0.10) < 1e-6:
                local = name.startswith("li")  # many bands, in both directions
                yield (name, 100 * row["compression"], row["inertial_number_min"],
                       row["inertial_number_max"], "yes" if row["localised"] else "no",
                       *[None if local else row[key] for key in ("angle", "width", "bands")],
                       *cost(result))


def mesh_rows(sizes, results):
    """Yield the differences of I between successive meshes at the compression of the figure."""
    fields = []
    for result in results.values():
        rows = band.measure(result.path)
        number = next((k for k, row in enumerate(rows) if abs(row["compression"] - 0.10) < 1e-6),
                      len(rows) - 1)
        snapshot, angle = result.snapshots[number], rows[number]["angle"]
        step = -1 if result.options["model"] != "li" and (angle or 0.0) < 0.0 else 1
        fields.append((snapshot.x[:, ::step], snapshot["inertial_number"][:, ::step]))
    for coarse, fine, row in zip(sizes, sizes[1:], band.mesh_differences(fields)):
        yield coarse, fine, 100 * row["l2"], 100 * row["maximum"], row["order"]


def compared(points, directory, options):
    """Run each point on all meshes; yield name, sizes, result, and difference of meshes."""
    for name, file, varied, sizes in points:
        paths = []
        for number, size in enumerate(sizes.split()):
            path = Path(directory) / f"{name}_square_h{size}.h5"
            result = study.run(path, file, *options, *varied, "-pgran_imperfection_size", 2,
                               "-pgran_element_size", size, needed=False)
            paths += [path] if result else []
            found = band.compare(paths)[-1] if result and len(paths) > 1 else {}
            yield name, sizes.split()[max(0, number - 1):number + 1], result, found


def meshes(ngf="2 1 0.5", li="2 1 0.5", *, options=()):
    """Mesh convergence with an imperfection of fixed size: meshes [sizes: NGF] [sizes: LI]

    The imperfection is a square of side 2 d on all meshes. The table contains the differences of I
    between successive meshes, and the cost of the finer run. Fifteen minutes on two cores.
    """
    points = ("ngf", "biaxial", (), ngf), ("li", "li", (), li)
    rows = ((name, *sizes, 100 * found["l2"], 100 * found["maximum"], found["order"],
             *cost(result)) for name, sizes, result, found in compared(points, RESULTS, options)
            if found)
    study.write_table(RESULTS / "meshes.csv", {"model": "", "from (d)": "", "to (d)": "", **MESHES,
                                               "order": ".2f", **COST}, rows)


def posed(sizes="2 1 0.5", compression="0.01", directory="results/posed", *, options=()):
    """Mesh dependence of LI with a well-posed law: posed [sizes] [compression] [directory]

    LI with the law of Bingham, which is ill-posed at I0 = 0.001, and with the well-posed law of
    Barker and Gray. The imperfection has a side of 2 d. The table contains the range of I, the
    number of bands (I > I0) across the vertical line at L/4, and the difference of I from the
    previous mesh. Ten minutes on two cores.
    """
    points = [(law, "li", ("-pgran_law", law), sizes) for law in ("bingham", "barker_gray")]
    options = (*options, "-pgran_compression", compression, "-pgran_snapshots", compression)

    def rows():
        for law, pair, result, difference in compared(points, directory, options):
            if result is None:
                yield law, pair[-1], "run failed"
                continue
            found = band.measure(result.path)[-1]
            I = result.snapshots[-1]["inertial_number"]
            yield (law, pair[-1], found["inertial_number_min"], found["inertial_number_max"],
                   "yes" if found["localised"] else "no",
                   band.stretches(I[:, I.shape[1] // 4] > result.options["inertial_number"]),
                   *(100 * difference[key] if difference else None for key in ("l2", "maximum")),
                   *cost(result))

    study.write_table(Path(directory) / "posed.csv", {
        "law": "", "element (d)": "", "I from": ".3e", "I to": ".3e", "localised": "",
        "bands": "d", **MESHES, **COST}, rows())
