"""Spectra of the Jacobian about the reference flow or a snapshot, computed with SLEPc.

The eigenproblem is J x = -lambda M x, where J and M are the derivatives of the residual with
respect to the unknowns and to their rates. M is singular, because only some unknowns have rates.
Its infinite eigenvalues are farthest from every shift, and those that SLEPc returns are discarded.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..options import SolutionError
from ..output.writer import BASE, write_once
from ..space.weakform import discretise
from ..theory import waves
from . import state

#: Number of harmonics of a cell in each direction among which the fastest is determined.
HARMONICS = 6
#: Largest residual of an accepted eigenpair.
LARGEST_RESIDUAL = 1e-6
#: Smallest share of an eigenvector in the unknowns with rates. A smaller share indicates an
#: infinite eigenvalue, whose share is 1e-8 by rounding errors.
LEAST_STORED = 1e-3


def theory(parameters, k):
    """Return the largest analytical growth rates, gdot0, of wave vectors ``k`` (..., 2), A d k.

    lambda = (mu_loc/(A^2 phi I0^2)) times the dimensionless rate (3.22), or the rate of dynamic
    NGF.
    """
    coefficients = waves.Coefficients.of_run(parameters)
    rate = waves.viscous_rate(coefficients.mu, parameters.A, parameters.phi,
                              parameters.inertial_number)
    return rate * waves.growth_rates(k, waves.PURE_SHEAR, coefficients)[..., 0]


def fastest(parameters):
    """Return the fastest-growing wave vector (2,), A d k, of the theory.

    Raises ValueError if all wave vectors are stable, or if growth is unbounded.
    """
    size, _, m = waves.fastest(waves.Coefficients.of_run(parameters))
    if not np.isfinite(size):
        raise ValueError("a wave vector has to be given where no fastest one exists")
    angle = np.radians(waves.direction_angle(m, waves.PURE_SHEAR))
    return float(size) * np.array([np.cos(angle), np.sin(angle)])


def targets(parameters, k):
    """Return the default targets of the eigenvalue search, gdot0.

    For a cell with the wave vector ``k`` (2,) the target is slightly above the fastest harmonic, or
    for LI, whose growth is unbounded, above the wave vector itself. Otherwise the targets are
    shares of the largest growth rate in an infinite medium; about a snapshot 0.
    """
    if parameters.restart:
        return [0.0]
    if k is None:
        try:
            top = float(theory(parameters, fastest(parameters)))
        except ValueError:  # no wave vector grows
            return [0.0]
        return [0.0, 0.1 * top, 0.3 * top, 0.9 * top]
    largest = 1 if parameters.part("model").theory == "li" else HARMONICS
    harmonics = np.indices((largest, largest)).reshape(2, -1).T + 1
    rates = theory(parameters, harmonics * k)
    if not np.isfinite(rates).all():
        raise ValueError(f"{','.join(f'{part:g}' for part in k)}: its growth rate is not finite")
    return [float(rates.max() + 0.05 * abs(rates.max()))]


def operators(parameters, comm):
    """Return the form, J and M about the reference flow or a snapshot. Collective.

    For prescribed unknowns the rows of J are rows of the identity, and the rows of M are empty.
    """
    form = discretise(parameters, comm)
    if parameters.restart:
        start = state.snapshot_start(form)
        increment = state.frozen(form, start)
    else:
        start = state.reference(form)
        increment = form.increment(start.x, start.stress, 0.0, 0.0)
    J, M = form.create_matrix(), form.create_matrix()
    form.jacobian(start.local, 0.0, increment, J)
    form.jacobian(start.local, 1.0, increment, M)
    M.axpy(-1.0, J)
    return form, J, M


def spectrum(parameters, comm, k=None, sought=None):
    """Return the eigenvalues nearest to the targets, largest real part first. Collective.

    Inertia is added to the flow, and imperfections are removed.

    Parameters
    ----------
    parameters, comm
    k : ndarray, (2,), optional
        Wave vector A d k; the cell has one wavelength in each direction.
    sought : sequence of float, optional
        Targets, gdot0; by default the result of `targets`.

    Returns
    -------
    form : pgran.space.weakform.WeakForm
    rows : tuple of dict
        ``computed`` and ``imaginary`` (parts of the eigenvalue), ``analytic`` and
        ``relative_error``, ``residual``, ``harmonic`` (m1, m2) and its ``share`` of the mode's
        power, and ``target``; rates in gdot0, None without theory.
    modes : tuple of ndarray, (n_local,)
        Complex modes in the same order.
    """
    part = parameters.part("case")
    parameters = part.homogeneous(parameters.replace(inertia=True))
    if k is not None:
        parameters = part.with_wave(parameters, np.asarray(k) / parameters.A)
    form, J, M = operators(parameters, comm)
    rows, modes, dropped = [], [], 0
    for target in targets(parameters, k) if sought is None else sought:
        for value, mode, error in eigenpairs(form, J, M, target):
            if not error < LARGEST_RESIDUAL:
                dropped += 1
                continue
            row = row_of(value, error)
            if any(abs(value - complex(r["computed"], r["imaginary"])) < 1e-6 * abs(value)
                   and r["target"] != target for r in rows):
                continue  # another target has the same eigenvalue
            if k is not None:
                harmonic, share = name_of(form, mode)
                if harmonic == (0, 0):
                    continue  # lambda = 0 for a translation of the cell
                analytic = float(theory(parameters, np.array(harmonic) * k))
                row.update(harmonic=harmonic, share=share, analytic=analytic,
                           relative_error=abs(value - analytic) / abs(analytic))
            rows.append({**row, "target": target})
            modes.append(mode)
    J.destroy()
    M.destroy()
    if not rows:
        raise SolutionError(f"no eigenvalue converged; the residuals of {dropped} others are "
                            f"not below {LARGEST_RESIDUAL:g}. What may help: another @@target, a "
                            "larger @@eps_max_it, or fewer @@eps_nev")
    rows, modes = zip(*sorted(zip(rows, modes), key=lambda found: -found[0]["computed"]))
    return form, rows, modes


def row_of(value, error):
    """Return the row of an eigenvalue, gdot0, with its residual and without theory."""
    return {"computed": value.real, "imaginary": value.imag, "analytic": None,
            "relative_error": None, "harmonic": None, "share": None, "residual": error}


def use_mumps(ksp):
    """Make MUMPS the default solver of a KSP."""
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)


def eigenpairs(form, J, M, target):
    """Return the eigenpairs nearest to ``target``, gdot0: (lambda, mode, residual). Collective.

    Options of SLEPc with the prefixes ``-eps_`` and ``-st_`` apply.
    """
    from slepc4py import SLEPc

    eps = SLEPc.EPS().create(comm=form.grid.comm)
    eps.setOperators(J, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GNHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setTarget(-target)
    eps.setDimensions(8)
    eps.getST().setType(SLEPc.ST.Type.SINVERT)
    use_mumps(eps.getST().getKSP())
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
    """Return |J x + lambda M x|/|lambda M x| of an eigenpair, x = real + i imaginary.

    It is inf for an infinite eigenvalue, for which M x, divided by the diagonal of M, is a rounding
    error of x.
    """
    product, diagonal = real.duplicate(), M.getDiagonal()

    def times(matrix):
        parts = []
        for part in (real, imaginary):
            matrix.mult(part, product)
            parts.append(product.array.copy())
        return parts[0] + 1j * parts[1]

    diagonal.reciprocal()  # zeros remain zero
    Jx, Mx, x = times(J), times(M), real.array + 1j * imaginary.array
    parts = Jx + value * Mx, value * Mx, diagonal.array * Mx, x
    sums = J.comm.tompi4py().allreduce(np.array([np.vdot(part, part).real for part in parts]))
    product.destroy()
    diagonal.destroy()
    change, size, rates, whole = np.sqrt(sums)
    return np.inf if rates < LEAST_STORED * whole else float(change / size)


def name_of(form, mode):
    """Return the harmonic (m1, m2) of a mode (n_local,) of the cell and its share of the power.

    It is the largest Fourier term of the velocity that the mesh resolves. A mode and its complex
    conjugate have the same name: m1 > 0, or m1 = 0 and m2 > 0. Collective.
    """
    grid = form.grid
    nodes = grid.nodes
    velocity = mode[:grid.n_flow].reshape(-1, grid.dof)[nodes.owned, :len(grid.velocities)]
    first, second = (np.exp(-2j * np.pi * np.outer(np.arange(-n, n + 1), index) / (2 * n))
                     for n, index in zip(grid.shape, nodes.index[:, nodes.owned]))
    terms = np.stack([(first * part) @ second.T for part in velocity.T])
    terms = grid.comm.tompi4py().allreduce(terms, MPI.SUM)
    power = (np.abs(terms)**2).sum(axis=0)
    power[:, -1] = power[-1, :] = 0.0  # the same as the first ones
    power = power + power[::-1, ::-1]
    a, b = np.unravel_index(np.argmax(np.round(power / power.max(), 9)), power.shape)
    found = int(a) - grid.shape[0], int(b) - grid.shape[1]
    count = 2.0 if any(found) else 1.0
    return max(found, (-found[0], -found[1])), float(count * power[a, b] / power.sum())


def write_mode(path, form, rate, mode):
    """Write a mode (n_local,) with growth rate ``rate``, gdot0, to a file. Collective.

    The file also contains the flow of the snapshot about which the mode was computed. Returns the
    `pgran.output.writer.Writer` and the name of a field for a picture.
    """
    grid, case, comm = form.grid, form.case, form.grid.comm.tompi4py()
    # The largest velocity becomes 1, also in phase.
    scale = grid.largest(grid.split(mode)[0][:, grid.nodes.owned].ravel())
    velocity, fluidity, pressure = grid.split((mode / scale).real)
    if all(case.periodic):
        # The prescribed pressure of one corner adds a constant without effect: subtract the mean.
        pressure, fluidity = (field if field is None else field - comm.allreduce(
            field[owned].sum(), MPI.SUM) / comm.allreduce(owned.size, MPI.SUM)
            for field, owned in ((pressure, grid.corners.owned), (fluidity, grid.nodes.owned)))
    fields = {"coordinates": case.coordinates(*grid.nodes.index), "velocity": velocity,
              "pressure": grid.corner_field(pressure), "speed": np.linalg.norm(velocity, axis=0)}
    if grid.has_fluidity:
        fields["fluidity"] = fluidity
    if case.parameters.restart:
        base = state.snapshot_start(form).nodal(form)
        fields.update((BASE + name, values) for name, values in base.items())
    return write_once(path, form, fields, growth_rate=rate, complete=True), "speed"


def draw_mode(writer, name, title):
    """Draw the field ``name`` of a mode on rank 0; return the file name or a note. Collective."""
    def picture():
        try:
            from ..output import pictures
        except ImportError as problem:
            return f"no picture, as there is {str(problem).lower()} (pip install 'pgran[plot]')"
        return pictures.field(writer.path, "0000", name, title)

    return writer.disk.do(picture)
