"""Growth rates of the linearised time step, on the mesh that moves with the material.

A step takes the mesh, the stress and the unknowns of one time to those of the next. About the
reference flow, or about a snapshot, its linearisation has multipliers m, and log(m)/dt are growth
rates. Unlike the spectra of `pgran.solve.spectrum` they contain the motion of the mesh and the
elastic memory. SLEPc finds the largest multipliers matrix-free: each product takes two solutions
with the Jacobian of the step.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..material.elasticity import COMPONENTS
from ..options import PREFIX, SolutionError
from ..output.writer import write_once
from ..space.element import DIM, POINTS
from ..space.weakform import discretise
from . import state as states
from .spectrum import row_of

#: Parts of the coupling that can be left out, and what then stays undisturbed.
PARTS = {
    "faces": "the load on the sides does not follow the disturbed sides",
    "geometry": "elements keep their undisturbed shape",
    "interior": "only nodes of the loaded sides are where the disturbance takes them",
    "spin": "stress does not turn with the disturbance",
    "memory": "the stress of the step before is undisturbed"}
#: Size of the disturbances that are differenced, in d, stress and gdot0.
SIZE = 1e-5
#: Newton's method for the undisturbed step stops at this relative change, or gives up.
TOLERANCE, MOST = 1e-12, 50
#: It takes a share of a change that does not make the residual smaller, down to this one.
LEAST = 1e-3
#: Largest displacement of the shape on which a mode is shown, d.
SHOWN = 2.0


class LinearisedStep:
    """The derivative of one step (backward Euler, trapezoidal mesh) about a flow.

    A disturbance is one array: mesh (2 n_nodes), unknowns (n_local), stress (3 points
    n_elements) of this rank, ghosts included. Collective.

    Parameters
    ----------
    form : pgran.space.weakform.WeakForm
    dt : float
        Size of the step, 1/gdot0.
    without : sequence of str
        Names of `PARTS` that are left out.
    start : pgran.solve.state.State, optional
        Where the step starts; the reference flow unless given.

    Raises
    ------
    SolutionError
        If Newton's method does not converge for the undisturbed step.
    """

    def __init__(self, form, dt, without=(), start=None):
        self.form, self.dt, self.without = form, dt, without
        grid = form.grid
        self.state = start or states.reference(form)
        self.base = states.TimeStep(form, self.state, dt)
        self.inside = np.ones(grid.nodes.size, dtype=bool)
        for side in form.case.tractions(0.0):
            self.inside[grid.side_nodes(side)] = False
        sizes = [DIM * grid.nodes.size, grid.n_local, COMPONENTS * POINTS * grid.n_elements]
        self.lengths, self.size = np.cumsum(sizes[:-1]), sum(sizes)
        self.matrix, self.right = form.create_matrix(), grid.create_vector()
        self.update = self.right.duplicate()
        self.ksp = PETSc.KSP().create(comm=grid.comm)
        self.ksp.setOptionsPrefix("step_")
        self.ksp.setOperators(self.matrix)
        self.ksp.setType("preonly")
        self.ksp.getPC().setType("lu")
        self.ksp.getPC().setFactorSolverType("mumps")
        self.ksp.setFromOptions()
        self.end = self.state.local
        if start is None:
            _, fluidity, pressure = grid.split(self.end)
            self.end = grid.join(form.case.reference(self.base.increment.x)[0], fluidity, pressure)
        self._solve_base()

    def _solve_base(self):
        """Solve the undisturbed step; all ranks see the same change and leave together."""
        comm, increment = self.form.grid.comm.tompi4py(), self.base.increment

        def residual(end):
            with np.errstate(all="ignore"):  # a change that is too large may leave the law's range
                rows = self.form.residual(end, (end - self.state.local) / self.dt, increment)
            return comm.allreduce(rows @ rows)

        for _ in range(MOST):
            self.form.jacobian(self.end, 1.0 / self.dt, increment, self.matrix)
            self.ksp.setOperators(self.matrix)
            change = self._newton(self.end, self.state, increment)
            before, share = residual(self.end), 1.0
            while share > LEAST and not residual(self.end + share * change) < before:
                share /= 2.0
            if share <= LEAST:  # the residual is rounding error, or no direction of descent is left
                share = 1.0
            self.end = self.end + share * change
            largest, size = (comm.allreduce(np.abs(part).max(initial=0.0), MPI.MAX)
                             for part in (change, self.end))
            if largest < TOLERANCE * size:
                return
        raise SolutionError(f"Newton's method for the undisturbed step of {self.dt:g}/gdot0 (@@dt) "
                            f"has changed the unknowns by {largest:.1e} in iteration {MOST}; "
                            f"a smaller step may help")

    def _newton(self, local, state, increment):
        rows = self.form.residual(local, (local - state.local) / self.dt, increment)
        self.right.setArray(-rows)
        self.ksp.solve(self.right, self.update)
        return self.form.grid.to_local(self.update)

    def _advanced(self, disturbance):
        """Mesh, unknowns and stress at the end, to first order in the disturbance, as one array."""
        state, form, base = self.state, self.form, self.base.increment
        x, local, stress = np.split(disturbance, self.lengths)
        start = states.State(state.time, state.x + x.reshape(DIM, -1), state.local + local,
                             state.stress + stress.reshape(state.stress.shape))
        step = states.TimeStep(form, start, self.dt)
        increment = step.increment
        if "spin" in self.without:
            increment.stress = start.past(self.dt, self.base.transport(start))[1]
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

    def apply(self, direction):
        """Return the derivative in a direction (size,), by central differences. Collective."""
        largest = self.form.grid.comm.tompi4py().allreduce(
            np.abs(direction).max(initial=0.0), MPI.MAX)
        scale = SIZE / (largest or 1.0)
        ahead, behind = (self._advanced(sign * scale * direction) for sign in (1.0, -1.0))
        return (ahead - behind) / (2.0 * scale)

    def mult(self, matrix, x, y):
        """Multiply, as PETSc's matrices of type Python do."""
        y.setArray(self.apply(x.array_r))


def fastest_modes(form, dt, without=(), count=4, start=None):
    """Return the fastest growth rates of a form's step and their modes, fastest first. Collective.

    The parameters are those of `LinearisedStep`, and how many modes are sought. Solver options
    have the prefixes ``-eps_`` and ``-step_``.

    Returns
    -------
    list of (complex, float, ndarray)
        log(m)/dt in gdot0; the residual |A x - m x|/|m x| of its eigenpair; and its mode (size,),
        complex, a disturbance as `LinearisedStep` has it.
    """
    from slepc4py import SLEPc

    step, comm = LinearisedStep(form, dt, without, start), form.grid.comm
    shell = PETSc.Mat().createPython(((step.size, None), (step.size, None)), step, comm=comm)
    shell.setUp()
    eps = SLEPc.EPS().create(comm=comm)
    eps.setOperators(shell)
    eps.setProblemType(SLEPc.EPS.ProblemType.NHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_MAGNITUDE)
    eps.setDimensions(count, max(40, 4 * count))
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
    """Return the fastest modes of a step ``dt``, 1/gdot0, about a snapshot. Collective.

    The snapshot is the one that the restart of the parameters names. The returned form, rows and
    modes are those of `pgran.solve.spectrum.spectrum`, but each mode is that of `fastest_modes`.
    Raises `SolutionError` if none converges.
    """
    form = discretise(parameters, comm)
    found = fastest_modes(form, dt, start=states.snapshot_start(form))
    if not found:
        raise SolutionError("no multiplier of the linearised step converged. What may help: a "
                            "larger @@eps_max_it or @@eps_ncv")
    return (form, [row_of(rate, residual) for rate, residual, _ in found],
            [mode for _, _, mode in found])


def extrapolated(steps, rates):
    """Return rates extrapolated to a step of zero by the polynomial through all points.

    ``steps`` (n,) in 1/gdot0, ``rates`` (n,) in gdot0. The error of a step goes with its size.
    """
    return float(np.polynomial.polynomial.polyfit(steps, rates, len(steps) - 1)[0])


def write_mode(path, form, rate, mode, option=("output", PREFIX)):
    """Write a mode of `fastest_modes` as a result file. Collective.

    Its largest displacement is 1 d. The fields are ``displacement`` (d), ``velocity`` (d gdot0),
    ``pressure`` and perhaps ``fluidity``, on a mesh that is displaced by at most `SHOWN`. ``rate``
    is its growth rate, gdot0, and ``option`` names the file, as `pgran.output.writer.Writer` has
    it. Returns the `pgran.output.writer.Writer` and the name of a field to be drawn.
    """
    grid = form.grid
    x = states.snapshot_start(form).x if form.case.parameters.restart else (
        form.case.coordinates(grid.nodes.i, grid.nodes.j))
    mode = (mode / grid.largest(mode[:x.size])).real
    velocity, fluidity, pressure = grid.split(mode[x.size:x.size + grid.n_local])
    displacement = mode[:x.size].reshape(x.shape)
    fields = {"coordinates": x + SHOWN * displacement, "displacement": displacement,
              "velocity": velocity, "pressure": form.grid.corner_field(pressure)}
    if fluidity is not None:
        fields["fluidity"] = fluidity
    writer = write_once(path, form, fields, option, growth_rate=rate, complete=True)
    return writer, "fluidity" if "fluidity" in fields else "pressure"
