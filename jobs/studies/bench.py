"""What do answers and steps cost? bench NAME [lists, see jobs/bench/*.sh]

    bench answer [element sizes: "2 1"] [sizes of tight runs: "2 1"]
    bench iterations [element sizes: "2 1 0.5"] [ranks: "1 2 3 4"]
    bench inertia [element sizes: "4 2 1"] [ranks: "1 2"]
    bench flows [element sizes: "1 0.5 0.25"] [ranks: "1 2"]
    bench size [element sizes: "2 1 0.5"] [ranks: "1 2 3 4"] [sizes of MUMPS: the same]
    bench weak [ranks: "1 2 4"]
    bench large [widths: "40 80 160"] [ranks: "1 2 4"]
    bench li [element sizes: "4 2"]
    bench guard

`answer` takes the main job to 10 % compression on two ranks, beside a run with tight tolerances.
`iterations` counts outer iterations to 1e-6 on the right-hand sides that Newton gives, in one step
from a state before, during and after localisation, every preconditioner fresh. `inertia` counts
them for the first system of steps of many sizes, with inertia and without. `flows` counts them in
the flows on fixed meshes, on the way to the steady flow, and in ten steps in time. `size` takes the
seconds of a Newton iteration and the peak memory in a step from the state at 10 %, by multigrid and
by MUMPS, with exponents over the sizes. `weak` makes thirty steps from rest with 4800 elements a
rank. `large` counts outer iterations to 1e-6 in the steps of a run after yielding, on elements of 4
d, while the specimen grows. `li` counts them for the local model before yielding and in flow, by
solvers that are not direct, and tells what spectrum they meet. `guard` gives one page of ratios
that do not depend on the machine. Tables go to results/bench; nothing else should run meanwhile.
"""

import json
import subprocess
from pathlib import Path

import numpy as np

from pgran.output import band
from pgran.output.result import Result
from pgran.runs import run_on_ranks
from pgran.runs.table import Table, result_file

BENCH = Path("results/bench")
FILE = "options/biaxial.opts"
#: Compressions of the states that steps start from: before, during and after localisation.
STATES = "0.003,0.018,0.03,0.05,0.10"
BEFORE, DURING, AFTER, LAST = 0, 1, 3, 4
#: The same for systems with inertia, on a mesh that the others divide: before yielding and in flow.
YIELDING, COARSE = {"before yielding": 0.0001, "in flow": 0.018}, 4
#: Sizes of the steps, 1/gdot0.
STEPS = "1e-8", "1e-7", "1e-6", "1e-5", "1e-4", "1e-3", "1e-2"
#: Flows on fixed meshes, and the options of each: graded meshes and even ones.
FLOWS = {"planar_shear, graded": ("planar_shear",), "vertical_chute": ("vertical_chute",),
         "vertical_chute, graded": ("vertical_chute", "-pgran_grading", 2),
         "annular_shear": ("annular_shear",),
         "inclined_plane": ("inclined_plane", "-pgran_grading", 1),
         "inclined_plane, graded": ("inclined_plane",)}
#: Ten steps in time. Without line search, because where the force of inertia is large it compares
#: norms that are rounded.
TEN = ("-ts_type", "beuler", "-pgran_start", "flow", "-ts_max_steps", 10,
       "-snes_linesearch_type", "basic", "-snes_atol", 1e-6)
KINDS = {"steady": (), "in time": TEN, "with inertia": (*TEN, "-pgran_inertia", "true")}
#: States of the local model, by compression.
LI = {"before yielding": 0.001, "at 0.3 %": 0.003, "at 1 %": 0.01}
SCHUR = ("-pc_type", "fieldsplit", "-pc_fieldsplit_type", "schur",
         "-pc_fieldsplit_schur_fact_type", "upper", "-fieldsplit_velocity_ksp_type", "preonly",
         "-fieldsplit_pressure_ksp_type", "preonly")
MASS = "-pc_fieldsplit_schur_precondition", "user", "-fieldsplit_pressure_pc_type", "lu"
VELOCITY_LU = ("-fieldsplit_velocity_pc_type", "lu",
               "-fieldsplit_velocity_pc_factor_mat_solver_type", "mumps")
OVERLAP = ("-pc_type", "asm", "-pc_asm_overlap", 4, "-sub_pc_type", "lu",
           "-sub_pc_factor_mat_solver_type", "mumps")
LI_STEP = 3e-4
#: Solvers of the local model: ranks and options.
ITERATIVE = {
    "velocity exact, M = mass over viscosity": (1, (*SCHUR, *MASS, *VELOCITY_LU)),
    "velocity exact, M = B diag^-1 B^T": (1, (
        *SCHUR, "-pc_fieldsplit_schur_precondition", "selfp", "-fieldsplit_pressure_pc_type", "lu",
        *VELOCITY_LU)),
    "velocity exact, least-squares commutator": (1, (
        *SCHUR, "-pc_fieldsplit_schur_precondition", "self", "-fieldsplit_pressure_pc_type", "lsc",
        "-fieldsplit_pressure_lsc_pc_type", "lu", *VELOCITY_LU)),
    "velocity by multigrid, ILU smooths": (1, (
        *SCHUR, *MASS, "-fieldsplit_velocity_pc_type", "mg",
        "-fieldsplit_velocity_pc_mg_galerkin", "both",
        "-fieldsplit_velocity_mg_levels_ksp_type", "richardson",
        "-fieldsplit_velocity_mg_levels_ksp_max_it", 1,
        "-fieldsplit_velocity_mg_levels_pc_type", "bjacobi",
        "-fieldsplit_velocity_mg_levels_sub_pc_type", "ilu",
        "-fieldsplit_velocity_mg_coarse_pc_type", "lu")),
    "LU on 2 overlapping parts": (2, OVERLAP), "LU on 4 overlapping parts": (4, OVERLAP)}
#: Compressions after yielding to which even the largest specimen is soon taken.
FLOWING = 0.0004, 0.0006
#: What makes a tight run.
TIGHT = ("-pgran_step_error", 0.01, "-snes_atol", 1e-7, "-ksp_rtol", 1e-4,
         "-pgran_tolerance_full_deviation", 0)
#: What solves every system to 1e-6, in one cycle of GMRES.
EXACT = "-ksp_rtol", 1e-6, "-ksp_max_it", 200, "-ksp_gmres_restart", 200
MUMPS = ("-dm_mat_type", "aij", "-ksp_type", "preonly", "-pc_type", "lu",
         "-pc_factor_mat_solver_type", "mumps")
#: Seconds that the main job may take, by element size.
TARGETS = {2.0: 20, 1.0: 90, 0.5: 360, 0.25: 1800}
#: Width and height, d, that give each rank 4800 elements of 1 d.
SHAPES = {1: (40, 120), 2: (40, 240), 4: (80, 240), 8: (80, 480), 16: (160, 480), 64: (320, 960),
          256: (640, 1920)}
#: Seconds after which a step is given up.
LIMIT = 1800


def step(ranks, name, *options, states=None):
    """Return what one step from the states costs, as `studies.one_step` says.

    ``states`` is the file that has them; without it, it is made.
    """
    if states is None:
        states = BENCH / "states.h5"
        run_on_ranks.run(states, FILE, "-pgran_snapshots", STATES, *run_on_ranks.QUIET)
    made = run_on_ranks.python(ranks, "-m", "studies.one_step", "-options_file", FILE,
                         *run_on_ranks.QUIET, *options, "-from", states, "-name", name,
                         stdout=subprocess.PIPE, text=True, timeout=LIMIT)
    return json.loads(made.stdout)


def exponents(unknowns, seconds, memory):
    """Return how cost grows with size: exponents of time, of its last two sizes, and of memory.

    Parameters
    ----------
    unknowns, seconds, memory : sequence, (n,)
        Over n > 2 sizes; memory in MB.

    Returns
    -------
    float, float, float, float
        The three exponents, and the memory (MB) without unknowns: where the line through the first
        two sizes begins. The exponent of memory is that of what exceeds it at the other sizes.
    """
    N, seconds, memory = (np.asarray(part, dtype=float) for part in (unknowns, seconds, memory))
    base = memory.min() - (memory[1] - memory[0]) * N[0] / (N[1] - N[0])
    time = np.polyfit(np.log(N), np.log(seconds), 1)[0]
    last = np.log(seconds[-1] / seconds[-2]) / np.log(N[-1] / N[-2])
    space = np.polyfit(np.log(N[1:]), np.log(memory[1:] - base), 1)[0]
    return time, last, space, base


def answer(sizes="2 1", tight="2 1", *, options=()):
    """The main job, and how far it is from runs with tight tolerances."""
    for size in tight.split():
        run_on_ranks.run(BENCH / f"tight_{size}.h5", FILE, *run_on_ranks.QUIET, *options,
                   "-pgran_element_size", size, *TIGHT, ranks=2)
    table = Table(BENCH / "answer.csv", {
        "element (d)": "", "target (s)": "d", "s": ".1f", "MB": ".0f", "steps": "d",
        "Newton": "d", "linear": "d", "I max": ".4e", "to tight (%)": "+.2f", "angle": ".1f",
        "width": ".1f", "tight (s)": ".0f"})
    for size in sizes.split():
        path, other = (BENCH / f"{name}_{size}.h5" for name in ("answer", "tight"))
        took = run_on_ranks.run(path, FILE, *run_on_ranks.QUIET, *options, "-pgran_element_size", size,
                          ranks=2).attributes
        row, I, off, spent = band.measure(path)[-1], largest(path), None, None
        if size in tight.split():
            off = 100 * (I / largest(other) - 1)
            spent = Result(other).attributes["seconds"]
        table.row(size, TARGETS.get(float(size)), *(took[name] for name in (
            "seconds", "memory", "steps", "newton_iterations", "linear_iterations")), I, off,
            row["angle"], row["width"], spent)


def largest(path):
    """Return the largest I at the Gauss points in the last step of a result file."""
    return Result(path).history["inertial_number_max"][-1]


def iterations(sizes="2 1 0.5", ranks="1 2 3 4", *, options=()):
    """Outer iterations over mesh, ranks and the stage of localisation: mean (most)."""
    table, means = Table(BENCH / "iterations.csv", {
        "element (d)": "", "unknowns": "d", "ranks": "", "before": "", "during": "",
        "after": ""}), []
    for size in sizes.split():
        for count in ranks.split():
            cells = []
            for state in (BEFORE, DURING, AFTER):
                found = step(count, state, *options, "-pgran_element_size", size, "-snapshot",
                             state, "-dt", 2e-4, *EXACT)
                counts = [row["iterations"] for row in found["newton"]]
                means.append(np.mean(counts))
                cells.append(f"{means[-1]:.1f} ({max(counts)})")
            table.row(size, found["unknowns"], count, *cells)
    print(f"means from {min(means):.1f} to {max(means):.1f}: ratio {max(means) / min(means):.2f}")


def inertia(sizes="4 2 1", ranks="1 2", *, options=()):
    """Outer iterations over the size of the step, mesh and ranks: with inertia (without)."""
    states = BENCH / "yielding.h5"
    run_on_ranks.run(states, FILE, "-pgran_snapshots", ",".join(map(str, YIELDING.values())),
               "-pgran_compression", max(YIELDING.values()), "-pgran_element_size", COARSE,
               *run_on_ranks.QUIET)
    table = Table(BENCH / "inertia.csv", {"state": "", "element (d)": "", "ranks": "",
                                          **{f"dt = {dt}": "" for dt in STEPS}})

    def counts(size, count, number, inertia):
        made = run_on_ranks.python(
            count, "-m", "studies.systems", "-options_file", FILE, *EXACT,
            *options, "-pgran_element_size", size, "-pgran_inertia", inertia, "-from", states,
            "-snapshot", number, "-dt", ",".join(STEPS), stdout=subprocess.PIPE, text=True,
            timeout=LIMIT)
        return ["-" if found is None else str(found) for found in json.loads(made.stdout)]

    for number, state in enumerate(YIELDING):
        for size in sizes.split():
            for count in ranks.split():
                both = (counts(size, count, number, inertia) for inertia in ("true", "false"))
                table.row(state, size, count, *(f"{on} ({off})" for on, off in zip(*both)))


def flows(sizes="1 0.5 0.25", ranks="1 2", *, options=()):
    """Outer iterations of a system in the flows on fixed meshes: mean of all steps (most)."""
    table = Table(BENCH / "flows.csv", {"flow": "", "element (d)": "", "ranks": "",
                                        **dict.fromkeys(KINDS, "")})
    for flow, (name, *more) in FLOWS.items():
        for size in sizes.split():
            for count in ranks.split():
                cells = []
                for kind, these in KINDS.items():
                    path = result_file(BENCH, f"{flow} {size} {count} {kind}")
                    made = run_on_ranks.run(
                        path, f"options/{name}.opts", "-options_file", "options/flows_mg.opts",
                        *run_on_ranks.QUIET, *more, *these, *options, "-pgran_element_size", size,
                        ranks=int(count), needed=False)
                    cells.append(None if made is None else per_system(made))
                table.row(flow, size, count, *cells)


def per_system(result):
    """Return the linear iterations of a Newton iteration of a run, "mean (most)"."""
    newton, linear = (result.history[f"{name}_iterations"] for name in ("newton", "linear"))
    return f"{linear.sum() / newton.sum():.1f} ({(linear / newton).max():.0f})"


def size(sizes="2 1 0.5", ranks="1 2 3 4", mumps=None, *, options=()):
    """Cost of a step against size and ranks, of multigrid and of MUMPS."""
    table = Table(BENCH / "size.csv", {
        "solver": "", "ranks": "d", "element (d)": "g", "unknowns": "d", "Newton": "d",
        "linear": "d", "step (s)": ".2f", "a Newton iteration (s)": ".3f", "a Jacobian (s)": ".3f",
        "MB a rank": ".0f"})
    plan = [("multigrid", count, sizes, ()) for count in ranks.split()] + [
        ("mumps", count, sizes if mumps is None else mumps, MUMPS) for count in ("1", "2")]
    lines = []
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
            time, last, space, base = exponents(*zip(*rows))
            lines.append(f"{solver}, {count} ranks: time of a Newton iteration ~ N^{time:.2f} "
                         f"(last two sizes {last:.2f}), memory beyond {base:.0f} MB ~ "
                         f"N^{space:.2f}")
    print(*lines, sep="\n")


def weak(ranks="1 2 4", *, options=()):
    """Weak scaling: where there are fewer cores than ranks the iterations say more than seconds."""
    table = Table(BENCH / "weak.csv", {
        "ranks": "d", "L x H (d)": "", "Newton": "d", "linear a Newton iteration": ".1f",
        "s a Newton iteration": ".3f", "MB a rank": ".0f"})
    for count in map(int, ranks.split()):
        width, height = SHAPES[count]
        took = run_on_ranks.run(BENCH / f"weak_{count}.h5", FILE, *run_on_ranks.QUIET, *options,
                          "-pgran_width", width, "-pgran_height", height, "-pgran_element_size", 1,
                          "-ts_max_steps", 30, *EXACT, ranks=count).attributes
        newton = took["newton_iterations"]
        table.row(took["ranks"], f"{width} x {height}", newton, took["linear_iterations"] / newton,
                  took["seconds"] / newton, took["memory"] / took["ranks"])


def large(widths="40 80 160", ranks="1 2 4", *, options=()):
    """Iterations and memory while the specimen grows, on elements of 4 d.

    A run with options/large.opts yields and flows. From two of its states the first system of a
    step, as large as the last free one of the run, is solved to 1e-6.
    """
    solvers = {"biaxial.opts": (), "large.opts": ("-options_file", "options/large.opts")}
    table = Table(BENCH / "large.csv", {
        "L x H (d)": "", "elements": "d", "ranks": "", "MB a rank": ".0f",
        "linear a Newton iteration": ".1f", **{
            f"{100 * flow:g} %, {what}": "" for flow in FLOWING for what in ("dt", *solvers)}})
    for width in map(int, widths.split()):
        path = BENCH / f"large_{width}.h5"
        shape = "-pgran_width", width, "-pgran_height", 3 * width, "-pgran_element_size", COARSE
        run = run_on_ranks.run(
            path, FILE, "-options_file", "options/large.opts", *run_on_ranks.QUIET, *options, *shape,
            "-pgran_compression", FLOWING[-1], "-pgran_snapshots", ",".join(map(str, FLOWING)),
            ranks=2)
        took, times, sizes = run.attributes, run.history["compression"], run.history["step_size"]
        for count in ranks.split():
            cells = []
            for number, flow in enumerate(FLOWING):
                landed = np.argmin(np.abs(times - flow))
                dt = sizes[landed - 2:landed + 1].max()  # the last steps are cut to land
                cells.append(f"{dt:.1e}")
                for more in solvers.values():
                    made = run_on_ranks.python(
                        count, "-m", "studies.systems", "-options_file", FILE, *more, *EXACT,
                        *shape, *options, "-from", path, "-snapshot", number, "-dt", dt,
                        stdout=subprocess.PIPE, text=True, timeout=LIMIT)
                    its, = json.loads(made.stdout)
                    cells.append("-" if its is None else str(its))
            table.row(f"{width} x {3 * width}", 3 * width**2 // COARSE**2, count,
                      took["memory"] / 2, took["linear_iterations"] / took["newton_iterations"],
                      *cells)


def li(sizes="4 2", *, options=()):
    """Outer iterations to 1e-6 for the local model, and the spectrum that one solver meets."""
    states, file = BENCH / "li.h5", "options/li.opts"
    run_on_ranks.run(states, file, "-pgran_snapshots", ",".join(map(str, LI.values())), *options,
               "-pgran_element_size", COARSE, *run_on_ranks.QUIET)
    columns = {"element (d)": "", **dict.fromkeys(LI, "")}

    def made(module, ranks, size, number, *more):
        answer = run_on_ranks.python(
            ranks, "-m", f"studies.{module}", "-options_file", file, "-ksp_type", "fgmres",
            *EXACT, *more, *options, "-pgran_element_size", size, "-from", states, "-snapshot",
            number, "-dt", LI_STEP, stdout=subprocess.PIPE, text=True, timeout=LIMIT)
        return json.loads(answer.stdout)

    table = Table(BENCH / "li.csv", {"solver": "", **columns})
    for solver, (ranks, these) in ITERATIVE.items():
        for size in sizes.split():
            counts = (made("systems", ranks, size, number, *these)[0] for number in range(len(LI)))
            table.row(solver, size, *(None if count is None else str(count) for count in counts))
    table = Table(BENCH / "li_spectrum.csv", columns)
    _, these = next(iter(ITERATIVE.values()))
    for size in sizes.split():
        spectra = (made("schur_spectrum", 1, size, number, *these) for number in range(len(LI)))
        table.row(size, *(f"{found['nearest']:.2g} ({100 * found['negative']:.1f} %)"
                          for found in spectra))


def guard(*, options=()):
    """One page of ratios: assembly and solution to compiled code, iterations, bytes an unknown."""
    table = Table(BENCH / "guard.csv", {"what": "", "value": ".2f"})
    states = BENCH / "guard.h5"
    states.unlink(missing_ok=True)  # what it took is to be measured
    took = run_on_ranks.run(states, FILE, "-pgran_snapshots", STATES, *run_on_ranks.QUIET, *options,
                      ranks=2).attributes
    steps, newton = took["steps"], took["newton_iterations"]
    table.row("steps", steps)
    table.row("steps repeated", took["steps_repeated"])
    table.row("Newton iterations a step", newton / steps)
    table.row("linear iterations a Newton iteration", took["linear_iterations"] / newton)

    def made(size, *more):
        return step(2, "guard", *options, "-pgran_element_size", size, "-snapshot", AFTER, "-dt",
                    2e-4, *more, states=states)

    small, large = made(2), made(1)
    table.row("outer iterations to 1e-6 at d", np.mean([
        row["iterations"] for row in made(1, *EXACT)["newton"]]))
    table.row("bytes an unknown", 2**20 * (large["memory_sum"] - small["memory_sum"])
              / (large["unknowns"] - small["unknowns"]))
    answer = run_on_ranks.python(1, "jobs/bench/compiled.py", "-options_file", FILE, *run_on_ranks.QUIET,
                         *options, "-pgran_element_size", 1, "-from", states,
                         "-snapshot", AFTER, "-dt", 2e-4, "-json", check=False,
                         stdout=subprocess.PIPE, text=True, timeout=LIMIT)
    found = json.loads(answer.stdout) if answer.returncode == 0 else {}  # without dolfinx: dashes
    for name, what in (("jacobian", "Jacobian"), ("residual", "residual"),
                       ("newton", "Newton iteration")):
        table.row(f"{what} to compiled code, d, one rank", found.get(name))
    job = took["seconds"] / found["compiled"] if found else None
    table.row("job at 2 d on two ranks to one compiled Jacobian and MUMPS at d", job)


BENCHES = {"answer": answer, "iterations": iterations, "inertia": inertia, "flows": flows,
           "size": size, "weak": weak, "large": large, "li": li, "guard": guard}


def main(bench, *lists, options=()):
    """Make one bench."""
    if bench not in BENCHES:
        raise ValueError(f"{bench}: allowed is {' | '.join(BENCHES)}")
    BENCHES[bench](*lists, options=options)
