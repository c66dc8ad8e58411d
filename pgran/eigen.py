"""Eigenvalue spectra of the discretised problem (SLEPc), compared with linear theory.

    mpiexec -n 2 python -m pgran.eigen -options_file options/eigen.opts [-json]

Solves J x = -lambda M x about the reference flow of a case by shift-and-invert. J and M are the
Jacobian and the mass matrix of the simulation, with inertia. With ``-pgran_case periodic`` the cell
is one wavelength of ``-wave_vector`` in each direction, with ``-pgran_cell_elements`` elements; the
eigenvalue of each harmonic is compared with the theory.

    mpiexec -n 2 python -m pgran.eigen -pgran_restart NAME.h5 [-pgran_restart_snapshot n]

computes the spectrum about a snapshot of a result, on its mesh. The flow must be steady with
inertia. If the mesh moves, a time step of size ``-dt`` is linearised (`pgran.growth`).

Eigenvalues are in units of gdot0, largest real part first. The fastest mode is written with a
picture to ``-pgran_output``, by default NAME_mode.h5 or results/CASE_MODEL_mode.h5. ``-eps_nev``
and other options of SLEPc apply.
"""

import sys
from itertools import product
from pathlib import Path

import numpy as np

from . import cases
from .cli import JSON, REPORTED_ERRORS, as_json, report_unused, start
from .options import OptionError, command_option

OPTIONS = (
    command_option("wave_vector", "floats", "wave vector A d k; default: the fastest one",
                   length=2),
    command_option("refinement", "ints", "elements in each direction, for errors of the fastest "
                   "mode on several meshes", low=2),
    command_option("target", "floats", "eigenvalues near these are computed", unit="gdot0"),
    command_option("dt", "float", "time step, for a snapshot with a moving mesh", 1e-3,
                   unit="1/gdot0", low=0.0, open_low=True),
    command_option("sweep", "int", "compare m x m wave vectors of the first quadrant with the "
                   "theory and write a CSV file next to the output", low=2),
    command_option("sweep_end", "float", "largest component of these wave vectors", 0.15, low=0.0,
                   open_low=True),
    JSON)


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    return start(arguments, run, __doc__, OPTIONS, slepc=True, complete=complete)


def complete(texts):
    """Add the options of the restarted result and the default file of the mode, {name: text}."""
    if texts.get("pgran_restart"):
        from .output.reader import begun_from

        texts = begun_from(texts)
        path = Path(texts["pgran_restart"])
        return {"pgran_output": str(path.with_name(f"{path.stem}_mode.h5")), **texts}
    parameters = cases.read(texts)
    name = "_".join(Path(kind.split(":")[0]).stem for kind in (parameters.case, parameters.model))
    return {"pgran_output": f"results/{name}_mode.h5", **texts}


def run(parameters, args, comm):
    """Compute and print the spectrum. Collective."""
    from .solve import linearised, spectrum, state

    say = print if comm.rank == 0 else (lambda text: None)
    case = parameters.part("case")
    moving = bool(parameters.restart) and case.moving
    waves = not parameters.restart and case.with_wave(parameters, np.ones(2)) is not None
    if not waves and (args.wave_vector or args.sweep):
        raise OptionError("-wave_vector, -sweep: allowed only with a case that has plane waves, "
                          f"such as -pgran_case periodic, not {parameters.case}, and not about a "
                          "snapshot")
    if args.wave_vector and not all(args.wave_vector):
        raise OptionError(f"-wave_vector {','.join(f'{k:g}' for k in args.wave_vector)}: must be "
                          "two numbers other than zero, which define the cell")
    try:
        if args.sweep:
            sweep(parameters, args, comm, say)
            return
        k = np.array(args.wave_vector or spectrum.fastest(parameters)) if waves else None
        form, rows, modes = (linearised.spectrum(parameters, comm, args.dt) if moving else
                             spectrum.spectrum(parameters, comm, k, args.target))
        report_unused(comm)
    except ValueError as problem:
        if isinstance(problem, REPORTED_ERRORS):
            raise
        raise OptionError(f"-wave_vector: {problem}") from None
    if args.json:
        keys = ["computed", "analytic", "relative_error", "residual"]
        keys += [] if waves else ["imaginary"]
        say(as_json([{key: row[key] for key in keys} for row in rows]))
        return
    if modes:
        module = linearised if moving else spectrum
        writer, field = module.write_mode(parameters.output, form, rows[0]["computed"], modes[0])
        picture = spectrum.draw_mode(writer, field, f"{field} of the fastest mode")
        say(f"  mode: {writer.path}, {writer.path.with_suffix('.xdmf')}, {picture}")
    if parameters.restart and not moving:
        say("  residual of the snapshot as a steady flow with inertia: "
            f"{state.steady_residual(form, state.snapshot_start(form)):.1e} "
            f"{form.case.stress_unit} d")
    table(rows, say)
    if args.refinement and not waves:
        say(f"  no refinement: no theory is available for {parameters.case}")
    elif args.refinement:
        refinement(parameters, args, k, comm, say)


def table(rows, say):
    """Print eigenvalues with their analytical values, errors, residuals and harmonics."""
    say(f"  {'computed':>26} {'analytic':>16} {'error':>10} {'residual':>10}  harmonic")
    for row in rows:
        computed, analytic, error = f"{row['computed']:.8g}", "", ""
        if row["imaginary"]:
            computed = f"{row['computed']:.6g}{row['imaginary']:+.6g}i"
        if row["analytic"] is not None:
            analytic, error = f"{row['analytic']:.8g}", f"{row['relative_error']:.2e}"
        say(f"  {computed:>26} {analytic:>16} {error:>10} {row['residual']:10.1e}  "
            f"{row['harmonic'] or ''}")


def refinement(parameters, args, k, comm, say):
    """Print errors of the fastest mode and their observed orders over meshes. Collective."""
    from .solve import spectrum

    previous = None
    say(f"  refinement of the fastest mode\n  {'elements':>9} {'computed':>16} {'error':>10} "
        f"{'order':>6}")
    for n in args.refinement:
        _, rows, _ = spectrum.spectrum(parameters.replace(cell_elements=n), comm, k, args.target)
        error, order = rows[0]["relative_error"], ""
        if previous and error:
            order = f"{np.log(previous[1] / error) / np.log(n / previous[0]):6.2f}"
        previous = n, error
        say(f"  {n:4d} x {n:<4d} {rows[0]['computed']:14.8g} {error:10.2e} {order:>6}")


def sweep(parameters, args, comm, say):
    """Compare m x m wave vectors of the first quadrant with the theory; write a CSV. Collective.

    Each row is the eigenvalue of harmonic (1, +-1) of a cell with the largest share.
    """
    from .output.files import Disk, make_parents
    from .solve import spectrum

    path = Path(parameters.output).with_suffix(".csv")
    columns = ["k1", "k2", "computed", "analytic", "relative_error", "residual"]
    ticks = args.sweep_end * (np.arange(args.sweep) + 0.5) / args.sweep
    lines, errors = [",".join(columns)], []

    def write():
        make_parents(path)
        path.write_text("\n".join(lines) + "\n")

    disk = Disk(comm.tompi4py(), "output", parameters.output)
    disk.do(write)  # an error of the file ends the command before the first spectrum
    for k in product(ticks, ticks):
        rate = float(spectrum.theory(parameters, np.array(k)))
        _, rows, _ = spectrum.spectrum(parameters, comm, k, [rate + 1e-3 * abs(rate)])
        row = max((r for r in rows if r["harmonic"] in ((1, 1), (1, -1))),
                  key=lambda r: r["share"], default=None)
        if not row:
            say(f"  {k[0]:.4f},{k[1]:.4f}: no eigenvalue of this wave vector converged")
            continue
        errors.append(row["relative_error"])
        values = *k, *(row[key] for key in columns[2:])
        lines.append(",".join(repr(float(value)) for value in values))
        disk.do(write)
    say(f"  {len(errors)} wave vectors of {args.sweep**2}, largest relative error "
        f"{max(errors, default=0.0):.2e}: {path}")


if __name__ == "__main__":
    sys.exit(main(sys.argv))
