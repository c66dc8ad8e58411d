"""Spectra of the solver's own Jacobian by SLEPc, beside the closed-form theory.

    mpiexec -n 2 python -m pgran.eigen -options_file options/eigen.opts [-json]

solves J x = -lambda M x about homogeneous flow, with the Jacobian J and the mass
matrix M that the simulation uses, by shift-and-invert. M is singular (velocity
alone carries inertia): its infinite eigenvalues lie farthest from every shift and
are never among the answers. With ``-pgran_case periodic`` the cell holds one wave
length of ``-wave_vector k1,k2`` (A d k) each way and ``-pgran_cell_elements`` n
elements; each eigenvalue is named by the harmonic of its mode and compared with
the theory. With ``-pgran_case biaxial`` it is the specimen with its boundary
conditions, of which no theory is known.

A good run prints relative errors that fall with order 4 or better over
``-refinement n,n,...``, and residuals near the rounding error. Eigenvalues are in
units of gdot0, largest real part first. Other options: ``-target`` (a list, gdot0) where
the spectrum is sought, ``-sweep m`` for m x m wave vectors up to ``-sweep_end`` (a CSV
beside ``-pgran_output``), ``-eps_nev``.
"""

import difflib
import json
import sys

import numpy as np

from .options import OptionError, Settings

#: Options of this command alone, and what they mean.
OWN = ("wave_vector", "refinement", "target", "sweep", "sweep_end", "json")
#: Harmonics of the cell among which the fastest is sought, each way.
HARMONICS = 6


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    from .__main__ import command

    return command(arguments, run, __doc__, slepc=True)


def run(settings, comm):
    """Answer the command line; raises `OptionError`. Collective."""
    from petsc4py import PETSc

    database = PETSc.Options()
    own = {name: database.getString(name, "") for name in OWN if database.hasName(name)}
    for name in database.getAll():
        near = difflib.get_close_matches(name, OWN, n=1, cutoff=0.8)
        if near and name not in OWN:
            raise OptionError(f"-{name}: no such option; did you mean -{near[0]}?")
    if settings.case != "periodic" and {"wave_vector", "sweep"} & set(own):
        raise OptionError(f"-wave_vector, -sweep: allowed with -pgran_case periodic, not "
                          f"{settings.case}")
    say = print if comm.rank == 0 else (lambda *_, **__: None)
    if "sweep" in own:
        sweep(settings, own, comm, say)
        return
    if "json" in own:
        rows = spectrum(settings, own, comm)
        keys = ["computed", "analytic", "relative_error", "residual"]
        if settings.case != "periodic":
            keys.append("imaginary")
        say(json.dumps([{key: row[key] for key in keys} for row in rows]))
        return
    rows = spectrum(settings, own, comm, write=True, say=say)
    table(rows, say)
    if "refinement" in own and settings.case == "periodic":
        refinement(settings, own, comm, say)


def table(rows, say):
    """Print eigenvalues, each with its harmonic, analytic value, error and residual."""
    say(f"  {'computed':>26} {'analytic':>16} {'error':>10} {'residual':>10}  harmonic")
    for row in rows:
        value = complex(row["computed"], row["imaginary"])
        shown = f"{value.real:.8g}" if not value.imag else f"{value.real:.6g}{value.imag:+.6g}i"
        analytic = "" if row["analytic"] is None else f"{row['analytic']:.8g}"
        error = "" if row["relative_error"] is None else f"{row['relative_error']:.2e}"
        say(f"  {shown:>26} {analytic:>16} {error:>10} {row['residual']:10.1e}  "
            f"{row['harmonic'] or ''}")


def refinement(settings, own, comm, say):
    """Print errors of the fastest mode and their observed orders over ``-refinement``."""
    sizes, before = _integers("refinement", own["refinement"]), None
    say(f"  refinement of the fastest mode\n  {'elements':>9} {'computed':>16} {'error':>10} "
        f"{'order':>6}")
    for n in sizes:
        row = spectrum(Settings(**{**vars(settings), "cell_elements": n}), own, comm)[0]
        order = ""
        if before and row["relative_error"]:
            order = f"{np.log(before[1] / row['relative_error']) / np.log(n / before[0]):6.2f}"
        before = n, row["relative_error"]
        say(f"  {n:4d} x {n:<4d} {row['computed']:14.8g} {row['relative_error']:10.2e} {order:>6}")


def _integers(name, text):
    """The integers of a list; raises `OptionError` where they are not such, or below 2."""
    try:
        found = [int(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or min(found) < 2:
        raise OptionError(f"-{name} {text}: allowed is a list of integers >= 2")
    return found


def cell_settings(settings, k):
    """Return settings of the periodic cell with one wavelength of A d k = ``k`` (2,) each way."""
    if not (np.abs(k) > 0.0).all():
        raise OptionError(f"-wave_vector {k[0]:g},{k[1]:g}: allowed is two numbers other than "
                          "zero, one wavelength each way making the cell")
    width, height = 2.0 * np.pi * settings.A / np.abs(k)
    return Settings(**{**vars(settings), "width": float(width), "height": float(height)})


def theory(settings, k):
    """Return the largest analytic growth rates (...), gdot0, of wave vectors ``k`` (..., 2), A d k.

    lambda = (mu_loc/(A^2 phi I0^2)) times the dimensionless rate (3.22).
    """
    from . import rheology, stability

    coefficients = stability.Coefficients.of(
        rheology.law_of(settings), settings.model, settings.inertial_number)
    rate = stability.viscous_rate(coefficients.mu, settings.A, settings.phi,
                                  settings.inertial_number)
    return rate * stability.growth_rates(k, stability.PURE_SHEAR, coefficients)[..., 0]


def spectrum(settings, own, comm, write=False, say=lambda *_: None):
    """Return the eigenvalues nearest the target, largest real part first, as dictionaries.

    Keys ``computed`` (real part) and ``imaginary``, gdot0; ``analytic`` and
    ``relative_error`` (None without theory); ``residual`` as `residual` tells;
    ``harmonic`` (m1, m2) of the mode and its ``share`` of the mode's power; ``target``, where
    it was sought. ``write`` leaves the first mode as
    HDF5, XDMF and a picture. Raises `OptionError`. Collective.
    """
    settings = Settings(**{**vars(settings), "inertia": True, "imperfection": 1.0})
    k = None
    if settings.case == "periodic":
        from .stability import read_wave_vector

        k = read_wave_vector(own["wave_vector"]) if "wave_vector" in own else fastest(settings)
        settings = cell_settings(settings, k)
    form, J, M = operators(settings, comm)
    rows, vectors = [], []
    for target in _targets(settings, own, k):
        for value, mode, error in eigenpairs(form, J, M, target):
            row = {"computed": value.real, "imaginary": value.imag, "analytic": None,
                   "relative_error": None, "harmonic": None, "residual": error}
            if any(abs(value - complex(r["computed"], r["imaginary"])) < 1e-6 * abs(value)
                   and r["target"] != target for r in rows):
                continue  # two targets have found it
            if k is not None:
                harmonic, share = name_of(form, mode)
                if harmonic == (0, 0):
                    continue  # a translation of the whole cell, of which lambda = 0 says nothing
                analytic = float(theory(settings, np.array(harmonic) * k))
                row.update(harmonic=harmonic, share=share, analytic=analytic,
                           relative_error=abs(value - analytic) / abs(analytic))
            rows.append({**row, "target": target})
            vectors.append(mode)
    J.destroy()
    M.destroy()
    order = sorted(range(len(rows)), key=lambda n: -rows[n]["computed"])
    if write and order:
        write_mode(settings, form, vectors[order[0]], rows[order[0]], say)
    return [rows[n] for n in order]


def eigenpairs(form, J, M, target):
    """Return (lambda, mode (n_local,) complex, residual) nearest to ``target``, gdot0. Collective.

    The number, tolerance and solver are those of the ``-eps_`` and ``-st_`` options.
    """
    from slepc4py import SLEPc

    eps = SLEPc.EPS().create(comm=form.grid.comm)
    eps.setOperators(J, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GNHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setTarget(-target)
    eps.setDimensions(8)
    eps.getST().setType(SLEPc.ST.Type.SINVERT)
    eps.setFromOptions()
    eps.solve()
    found, (real, imaginary) = [], J.createVecs()
    for number in range(eps.getConverged()):
        value = -eps.getEigenpair(number, real, imaginary)
        mode = form.grid.to_local(real) + 1j * form.grid.to_local(imaginary)
        found.append((value, mode, residual(J, M, value, real, imaginary)))
    for thing in (eps, real, imaginary):
        thing.destroy()
    return found


def residual(J, M, value, real, imaginary):
    """Return |J x + lambda M x| over |lambda M x| of an eigenpair, x = real + i imaginary."""
    Jx, Mx = J.createVecs()
    change, size = 0.0, 0.0
    # lambda M x = (a + ib)(Mr + iMi), part by part
    for part, other, sign in ((real, imaginary, -1.0), (imaginary, real, 1.0)):
        M.mult(part, Mx)
        Mx.scale(value.real)
        if value.imag:
            M.mult(other, Jx)
            Mx.axpy(sign * value.imag, Jx)
        J.mult(part, Jx)
        size += Mx.norm()**2
        Jx.axpy(1.0, Mx)
        change += Jx.norm()**2
    Jx.destroy()
    Mx.destroy()
    return float(np.sqrt(change / size))


def _targets(settings, own, k):
    """Where the spectrum is sought, gdot0: ``-target``, or by the case.

    Just beyond the fastest harmonic of a cell; for LI, whose growth has no bound, just
    beyond the wave vector itself; for the specimen, of which no theory is known, at 0,
    0.1, 0.3 and 0.9 of the growth of the fastest wave vector in free space.
    """
    if "target" in own:
        try:
            return [float(part) for part in own["target"].split(",")]
        except ValueError:
            raise OptionError(f"-target {own['target']}: allowed is a list of numbers") from None
    if k is None:
        try:
            top = float(theory(settings, fastest(settings)))
        except OptionError:  # no wave vector grows in free space
            return [0.0]
        return [0.0, 0.1 * top, 0.3 * top, 0.9 * top]
    most = 1 if settings.model == "li" else HARMONICS
    m = np.arange(1, most + 1)
    rates = theory(settings, np.array([(a, b) for a in m for b in m]) * k)
    return [float(rates.max() + 0.05 * abs(rates.max()))]


def fastest(settings):
    """Return the fastest-growing wave vector (2,), A d k, by the closed form.

    Raises `OptionError` where there is none: all are stable, or growth has no bound.
    """
    from . import rheology, stability

    coefficients = stability.Coefficients.of(
        rheology.law_of(settings), settings.model, settings.inertial_number)
    size, _, m = stability.fastest(coefficients)
    if not np.isfinite(size):
        raise OptionError("-wave_vector: it has to be given where no fastest one exists")
    angle = np.radians(stability.direction_angle(m, stability.PURE_SHEAR))
    return float(size) * np.array([np.cos(angle), np.sin(angle)])


def operators(settings, comm):
    """Return the form, J and M about homogeneous flow. Collective.

    J and M are the derivatives of the simulation's residual with respect to the
    unknowns and to their rates, at theta = 0 on the initial mesh. Rows of prescribed
    unknowns are identity in J and empty in M.
    """
    from . import evolve, weakform

    form = weakform.discretise(settings, comm)
    state = evolve.steady_start(form)
    step = weakform.Step(form, state.x, state.stress, 0.0, form.prescribed(0.0), None)
    J, M = form.create_matrix(), form.create_matrix()
    form.jacobian(state.local, 0.0, step, J)
    form.jacobian(state.local, 1.0, step, M)
    M.axpy(-1.0, J)
    return form, J, M


def name_of(form, mode):
    """Return the harmonic (m1, m2) of a mode (n_local,) of the cell, and its share of the power.

    The largest Fourier term of the velocity, among all that the elements resolve; m1 >= 0,
    and m2 > 0 where m1 = 0: a mode and its complex conjugate have one name. Collective.
    """
    from mpi4py import MPI

    grid = form.grid
    nodes = grid.nodes
    velocity = mode[:grid.n_flow].reshape(-1, grid.dof)[nodes.owned, :2]
    first, second = (np.exp(-2j * np.pi * np.outer(np.arange(-n, n + 1), index) / (2 * n))
                     for n, index in zip(grid.shape, (nodes.i[nodes.owned], nodes.j[nodes.owned])))
    terms = np.stack([(first * part) @ second.T for part in velocity.T])
    terms = grid.comm.tompi4py().allreduce(terms, MPI.SUM)
    power = (np.abs(terms)**2).sum(axis=0)
    power[:, -1] = power[-1, :] = 0.0  # the same as the first ones
    power = power + power[::-1, ::-1]
    a, b = np.unravel_index(np.argmax(np.round(power / power.max(), 9)), power.shape)
    found = int(a) - grid.shape[0], int(b) - grid.shape[1]
    share = 2.0 * power[a, b] / power.sum() if found != (0, 0) else power[a, b] / power.sum()
    return (found if found > (0, 0) else (-found[0], -found[1])), float(share)


def write_mode(settings, form, mode, row, say):
    """Write a mode beside ``-pgran_output`` as HDF5, XDMF and, on rank 0, a picture. Collective."""
    from .results import Writer

    from mpi4py import MPI

    grid, case, comm = form.grid, form.case, form.grid.comm.tompi4py()
    x = case.coordinates(grid.nodes.i, grid.nodes.j)
    # The largest velocity becomes 1 in size and real, on whichever rank it is.
    scale = grid.largest(grid.split(mode)[0][:, grid.nodes.owned].ravel())
    velocity, fluidity, pressure = grid.split((mode / scale).real)
    if any(case.periodic):
        # The held pressure of one corner adds a constant, which changes no flow: take it out.
        pressure, fluidity = (field if field is None else field - comm.allreduce(
            field[owned].sum(), MPI.SUM) / comm.allreduce(owned.size, MPI.SUM)
            for field, owned in ((pressure, grid.corners.owned), (fluidity, grid.nodes.owned)))
    fields = {"coordinates": x, "velocity": velocity, "pressure": form.corner_field(pressure),
              "speed": np.hypot(*velocity)}
    if fluidity is not None:
        fields["fluidity"] = fluidity
    writer = Writer(settings.output, grid, settings, {"growth_rate": row["computed"]})
    writer.snapshot(0.0, 0.0, fields)

    def picture():
        from . import plot

        return plot.field(writer.path, "0000", "speed", "speed of the fastest mode")

    say(f"  mode: {writer.path}, {writer.path.with_suffix('.xdmf')}, "
        f"{writer.root_only(picture)}")


def sweep(settings, own, comm, say):
    """Compare m x m wave vectors of the first quadrant with the theory; write a CSV. Collective.

    Each is the eigenvalue of harmonic (1, +-1) of its own cell; where several modes have
    that name, of the one that is most of it.
    """
    from pathlib import Path

    from .stability import read_numbers

    count = int(_integers("sweep", own["sweep"])[0])
    end = float(read_numbers("sweep_end", own.get("sweep_end", "0.15"), (1,))[0])
    ticks = end * (np.arange(count) + 0.5) / count
    lines, worst = ["k1,k2,computed,analytic,relative_error,residual"], 0.0
    for k1 in ticks:
        for k2 in ticks:
            k = np.array([k1, k2])
            rate = float(theory(settings, k))
            rows = spectrum(settings, {"wave_vector": f"{k1},{k2}",
                                       "target": repr(rate + 1e-3 * abs(rate))}, comm)
            row = max((r for r in rows if r["harmonic"] in ((1, 1), (1, -1))),
                      key=lambda r: r["share"], default=None)
            if row is None:
                say(f"  {k1:.4f},{k2:.4f}: no eigenvalue of this wave vector converged")
                continue
            worst = max(worst, row["relative_error"])
            lines.append(f"{k1!r},{k2!r},{row['computed']!r},{row['analytic']!r},"
                         f"{row['relative_error']!r},{row['residual']!r}")
    path = Path(settings.output).with_suffix(".csv")
    if comm.rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
    say(f"  {len(lines) - 1} wave vectors of {count**2}, largest relative error {worst:.2e}: "
        f"{path}")


if __name__ == "__main__":
    sys.exit(main(sys.argv))
