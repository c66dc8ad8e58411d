"""Performance: cost of runs, steps and linear systems."""

import subprocess
from pathlib import Path

import numpy as np

from pgran.output import band

from . import study
from .study import result_file

BENCH = Path("results/bench")
#: Compressions of the snapshots: before, during and after localisation.
STATES = "0.003,0.018,0.03,0.05,0.10"
BEFORE, DURING, AFTER, LAST = 0, 1, 3, 4
#: Compressions of the snapshots for inertia, and their element size (d), a multiple of the others.
YIELDING, COARSE = {"before yielding": 0.0001, "in flow": 0.018}, 4
#: Time steps, 1/gdot0.
STEPS = "1e-8", "1e-7", "1e-6", "1e-5", "1e-4", "1e-3", "1e-2"
#: Flows on frozen meshes, and their options.
FLOWS = {"planar_shear, graded": ("planar_shear",), "vertical_chute": ("vertical_chute",),
         "vertical_chute, graded": ("vertical_chute", "-pgran_grading", 2),
         "annular_shear": ("annular_shear",),
         "inclined_plane": ("inclined_plane", "-pgran_grading", 1),
         "inclined_plane, graded": ("inclined_plane",)}
#: Ten time steps, without line search, which would compare norms dominated by rounding errors.
TEN = ("-ts_type", "beuler", "-pgran_start", "flow", "-ts_max_steps", 10,
       "-snes_linesearch_type", "basic", "-snes_atol", 1e-6)
KINDS = {"steady": (), "in time": TEN, "with inertia": (*TEN, "-pgran_inertia", "true")}
STRICT = ("-pgran_step_error", 0.01, "-snes_atol", 1e-7, "-ksp_rtol", 1e-4,
          "-pgran_tolerance_full_deviation", 0)
#: Linear systems solved to 1e-6, in one cycle of GMRES.
EXACT = "-ksp_rtol", 1e-6, "-ksp_max_it", 200, "-ksp_gmres_restart", 200
MUMPS = ("-dm_mat_type", "aij", "-ksp_type", "preonly", "-pc_type", "lu",
         "-pc_factor_mat_solver_type", "mumps")
#: Time limit of a step, s.
LIMIT = 1800


def measure(ranks, module, *options):
    """Return the JSON of a command of this package on ranks."""
    return study.json_of(ranks, f"studies.{module}", "-options_file", "options/biaxial.opts",
                         *options, timeout=LIMIT)


def snapshots(name, *options, ranks=None):
    """Run the reference simulation with snapshots, and return its result."""
    return study.run(BENCH / f"{name}.h5", "biaxial", "-pgran_snapshots", STATES, *options,
                     ranks=ranks)


def step(ranks, snapshot, *options, states=None):
    """Return the cost of one step from a snapshot; see `studies.one_step`."""
    states = states or snapshots("states").path
    return measure(ranks, "one_step", *study.QUIET, *options, "-from", states, "-snapshot",
                   snapshot)


def answer(sizes="2 1", strict="2 1", *, options=()):
    """Run time of the reference simulation on two ranks, and its difference from strict runs."""
    columns = {"element (d)": "", "s": ".1f", "MB": ".0f", "steps": "d", "Newton": "d",
               "linear": "d", "I max": ".4e", "to strict (%)": "+.2f", "angle": ".1f",
               "width": ".1f", "strict run (s)": ".0f"}

    def rows():
        for size in sizes.split():
            more = (*options, "-pgran_element_size", size)
            result = study.run(BENCH / f"answer_{size}.h5", "biaxial", *more, ranks=2)
            I, took = result.history["inertial_number_max"][-1], result.attributes
            difference = seconds = None
            if size in strict.split():
                other = study.run(BENCH / f"strict_{size}.h5", "biaxial", *more, *STRICT, ranks=2)
                difference = 100 * (I / other.history["inertial_number_max"][-1] - 1)
                seconds = other.attributes["seconds"]
            row = band.measure(result.path)[-1]
            yield (size, *(took[name] for name in ("seconds", "memory", "steps",
                                                   "newton_iterations", "linear_iterations")),
                   I, difference, row["angle"], row["width"], seconds)

    return columns, rows()


def iterations(sizes="2 1 0.5", ranks="1 2 3 4", *, options=()):
    """Iterations to 1e-6 before, during and after localisation, mean (maximum)."""
    def rows():
        for size in sizes.split():
            for count in ranks.split():
                cells = []
                for state in (BEFORE, DURING, AFTER):
                    found = step(count, state, *options, "-pgran_element_size", size, "-dt", 2e-4,
                                 *EXACT)
                    counts = [row["iterations"] for row in found["newton"]]
                    cells.append(f"{np.mean(counts):.1f} ({max(counts)})")
                yield size, found["unknowns"], count, *cells

    return {"element (d)": "", "unknowns": "d", "ranks": "", "before": "", "during": "",
            "after": ""}, rows()


def inertia(sizes="4 2 1", ranks="1 2", *, options=()):
    """Iterations over the time step with inertia (without), before yielding and in flow."""
    def rows():
        states = snapshots("yielding", "-pgran_snapshots", ",".join(map(str, YIELDING.values())),
                           "-pgran_compression", max(YIELDING.values()), "-pgran_element_size",
                           COARSE).path
        for number, state in enumerate(YIELDING):
            for size in sizes.split():
                for count in ranks.split():
                    counts = [measure(count, "systems", *EXACT, *options, "-pgran_element_size",
                                      size, "-pgran_inertia", inertia, "-from", states,
                                      "-snapshot", number, "-dt", ",".join(STEPS))
                              for inertia in ("true", "false")]
                    yield state, size, count, *(f"{on or '-'} ({off or '-'})"
                                                for on, off in zip(*counts))

    return {"state": "", "element (d)": "", "ranks": "",
            **{f"dt = {dt}": "" for dt in STEPS}}, rows()


def flows(sizes="1 0.5 0.25", ranks="1 2", *, options=()):
    """Iterations per system in the flows on frozen meshes, mean of all steps (maximum)."""
    def rows():
        for flow, (name, *more) in FLOWS.items():
            for size in sizes.split():
                for count in ranks.split():
                    yield flow, size, count, *(per_system(study.run(
                        result_file(BENCH, f"{flow} {size} {count} {kind}"), name, "-options_file",
                        "options/solver_mg_fixed.opts", *more, *varied, *options,
                        "-pgran_element_size", size, ranks=int(count), needed=False))
                        for kind, varied in KINDS.items())

    return {"flow": "", "element (d)": "", "ranks": "", **dict.fromkeys(KINDS, "")}, rows()


def per_system(result):
    """Return the linear iterations per Newton iteration of a run, mean (maximum)."""
    if result is None:
        return None
    newton, linear = (result.history[f"{name}_iterations"] for name in ("newton", "linear"))
    return f"{linear.sum() / newton.sum():.1f} ({(linear / newton).max():.0f})"


def size(sizes="2 1 0.5", ranks="1 2 3 4", mumps=None, *, options=()):
    """Cost of a step over size and ranks, with multigrid and MUMPS (sizes of MUMPS: third list)."""
    plan = [("multigrid", count, sizes, ()) for count in ranks.split()] + [
        ("mumps", count, sizes if mumps is None else mumps, MUMPS) for count in ("1", "2")]

    def rows():
        for solver, count, many, more in plan:
            for side in many.split():
                found = step(count, LAST, *options, "-pgran_element_size", side, "-dt", 3e-4, *more)
                newton = found["newton"]
                seconds, jacobian = (np.mean([row[key] for row in newton])
                                     for key in ("seconds", "jacobian"))
                yield (solver, found["ranks"], found["element_size"], found["unknowns"],
                       len(newton), sum(row["iterations"] for row in newton),
                       len(newton) * seconds, seconds, jacobian, found["memory"])

    return {"solver": "", "ranks": "d", "element (d)": "g", "unknowns": "d", "Newton": "d",
            "linear": "d", "step (s)": ".2f", "s per Newton iteration": ".3f",
            "s per Jacobian": ".3f", "MB per rank": ".0f"}, rows()


def weak(ranks="1 2 4", *, options=()):
    """Weak scaling: 30 steps from rest, 4800 elements per rank if the ranks are powers of 2."""
    def rows():
        for count in map(int, ranks.split()):
            doublings = count.bit_length() - 1
            width, height = 40 * 2**(doublings // 2), 120 * 2**((doublings + 1) // 2)
            took = study.run(BENCH / f"weak_{count}.h5", "biaxial", *options, "-pgran_width",
                             width, "-pgran_height", height, "-pgran_element_size", 1,
                             "-ts_max_steps", 30, *EXACT, ranks=count).attributes
            newton = took["newton_iterations"]
            yield (took["ranks"], f"{width} x {height}", newton,
                   took["linear_iterations"] / newton, took["seconds"] / newton,
                   took["memory"] / took["ranks"])

    return {"ranks": "d", "L x H (d)": "", "Newton": "d", "linear per Newton iteration": ".1f",
            "s per Newton iteration": ".3f", "MB per rank": ".0f"}, rows()


def compiled(sizes="1 0.5", ranks="1 2", *, options=()):
    """Assembly and Newton iteration of pgran over compiled code (dolfinx)."""
    def rows():
        states = snapshots("states").path
        for size in sizes.split():
            for count in ranks.split():
                found = measure(count, "compiled", *options, "-pgran_element_size", size, "-from",
                                states, "-snapshot", LAST, "-dt", 3e-4)
                for name, scale in (("jacobian", 1e6 / found["elements"]),
                                    ("residual", 1e6 / found["elements"]), ("newton", 1.0)):
                    other, mine = (scale * value for value in found[name])
                    yield (size, count, "Newton iteration (s)" if scale == 1.0 else
                           f"{name} (us per element)", other, mine, mine / other)

    return {"element (d)": "", "ranks": "", "cost": "", "compiled": ".3f", "pgran": ".3f",
            "ratio": ".2f"}, rows()


def guard(*, options=()):
    """Ratios that do not depend on the machine: a performance regression test."""
    def rows():
        path = BENCH / "guard.h5"
        path.unlink(missing_ok=True)  # so that the cost is measured
        took = snapshots("guard", *options, ranks=2).attributes
        steps, newton = took["steps"], took["newton_iterations"]
        yield "steps", steps
        yield "steps repeated", took["steps_repeated"]
        yield "Newton iterations per step", newton / steps
        yield "linear iterations per Newton iteration", took["linear_iterations"] / newton

        def cost(size, *more):
            return step(2, AFTER, *options, "-pgran_element_size", size, "-dt", 2e-4, *more,
                        states=path)

        small, large = cost(2), cost(1)
        yield "iterations to 1e-6, elements of d", np.mean(
            [row["iterations"] for row in cost(1, *EXACT)["newton"]])
        yield "bytes per unknown", (2**20 * (large["memory_sum"] - small["memory_sum"])
                                    / (large["unknowns"] - small["unknowns"]))
        try:
            found = measure(1, "compiled", *study.QUIET, *options, "-pgran_element_size", 1,
                            "-from", path, "-snapshot", AFTER, "-dt", 2e-4)
        except subprocess.CalledProcessError:  # without dolfinx
            found = {}
        for name in ("jacobian", "residual", "newton"):
            yield (f"{name} over compiled code, elements of d, one rank",
                   found[name][1] / found[name][0] if found else None)
        yield ("run on elements of 2 d, two ranks, over one compiled Jacobian and MUMPS at d",
               took["seconds"] / (found["jacobian"][0] + found["mumps"]) if found else None)

    return {"quantity": "", "value": ".2f"}, rows()


BENCHES = {"answer": answer, "iterations": iterations, "inertia": inertia, "flows": flows,
           "size": size, "weak": weak, "compiled": compiled, "guard": guard}


def bench(name=None, *lists, options=()):
    """Performance of runs, steps and linear systems: bench [NAME [lists]]

    Lists are element sizes or widths, d, then ranks, for example: bench size "2 1" "1 2". All
    benchmarks run unless one is named. Nothing else should run on the machine. NAME is one of
    """
    if name not in (None, *BENCHES):
        raise ValueError(f"unknown benchmark {name}; expected one of: {', '.join(BENCHES)}")
    for title in [name] if name else BENCHES:
        columns, rows = BENCHES[title](*lists, options=options)
        study.write_table(BENCH / f"{title}.csv", columns, rows, page=f"bench_{title}")


bench.__doc__ += "\n" + "\n".join(
    f"      {name:12}{made.__doc__}" for name, made in BENCHES.items()) + "\n"
