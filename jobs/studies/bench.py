"""Cost of runs, steps and linear systems: bench NAME [lists]

    bench reference [element sizes: "2 1"] [sizes of strict runs: "2 1"]
    bench iterations [element sizes: "2 1 0.5"] [ranks: "1 2 3 4"]
    bench inertia [element sizes: "4 2 1"] [ranks: "1 2"]
    bench flows [element sizes: "1 0.5 0.25"] [ranks: "1 2"]
    bench size [element sizes: "2 1 0.5"] [ranks: "1 2 3 4"] [sizes of MUMPS: the same]
    bench large [widths: "40 80 160"] [ranks: "1 2 4"]
    bench guard
    bench compiled [element sizes on one and two ranks: "1 0.5"]

`reference` runs the reference simulation to 10 % compression on two ranks, with default and with
strict tolerances. `iterations` counts outer iterations to 1e-6 in one step, at three stages of
localisation. `inertia` counts them for the first system of steps of many sizes, with inertia and
without. `flows` counts them in the flows on fixed meshes, in pseudo-time and in ten time steps.
`size` has seconds per Newton iteration and peak memory of a step from 10 %, by multigrid and by
MUMPS. `large` counts iterations after yielding on elements of 4 d while the specimen grows. `guard`
has ratios that do not depend on the machine. Nothing else should run on the machine.
"""

import json
import subprocess
from itertools import product
from pathlib import Path

import numpy as np

from pgran.output import band
from pgran.output.result import Result
from pgran.runs import run_on_ranks
from pgran.runs.table import result_file

from .study import Report, run, write_text

BENCH = Path("results/bench")
MULTIGRID = "options/solver_mg_fixed.opts"
FILE = "options/biaxial.opts"
#: Compressions of the initial states: before, during and after localisation.
STATES = "0.003,0.018,0.03,0.05,0.10"
BEFORE, DURING, AFTER, LAST = 0, 1, 3, 4
#: States of systems with inertia, on elements of `COARSE`: before yielding and in flow.
YIELDING, COARSE = {"before yielding": 0.0001, "in flow": 0.018}, 4
#: Sizes of the steps, 1/gdot0.
STEPS = "1e-8", "1e-7", "1e-6", "1e-5", "1e-4", "1e-3", "1e-2"
#: Flows on fixed meshes and their options: graded and uniform meshes.
FLOWS = {"planar_shear, graded": ("planar_shear",), "vertical_chute": ("vertical_chute",),
         "vertical_chute, graded": ("vertical_chute", "-pgran_grading", 2),
         "annular_shear": ("annular_shear",),
         "inclined_plane": ("inclined_plane", "-pgran_grading", 1),
         "inclined_plane, graded": ("inclined_plane",)}
#: Ten time steps, without line search: where inertia is large it compares rounding errors.
TEN = ("-ts_type", "beuler", "-pgran_start", "flow", "-ts_max_steps", 10,
       "-snes_linesearch_type", "basic", "-snes_atol", 1e-6)
KINDS = {"steady": (), "in time": TEN, "with inertia": (*TEN, "-pgran_inertia", "true")}
#: Compressions soon after yielding.
FLOWING = 0.0004, 0.0006
#: Strict tolerances.
STRICT = ("-pgran_step_error", 0.01, "-snes_atol", 1e-7, "-ksp_rtol", 1e-4,
         "-pgran_tolerance_full_deviation", 0)
#: Every system to 1e-6, in one cycle of GMRES.
EXACT = "-ksp_rtol", 1e-6, "-ksp_max_it", 200, "-ksp_gmres_restart", 200
MUMPS = ("-dm_mat_type", "aij", "-ksp_type", "preonly", "-pc_type", "lu",
         "-pc_factor_mat_solver_type", "mumps")
#: Time limit of a step, s.
LIMIT = 1800

ALL = [("reference",), ("iterations",), ("inertia",), ("flows",), ("size",), ("large",), ("guard",),
       ("compiled",)]


def measure(ranks, *arguments, file=FILE, check=True):
    """Return the JSON that `studies.one_step`, or a script, prints on ranks."""
    made = run_on_ranks.python(ranks, *arguments[:2], "-options_file", file, *run_on_ranks.QUIET,
                               *arguments[2:], stdout=subprocess.PIPE, text=True, timeout=LIMIT,
                               check=check)
    return json.loads(made.stdout) if made.returncode == 0 else {}


def step(ranks, name, *options, states=None):
    """Return the cost of one step from the file ``states``, as `studies.one_step` prints it.

    Without ``states`` the file is made.
    """
    if states is None:
        states = BENCH / "states.h5"
        run(states, "biaxial", "-pgran_snapshots", STATES)
    return measure(ranks, "-m", "studies.one_step", *options, "-from", states, "-name", name)


def systems(ranks, *options, file=FILE):
    """Return the iterations of first systems as texts, a dash where the solver failed."""
    found = measure(ranks, "-m", "studies.one_step", "-measure", "system", *options, file=file)
    return ["-" if count is None else str(count) for count in found]


def exponents(unknowns, seconds, memory):
    """Return exponents of time and of memory, MB, over sizes, and the memory without unknowns.

    The exponent of memory refers to the excess over the memory without unknowns, which is where the
    line through the first two sizes begins. All arguments are sequences (n,).
    """
    N, seconds, memory = (np.asarray(part, dtype=float) for part in (unknowns, seconds, memory))
    base = memory.min() - (memory[1] - memory[0]) * N[0] / (N[1] - N[0])
    time = np.polyfit(np.log(N), np.log(seconds), 1)[0]
    return time, np.polyfit(np.log(N[1:]), np.log(memory[1:] - base), 1)[0], base


def report(name, columns):
    """Return the `Report` of a bench."""
    return Report(BENCH / f"{name}.csv", columns, f"bench_{name}")


def reference(sizes="2 1", strict="2 1", *, options=()):
    """Time and result of the reference simulation, compared with strict tolerances."""
    table = report("reference", {
        "element (d)": "", "s": ".1f", "MB": ".0f", "steps": "d", "Newton": "d", "linear": "d",
        "I max": ".4e", "difference from strict (%)": "+.2f", "angle": ".1f", "width": ".1f"})
    for size in sizes.split():
        path, exact, off = BENCH / f"reference_{size}.h5", BENCH / f"strict_{size}.h5", None
        if size in strict.split():
            run(exact, "biaxial", *options, "-pgran_element_size", size, *STRICT, ranks=2)
        took = run(path, "biaxial", *options, "-pgran_element_size", size, ranks=2).attributes
        row, I = band.measure(path)[-1], largest(path)
        if size in strict.split():
            off = 100 * (I / largest(exact) - 1)
        table.row(size, *(took[name] for name in (
            "seconds", "memory", "steps", "newton_iterations", "linear_iterations")), I, off,
            row["angle"], row["width"])


def largest(path):
    """Return the largest I at the Gauss points in the last step of a result file."""
    return Result(path).history["inertial_number_max"][-1]


def iterations(sizes="2 1 0.5", ranks="1 2 3 4", *, options=()):
    """Outer iterations over mesh, ranks and stage of localisation: mean (maximum)."""
    table, means = report("iterations", {
        "element (d)": "", "unknowns": "d", "ranks": "", "before": "", "during": "",
        "after": ""}), []
    for size, count in product(sizes.split(), ranks.split()):
        cells = []
        for state in (BEFORE, DURING, AFTER):
            found = step(count, state, *options, "-pgran_element_size", size, "-snapshot", state,
                         "-dt", 2e-4, *EXACT)
            counts = [row["iterations"] for row in found["newton"]]
            means.append(np.mean(counts))
            cells.append(f"{means[-1]:.1f} ({max(counts)})")
        table.row(size, found["unknowns"], count, *cells)
    print(f"means from {min(means):.1f} to {max(means):.1f}: ratio {max(means) / min(means):.2f}")


def inertia(sizes="4 2 1", ranks="1 2", *, options=()):
    """Outer iterations over step size, mesh and ranks: with inertia (without)."""
    states = BENCH / "yielding.h5"
    run(states, "biaxial", "-pgran_snapshots", ",".join(map(str, YIELDING.values())),
        "-pgran_compression", max(YIELDING.values()), "-pgran_element_size", COARSE)
    table = report("inertia", {"state": "", "element (d)": "", "ranks": "",
                               **{f"dt = {dt}": "" for dt in STEPS}})
    for (number, state), size, count in product(enumerate(YIELDING), sizes.split(), ranks.split()):
        both = (systems(count, *EXACT, *options, "-pgran_element_size", size, "-pgran_inertia",
                        inertia, "-from", states, "-snapshot", number, "-dt", ",".join(STEPS))
                for inertia in ("true", "false"))
        table.row(state, size, count, *(f"{on} ({off})" for on, off in zip(*both)))


def flows(sizes="1 0.5 0.25", ranks="1 2", *, options=()):
    """Outer iterations per system in the flows on fixed meshes: mean of all steps (maximum)."""
    columns = dict.fromkeys(("flow", "element (d)", "ranks", *KINDS), "")
    table = report("flows", columns)
    for (flow, (name, *more)), size, count in product(FLOWS.items(), sizes.split(), ranks.split()):
        cells = []
        for kind, these in KINDS.items():
            path = result_file(BENCH, f"{flow} {size} {count} {kind}")
            made = run(path, name, "-options_file", MULTIGRID, *more, *these, *options,
                       "-pgran_element_size", size, ranks=int(count), needed=False)
            cells.append(None if made is None else per_system(made))
        table.row(flow, size, count, *cells)


def per_system(result):
    """Return the linear iterations per Newton iteration of a run, "mean (maximum)"."""
    newton, linear = (result.history[f"{name}_iterations"] for name in ("newton", "linear"))
    return f"{linear.sum() / newton.sum():.1f} ({(linear / newton).max():.0f})"


def size(sizes="2 1 0.5", ranks="1 2 3 4", mumps=None, *, options=()):
    """Cost of a step over size and ranks, of multigrid and of MUMPS."""
    table = report("size", {
        "solver": "", "ranks": "d", "element (d)": "g", "unknowns": "d", "Newton": "d",
        "linear": "d", "s per step": ".2f", "s per Newton iteration": ".3f",
        "s per Jacobian": ".3f", "MB per rank": ".0f"})
    plan = [("multigrid", count, sizes, ()) for count in ranks.split()] + [
        ("mumps", count, sizes if mumps is None else mumps, MUMPS) for count in ("1", "2")]
    for solver, count, many, more in plan:
        rows = []
        for side in many.split():
            found = step(count, solver, *options, "-pgran_element_size", side, "-snapshot", LAST,
                         "-dt", 3e-4, *more)
            newton = found["newton"]
            seconds, jacobian = (np.mean([row[key] for row in newton])
                                 for key in ("seconds", "jacobian"))
            rows.append((found["unknowns"], seconds, found["memory"]))
            table.row(solver, found["ranks"], found["element_size"], found["unknowns"],
                      len(newton), sum(row["iterations"] for row in newton),
                      len(newton) * seconds, seconds, jacobian, found["memory"])
        if len(rows) > 2:
            time, memory, base = exponents(*zip(*rows))
            print(f"{solver}, {count} ranks: time per Newton iteration ~ N^{time:.2f}, memory "
                  f"beyond {base:.0f} MB ~ N^{memory:.2f}")


def large(widths="40 80 160", ranks="1 2 4", *, options=()):
    """Iterations and memory while the specimen grows, on elements of 4 d.

    A run with options/large.opts yields and flows. From two of its states the first system of a
    step, as large as the last free one of the run, is solved to 1e-6.
    """
    solvers = {"biaxial.opts": (), "large.opts": ("-options_file", "options/large.opts")}
    table = report("large", {
        "L x H (d)": "", "elements": "d", "ranks": "", "MB per rank": ".0f",
        "linear per Newton": ".1f", **{
            f"{100 * flow:g} %, {what}": "" for flow in FLOWING for what in ("dt", *solvers)}})
    for width in map(int, widths.split()):
        path = BENCH / f"large_{width}.h5"
        shape = "-pgran_width", width, "-pgran_height", 3 * width, "-pgran_element_size", COARSE
        made = run(path, "biaxial", *solvers["large.opts"], *options, *shape, "-pgran_compression",
                   FLOWING[-1], "-pgran_snapshots", ",".join(map(str, FLOWING)), ranks=2)
        took, times, sizes = made.attributes, made.history["compression"], made.history["step_size"]
        for count in ranks.split():
            cells = []
            for number, flow in enumerate(FLOWING):
                landed = np.argmin(np.abs(times - flow))
                dt = sizes[landed - 2:landed + 1].max()  # the last steps are reduced to land
                cells += [f"{dt:.1e}", *(systems(count, *more, *EXACT, *shape, *options, "-from",
                                                 path, "-snapshot", number, "-dt", dt)[0]
                                         for more in solvers.values())]
            table.row(f"{width} x {3 * width}", 3 * width**2 // COARSE**2, count,
                      took["memory"] / 2, took["linear_iterations"] / took["newton_iterations"],
                      *cells)


def guard(*, options=()):
    """Ratios: assembly and solution relative to compiled code, iterations, bytes per unknown."""
    table = report("guard", {"quantity": "", "value": ".2f"})
    states = BENCH / "guard.h5"
    states.unlink(missing_ok=True)  # its cost is measured
    took = run(states, "biaxial", "-pgran_snapshots", STATES, *options, ranks=2).attributes
    steps, newton = took["steps"], took["newton_iterations"]
    table.row("steps", steps)
    table.row("steps repeated", took["steps_repeated"])
    table.row("Newton iterations per step", newton / steps)
    table.row("linear iterations per Newton iteration", took["linear_iterations"] / newton)

    def made(size, *more):
        return step(2, "guard", *options, "-pgran_element_size", size, "-snapshot", AFTER, "-dt",
                    2e-4, *more, states=states)

    small, large = made(2), made(1)
    table.row("outer iterations to 1e-6 at d", np.mean([
        row["iterations"] for row in made(1, *EXACT)["newton"]]))
    table.row("bytes per unknown", 2**20 * (large["memory_sum"] - small["memory_sum"])
              / (large["unknowns"] - small["unknowns"]))
    # Without dolfinx the ratios are dashes.
    found = measure(1, "jobs/bench/compiled.py", "-json", *options, "-pgran_element_size", 1,
                    "-from", states, "-snapshot", AFTER, "-dt", 2e-4, check=False)
    for name, quantity in (("jacobian", "Jacobian"), ("residual", "residual"),
                           ("newton", "Newton iteration")):
        table.row(f"{quantity} relative to compiled code, d, one rank", found.get(name))
    table.row("run at 2 d on two ranks relative to one compiled Jacobian and MUMPS at d",
              took["seconds"] / found["compiled"] if found else None)


def compiled(sizes="1 0.5", *, options=()):
    """Assembly and a Newton iteration relative to compiled code, on one and two ranks."""
    states, texts = BENCH / "states.h5", []
    run(states, "biaxial", "-pgran_snapshots", STATES)
    for ranks, size in enumerate(sizes.split(), 1):
        texts.append(run_on_ranks.python(
            ranks, "jobs/bench/compiled.py", "-options_file", FILE, *run_on_ranks.QUIET, *options,
            "-pgran_element_size", size, "-from", states, "-snapshot", LAST, "-dt", 3e-4,
            stdout=subprocess.PIPE, text=True).stdout)
    write_text("bench_compiled", "\n".join(texts))


def main(bench, *lists, options=()):
    """Run one bench."""
    if (bench,) not in ALL:
        raise ValueError(f"{bench}: expected one of: {', '.join(name for name, in ALL)}")
    globals()[bench](*lists, options=options)
