"""Spectra of the solver's own Jacobian by SLEPc, beside the closed-form theory.

    mpiexec -n 2 python -m pgran.eigen -options_file options/eigen.opts [-json]

solves J x = -lambda M x about the reference flow of a case, with the Jacobian J and the mass
matrix M that the simulation uses, by shift-and-invert. Inertia is kept. With
``-pgran_case periodic`` the cell holds one wavelength of ``-wave_vector`` each way, with
``-pgran_cell_elements`` elements; each eigenvalue is named by the harmonic of its mode and compared
with the theory. Other cases have their own boundary conditions, and no theory is known of them.

    mpiexec -n 2 python -m pgran.eigen -pgran_restart NAME.h5 [-pgran_restart_snapshot n]

finds the spectrum about a snapshot of a result, of any case, on its mesh. Options that are not
given are those of the result. The flow must be steady with inertia: that of a ring needs
``-pgran_inertia true``, and the others are the same without it. Where the mesh moves, the step of
size ``-dt`` is linearised (`pgran.growth`), so that mesh and elastic memory take part.

A good run prints relative errors that fall with order 4 over ``-refinement n,n,...``, and
residuals near the rounding error. Eigenvalues are in units of gdot0, largest real part first.
The fastest mode is written to ``-pgran_output``, with a picture. Unless that is given, the file is
NAME_mode.h5 with ``-pgran_restart NAME.h5``, and results/CASE_MODEL_mode.h5 without. ``-eps_nev``
and other options of SLEPc hold.
"""

import csv
import sys
from pathlib import Path

import numpy as np

from . import cases
from .cli import JSON, REPORTED_ERRORS, as_json, command_option, report_unused, start
from .options import OptionError

OPTIONS = (
    command_option("wave_vector", "floats", "wave vector A d k; the fastest one unless given", length=2),
    command_option("refinement", "ints", "elements each way for which the fastest mode is repeated", low=2),
    command_option("target", "floats", "where the spectrum is sought", unit="gdot0"),
    command_option("dt", "float", "step that is linearised about a snapshot whose mesh moves", 1e-3,
        unit="1/gdot0", low=0.0, open_low=True),
    command_option("sweep", "int", "compare m x m wave vectors of the first quadrant with the theory; a CSV "
        "beside the output is written as it goes", low=2),
    command_option("sweep_end", "float", "largest component of these wave vectors", 0.15, low=0.0,
        open_low=True),
    JSON)


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    return start(arguments, run, __doc__, OPTIONS, slepc=True, complete=complete)


def complete(texts):
    """Add the options of the result whose snapshot the spectrum is about, and a file for the mode.

    ``texts`` and what is returned are {name: text}.
    """
    if texts.get("pgran_restart"):
        from .output.reader import begun_from

        texts = begun_from(texts)
        path = Path(texts["pgran_restart"])
        return {"pgran_output": str(path.with_name(f"{path.stem}_mode.h5")), **texts}
    parameters = cases.read(texts)
    name = "_".join(Path(kind.split(":")[0]).stem for kind in (parameters.case, parameters.model))
    return {"pgran_output": f"results/{name}_mode.h5", **texts}


def run(parameters, asked, comm):
    """Answer the command line; raises `OptionError`. Collective."""
    from .solve import linearised, spectrum

    say = print if comm.rank == 0 else (lambda *_, **__: None)
    case = parameters.part("case")
    moves = bool(parameters.restart) and case.moving
    waves = not parameters.restart and case.with_wave(parameters, np.ones(2)) is not None
    if not waves and (asked.wave_vector or asked.sweep):
        raise OptionError("-wave_vector, -sweep: allowed only with a case that holds waves, such "
                          f"as -pgran_case periodic, not {parameters.case}, and not about a "
                          "snapshot")
    if asked.wave_vector and not all(asked.wave_vector):
        raise OptionError(f"-wave_vector {','.join(f'{k:g}' for k in asked.wave_vector)}: allowed "
                          "is two numbers other than zero, one wavelength each way making the cell")
    try:
        if asked.sweep:
            sweep(parameters, asked, comm, say)
            return
        k = None
        if waves:
            k = spectrum.fastest(parameters) if asked.wave_vector is None else np.array(
                asked.wave_vector)
        form, rows, modes = (linearised.spectrum(parameters, comm, asked.dt) if moves else
                             spectrum.spectrum(parameters, comm, k, asked.target))
        report_unused(comm)
    except ValueError as problem:
        if isinstance(problem, REPORTED_ERRORS):
            raise
        raise OptionError(f"-wave_vector: {problem}") from None
    if asked.json:
        keys = ["computed", "analytic", "relative_error", "residual"]
        say(as_json([{key: row[key] for key in keys + ([] if waves else ["imaginary"])}
                        for row in rows]))
        return
    if modes:
        module = linearised if moves else spectrum
        writer, field = module.write_mode(parameters.output, form, rows[0]["computed"], modes[0])
        picture = spectrum.draw_mode(writer, field, f"{field} of the fastest mode")
        say(f"  mode: {writer.path}, {writer.path.with_suffix('.xdmf')}, {picture}")
    if parameters.restart and not moves:
        say("  with inertia the flow is steady to a residual of "
            f"{spectrum.unsteadiness(form):.1e} {form.case.stress_unit} d")
    table(rows, say)
    if asked.refinement and waves:
        refinement(parameters, asked, k, comm, say)
    elif asked.refinement:
        say(f"  no refinement: there is no theory of {parameters.case} to compare with")


def table(rows, say):
    """Print eigenvalues, each with its harmonic, analytic value, error and residual."""
    say(f"  {'computed':>26} {'analytic':>16} {'error':>10} {'residual':>10}  harmonic")
    for row in rows:
        analytic = "" if row["analytic"] is None else f"{row['analytic']:.8g}"
        error = "" if row["relative_error"] is None else f"{row['relative_error']:.2e}"
        say(f"  {shown(row['computed'], row['imaginary']):>26} {analytic:>16} {error:>10} "
            f"{row['residual']:10.1e}  {row['harmonic'] or ''}")


def shown(real, imaginary):
    """Return an eigenvalue as text."""
    return f"{real:.8g}" if not imaginary else f"{real:.6g}{imaginary:+.6g}i"


def refinement(parameters, asked, k, comm, say):
    """Print errors of the fastest mode and their observed orders over meshes."""
    from .solve import spectrum

    before = None
    say(f"  refinement of the fastest mode\n  {'elements':>9} {'computed':>16} {'error':>10} "
        f"{'order':>6}")
    for n in asked.refinement:
        _, rows, _ = spectrum.spectrum(parameters.replace(cell_elements=n), comm, k, asked.target)
        error, order = rows[0]["relative_error"], ""
        if before and error:
            order = f"{np.log(before[1] / error) / np.log(n / before[0]):6.2f}"
        before = n, error
        say(f"  {n:4d} x {n:<4d} {rows[0]['computed']:14.8g} {error:10.2e} {order:>6}")


def sweep(parameters, asked, comm, say):
    """Compare m x m wave vectors of the first quadrant with the theory; write a CSV. Collective.

    Each is the eigenvalue of harmonic (1, +-1) of its own cell; where several modes have
    that name, of the one that is most of it. A line is written as soon as it is known.
    """
    from .output.files import Disk, make_parents
    from .solve import spectrum

    path = Path(parameters.output).with_suffix(".csv")
    columns = ["k1", "k2", "computed", "analytic", "relative_error", "residual"]
    ticks = asked.sweep_end * (np.arange(asked.sweep) + 0.5) / asked.sweep
    found, worst = 0, 0.0

    def begin():
        make_parents(path)
        path.write_text(",".join(columns) + "\n")

    Disk(comm.tompi4py(), "output", parameters.output).do(begin)
    for k in ((k1, k2) for k1 in ticks for k2 in ticks):
        rate = float(spectrum.theory(parameters, np.array(k)))
        _, rows, _ = spectrum.spectrum(parameters, comm, k, [rate + 1e-3 * abs(rate)])
        row = max((r for r in rows if r["harmonic"] in ((1, 1), (1, -1))),
                  key=lambda r: r["share"], default=None)
        if row is None:
            say(f"  {k[0]:.4f},{k[1]:.4f}: no eigenvalue of this wave vector converged")
            continue
        found, worst = found + 1, max(worst, row["relative_error"])
        if comm.rank == 0:
            with open(path, "a", newline="") as file:
                csv.writer(file, lineterminator="\n").writerow(
                    [repr(float(value)) for value in (*k, *(row[key] for key in columns[2:]))])
    say(f"  {found} wave vectors of {asked.sweep**2}, largest relative error {worst:.2e}: {path}")


if __name__ == "__main__":
    sys.exit(main(sys.argv))
