"""Why a specimen localises: growth rates of the linearised time step on the moving mesh.

    python -m pgran.growth -options_file options/growth.opts [-dt 1e-3,5e-4] [-without faces]
        [-mode NAME.h5] [-json]

A step takes the mesh, the stress and the unknowns of one time to those of the next. About the
reference flow its linearisation has multipliers m. log(m)/dt are growth rates, in units of gdot0,
which converge as the step goes to zero. With several steps the last line extrapolates the fastest
one to a step of zero. Every eigenvalue comes with the residual of its eigenpair. For the specimen
between slipping plates, the closed form (`pgran.theory.specimen`) and the formula of a column that
creeps are printed beside it.
"""

import sys

from .cli import JSON, as_json, command_option, report_unused, start
from .options import OptionError, ParameterError

OPTIONS = (
    command_option("dt", "floats", "steps", (1e-3,), unit="1/gdot0", low=0.0, open_low=True),
    command_option("without", "str", "parts of the coupling that are left out, with commas: faces, geometry, "
        "interior, spin, memory (pgran.solve.linearised.PARTS says what each is)"),
    command_option("mode", "str", "file for the fastest mode of the last step, with a picture: its "
        "displacement, velocity, fluidity and pressure"),
    JSON)


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    return start(arguments, run, __doc__, OPTIONS, slepc=True)


def run(parameters, asked, comm):
    """Answer the command line; raises `OptionError`. Collective."""
    from .solve import linearised, spectrum
    from .space.weakform import discretise

    without = tuple(asked.without.split(",")) if asked.without else ()
    if set(without) - set(linearised.PARTS):
        raise OptionError(f"-without {asked.without}: allowed is {' | '.join(linearised.PARTS)}")
    if len(set(asked.dt)) < len(asked.dt):
        raise OptionError(f"-dt {','.join(f'{dt:g}' for dt in asked.dt)}: allowed are steps that "
                          "differ")
    for name in ("restart", "mode_file"):
        if value := getattr(parameters, name):
            raise ParameterError(name, value, "the reference flow is linearised; allowed is none; "
                                 "pgran.eigen takes a snapshot")
    form = discretise(parameters.part("case").homogeneous(parameters), comm)
    rows = []
    for dt in asked.dt:
        modes = linearised.fastest_modes(form, dt, without)
        rows.append({"dt": dt, "growth_rates": [[rate.real, rate.imag] for rate, _, _ in modes],
                     "residuals": [residual for _, residual, _ in modes]})
    report_unused(comm)
    files = ()
    if modes and asked.mode:
        rate, _, mode = modes[0]
        writer, field = linearised.write_mode(asked.mode, form, rate.real, mode, ("mode", ""))
        picture = spectrum.draw_mode(writer, field, f"{field} of the fastest mode")
        files = writer.path, writer.path.with_suffix(".xdmf"), picture
    if comm.rank:
        return
    if asked.json:
        print(as_json(rows))
        return
    for row in rows:
        shown = "  ".join(
            (f"{real:.6g}{imaginary:+.3g}i" if imaginary else f"{real:.6g}") + f" ({residual:.0e})"
            for (real, imaginary), residual in zip(row["growth_rates"], row["residuals"]))
        print(f"  dt {row['dt']:.3g}: {shown or 'no multiplier converged'}")
    first = [row["growth_rates"][0][0] for row in rows if row["growth_rates"]]
    if len(first) == len(rows) > 1:
        print(f"  extrapolated to a step of zero: {linearised.extrapolated(asked.dt, first):.6g}")
    if not without:
        compare(form.case)
    if files:
        print("  mode: " + ", ".join(map(str, files)))


def compare(case):
    """Print the growth rates of theory, for the specimen between slipping plates."""
    from .theory import specimen

    if case.specimen is None:
        return
    exact = complex(specimen.growth_rate(**case.specimen))
    print(f"  closed form, rigid-viscous, sway with one half wave: {exact.real:.6g}\n"
          f"  a column that creeps: {specimen.column_growth_rate(**case.specimen):.4g}")


if __name__ == "__main__":
    sys.exit(main(sys.argv))
