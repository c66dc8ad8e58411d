"""Growth rates of the linearised time step on a moving mesh.

A step maps mesh, stress and unknowns to their values at the next time. Its linearisation about a
flow has multipliers m and growth rates log(m)/dt. SLEPc computes the largest ones matrix-free: each
product solves two linear systems with the Jacobian of the step.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..options import PREFIX, SolutionError
from ..output.writer import write_once
from ..space.weakform import discretise
from . import state as states
from .spectrum import row_of, use_mumps

#: Parts of the coupling that can be omitted, and the effect.
PARTS = {
    "faces": "the load on the sides does not follow the disturbed sides",
    "geometry": "elements keep their undisturbed shape",
    "interior": "only nodes of the loaded sides are displaced by the disturbance",
    "spin": "the disturbance does not rotate the stress",
    "memory": "the stress of the previous step is undisturbed"}
#: Size of the disturbances of the central differences, in d, stress and gdot0.
SIZE = 1e-5
#: Relative change at which Newton's method for the undisturbed step stops, and its iterations.
TOLERANCE, MAX_ITERATIONS = 1e-12, 50
#: Smallest step length of its line search.
LEAST = 1e-3
#: Largest displacement of the mesh of a mode that is written, d.
SHOWN = 2.0


class LinearisedStep:
    """The derivative of one step ``dt``, 1/gdot0, about a flow. Collective.

    ``without`` are the names of omitted `PARTS`, and ``start`` is a `State`, by default of the
    reference flow. A disturbance is one array of this rank: mesh (dim n_nodes), unknowns (n_local)
    and stress (m points n_elements) with ghosts.
    """

    def __init__(self, form, dt, without=(), start=None):
        self.form, self.dt, self.without = form, dt, without
        grid = form.grid
        self.state = start or states.reference(form)
        self.base = states.TimeStep(form, self.state, dt)
        self.inside = np.ones(grid.nodes.size, dtype=bool)
        for side in form.case.tractions(0.0):
            self.inside[grid.side_nodes(side)] = False
        sizes = [self.state.x.size, grid.n_local, self.state.stress.size]
        self.lengths, self.size = np.cumsum(sizes[:-1]), sum(sizes)
        self.matrix, self.right = form.create_matrix(), grid.create_vector()
        self.update = self.right.duplicate()
        self.ksp = PETSc.KSP().create(comm=grid.comm)
        self.ksp.setOptionsPrefix("step_")
        self.ksp.setOperators(self.matrix)
        use_mumps(self.ksp)
        self.ksp.setFromOptions()
        self.end = self.state.local
        if start is None:
            _, fluidity, pressure = grid.split(self.end)
            self.end = grid.join(form.case.reference(self.base.increment.x)[0], fluidity, pressure)
        self._solve_base()

    def _solve_base(self):
        """Solve the undisturbed step; the loop ends on all ranks together."""
        comm, increment = self.form.grid.comm.tompi4py(), self.base.increment

        def residual(end):
            with np.errstate(all="ignore"):  # a large change may leave the range of the law
                rows = self.form.residual(end, (end - self.state.local) / self.dt, increment)
            return comm.allreduce(rows @ rows)

        for _ in range(MAX_ITERATIONS):
            self.form.jacobian(self.end, 1.0 / self.dt, increment, self.matrix)
            self.ksp.setOperators(self.matrix)
            change = self._newton(self.end, self.state, increment)
            before, share = residual(self.end), 1.0
            while share > LEAST and not residual(self.end + share * change) < before:
                share /= 2.0
            if share <= LEAST:  # the residual is a rounding error, or does not decrease
                share = 1.0
            self.end = self.end + share * change
            largest, size = (comm.allreduce(np.abs(part).max(initial=0.0), MPI.MAX)
                             for part in (change, self.end))
            if largest < TOLERANCE * size:
                return
        raise SolutionError(f"Newton's method for the undisturbed step of {self.dt:g}/gdot0 (@@dt) "
                            f"did not converge in {MAX_ITERATIONS} iterations: the last change is "
                            f"{largest:.1e}. What may help: a smaller step")

    def _newton(self, local, state, increment):
        rows = self.form.residual(local, (local - state.local) / self.dt, increment)
        self.right.setArray(-rows)
        self.ksp.solve(self.right, self.update)
        return self.form.grid.to_local(self.update)

    def _advanced(self, disturbance):
        """Return the disturbed mesh, unknowns and stress at the end, to first order."""
        state, form, base = self.state, self.form, self.base.increment
        x, local, stress = np.split(disturbance, self.lengths)
        start = states.State(state.time, state.x + x.reshape(state.x.shape), state.local + local,
                             state.stress + stress.reshape(state.stress.shape))
        step = states.TimeStep(form, start, self.dt)
        increment = step.increment
        if "spin" in self.without:
            increment.stress = start.past_stress(self.dt, self.base.transport(start))[1]
        if "memory" in self.without:
            increment.stress = base.stress
        if "interior" in self.without:
            increment = form.increment(np.where(self.inside, base.x, increment.x),
                                       increment.stress, increment.theta, state.time + self.dt,
                                       rate_from=state.time)
            step.increment = increment
        if "faces" in self.without:
            increment.load = base.load
        if "geometry" in self.without:
            increment.geometry = base.geometry
        end = self.end + self._newton(self.end, start, increment)
        return np.concatenate([step.mesh_at_end(end).ravel(), end,
                               form.stress(end, increment).ravel()])

    def mult(self, matrix, x, y):
        """Multiply, as a PETSc matrix of type Python: central differences in the direction x.

        Displacements are small compared with the other unknowns of a mode, so they are disturbed
        separately: with a common factor, rounding of the coordinates would dominate the result.
        """
        comm, total = self.form.grid.comm.tompi4py(), 0.0
        for part in (slice(None, self.lengths[0]), slice(self.lengths[0], None)):
            change = np.zeros(self.size)
            change[part] = x.array_r[part]
            largest = comm.allreduce(np.abs(change).max(initial=0.0), MPI.MAX)
            if largest:
                scale = SIZE / largest
                plus, minus = (self._advanced(sign * scale * change) for sign in (1.0, -1.0))
                total = total + (plus - minus) / (2.0 * scale)
        y.setArray(total + np.zeros(self.size))


def fastest_modes(form, dt, without=(), start=None):
    """Return (log(m)/dt, residual, mode) of the fastest modes of a `LinearisedStep`. Collective.

    Rates are in gdot0, residuals are |A x - m x|/|m x|, and modes are complex disturbances. Solver
    options have the prefixes ``-eps_`` and ``-step_``.
    """
    from slepc4py import SLEPc

    step, comm = LinearisedStep(form, dt, without, start), form.grid.comm
    shell = PETSc.Mat().createPython([(step.size, None)] * 2, step, comm=comm)
    shell.setUp()
    eps = SLEPc.EPS().create(comm=comm)
    eps.setOperators(shell)
    eps.setProblemType(SLEPc.EPS.ProblemType.NHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_MAGNITUDE)
    eps.setDimensions(4, 40)
    eps.setTolerances(1e-6, 100)
    eps.setFromOptions()
    eps.solve()
    found, (real, imaginary) = [], shell.createVecs()
    for k in range(eps.getConverged()):
        multiplier = complex(eps.getEigenpair(k, real, imaginary))
        found.append((complex(np.log(multiplier) / dt),
                      eps.computeError(k, SLEPc.EPS.ErrorType.RELATIVE),
                      real.array + 1j * imaginary.array))
    return sorted(found, key=lambda mode: -mode[0].real)


def spectrum(parameters, comm, dt):
    """Return form, rows and modes of a step ``dt``, 1/gdot0, about a snapshot. Collective.

    Rows are described in `pgran.solve.spectrum.spectrum`, modes in `fastest_modes`.
    """
    form = discretise(parameters, comm)
    found = fastest_modes(form, dt, start=states.snapshot_start(form))
    if not found:
        raise SolutionError("no multiplier of the linearised step converged. What may help: a "
                            "larger @@eps_max_it or @@eps_ncv")
    rates, residuals, modes = zip(*found)
    return form, list(map(row_of, rates, residuals)), modes


def extrapolated(steps, rates):
    """Return rates (n,), gdot0, extrapolated to a step of zero by a polynomial in ``steps``."""
    return float(np.polynomial.polynomial.polyfit(steps, rates, len(steps) - 1)[0])


def write_mode(path, form, rate, mode, option=("output", PREFIX)):
    """Write a mode of `fastest_modes` with growth rate ``rate``, gdot0, to a file. Collective.

    ``option`` names the file as for `pgran.output.writer.Writer`. Returns this writer and the name
    of a field for a picture.
    """
    grid = form.grid
    x = states.snapshot_start(form).x if form.case.parameters.restart else (
        form.case.coordinates(*grid.nodes.index))
    mode = (mode / grid.largest(mode[:x.size])).real  # the largest displacement becomes 1 d
    velocity, fluidity, pressure = grid.split(mode[x.size:x.size + grid.n_local])
    displacement = mode[:x.size].reshape(x.shape)
    fields = {"coordinates": x + SHOWN * displacement, "displacement": displacement,
              "velocity": velocity, "pressure": grid.corner_field(pressure)}
    if grid.has_fluidity:
        fields["fluidity"] = fluidity
    writer = write_once(path, form, fields, option, growth_rate=rate, complete=True)
    return writer, "fluidity" if "fluidity" in fields else "pressure"
