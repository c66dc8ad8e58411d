"""Growth rates of a finite specimen from the linearised time step.

    python -m pgran.growth -options_file options/growth.opts [-dt 1e-3,5e-4] [-without faces]
        [-mode NAME.h5] [-json]

A time step maps the mesh, the stress and the unknowns at one time to the next. Its linearisation
about the reference flow has eigenvalues m, found by SLEPc, and growth rates log(m)/dt, in units of
gdot0. With several steps, the fastest growth rate is extrapolated to dt = 0. Each eigenvalue is
printed with the residual of its eigenpair. For a specimen between slipping plates, the analytical
growth rate and the rate of the creep-buckling column are printed too.
"""

import sys

from .cli import JSON, as_json, report_unused, start
from .options import OptionError, ParameterError, command_option

OPTIONS = (
    command_option("dt", "floats", "time steps", (1e-3,), unit="1/gdot0", low=0.0, open_low=True),
    command_option("without", "str", "omitted parts of the coupling, separated by commas: faces, "
                   "geometry, interior, spin, memory (see pgran.solve.linearised.PARTS)"),
    command_option("mode", "str", "file of the fastest mode of the last step, with a picture"),
    JSON)


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    return start(arguments, run, __doc__, OPTIONS, slepc=True)


def run(parameters, args, comm):
    """Compute and print growth rates. Collective."""
    from .solve import linearised, spectrum
    from .space.weakform import discretise

    without = tuple(args.without.split(",")) if args.without else ()
    if set(without) - set(linearised.PARTS):
        raise OptionError(f"-without {args.without}: expected one or more of: "
                          + ", ".join(linearised.PARTS))
    if len(set(args.dt)) < len(args.dt):
        raise OptionError(f"-dt {','.join(f'{dt:g}' for dt in args.dt)}: must be different steps")
    for name in ("restart", "mode_file"):
        if value := getattr(parameters, name):
            raise ParameterError(name, value, "not allowed, because the reference flow is "
                                 "linearised; pgran.eigen linearises about a snapshot")
    form = discretise(parameters.part("case").homogeneous(parameters), comm)
    rows = []
    for dt in args.dt:
        modes = linearised.fastest_modes(form, dt, without)
        rows.append({"dt": dt, "growth_rates": [[rate.real, rate.imag] for rate, _, _ in modes],
                     "residuals": [residual for _, residual, _ in modes]})
    report_unused(comm)
    if modes and args.mode:
        rate, _, mode = modes[0]
        writer, field = linearised.write_mode(args.mode, form, rate.real, mode, ("mode", ""))
        picture = spectrum.draw_mode(writer, field, f"{field} of the fastest mode")
    if comm.rank:
        return
    if args.json:
        print(as_json(rows))
        return
    for row in rows:
        shown = "  ".join(
            f"{real:.6g}" + (f"{imaginary:+.3g}i" if imaginary else "") + f" ({residual:.0e})"
            for (real, imaginary), residual in zip(row["growth_rates"], row["residuals"]))
        print(f"  dt {row['dt']:.3g}: {shown or 'no eigenvalue converged'}")
    first = [row["growth_rates"][0][0] for row in rows if row["growth_rates"]]
    if len(first) == len(rows) > 1:
        print(f"  extrapolated to dt = 0: {linearised.extrapolated(args.dt, first):.6g}")
    if form.case.specimen and not without:
        from .theory import specimen

        exact = complex(specimen.growth_rate(**form.case.specimen))
        column = specimen.column_growth_rate(**form.case.specimen)
        print(f"  analytical, rigid-viscous, sway with one half wave: {exact.real:.6g}\n"
              f"  creep-buckling column: {column:.4g}")
    if modes and args.mode:
        print(f"  mode: {writer.path}, {writer.path.with_suffix('.xdmf')}, {picture}")


if __name__ == "__main__":
    sys.exit(main(sys.argv))
