"""SNES and TS: the step, its size, its acceptance, and what is committed after it.

`Evolution` drives `weakform` through time. With ``-ts_type beuler`` the mesh
moves with the material: a step predicts the mesh at its end to second order
(Adams-Bashforth), turns the last two stresses with the material, solves there with
the stress rate of BDF2, and after acceptance moves the mesh by the trapezoidal rule
and keeps the new stress. The size of the steps follows their departure from the
extrapolation of the last ones.
With ``-ts_type pseudo`` the mesh is frozen, nothing turns, and the elastic
element alone makes the pseudo-time, so that the steady state is rigid-viscous.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from . import fieldsplit, rheology
from .element import SHAPE
from .options import OptionError
from .results import read_mode, read_snapshot
from .weakform import Step


class StepError(RuntimeError):
    """A run cannot go on: no step down to the smallest one converges."""


class State:
    """The last accepted state of a rank: all that a step starts from.

    ``time``; ``x`` (2, n_nodes) mesh; ``local`` (n_local,) unknowns; ``stress``
    (3, 9, n) deviator; of the step before it, None at the start: ``dt`` its size,
    ``earlier`` the stress it started from, turned with the material, ``rate``
    (n_local,) the difference quotient of the unknowns. Units d, |sigma_1|, 1/gdot0.
    """

    def __init__(self, time, x, local, stress, dt=None, earlier=None, rate=None):
        self.time, self.x, self.local, self.stress = time, x, local, stress
        self.dt, self.earlier = dt, earlier
        self.rate = np.zeros_like(local) if rate is None else rate

    def extrapolated(self, dt):
        """Return the unknowns and the stress on the line through the last two states."""
        if self.dt is None:
            return self.local, self.stress
        return (self.local + dt * self.rate,
                self.stress + dt / self.dt * (self.stress - self.earlier))

    def past(self, dt, angle):
        """Return the factor f and the stress S of a step ``dt`` that turns by ``angle`` (9, n).

        d(sigma')/dt = f (sigma' - S)/dt, that of BDF2, or of backward Euler at the start.
        """
        stress = rheology.rotated(self.stress, angle)
        if self.dt is None:
            return 1.0, stress
        ratio = dt / self.dt
        factor = (1.0 + 2.0 * ratio) / (1.0 + ratio)
        earlier = rheology.rotated(self.earlier, angle)
        return factor, ((1.0 + ratio) * stress - ratio**2 / (1.0 + ratio) * earlier) / factor


def rest(form):
    """Return the `State` at rest before loading: no stress deviator, no fluidity."""
    grid, case = form.grid, form.case
    x = case.coordinates(grid.nodes.i, grid.nodes.j)
    local = grid.join(case.start(x), np.zeros(grid.nodes.size),
                      np.full(grid.corners.size, case.start_pressure()))
    return State(0.0, x, local, np.zeros((3, 9, grid.n_elements)))


def homogeneous(form):
    """Return the `State` of homogeneous rigid-viscous flow, with the mode of ``-pgran_seed``.

    Raises `OptionError` where the mode does not fit. Collective with a mode.
    """
    grid, case, material, settings = form.grid, form.case, form.material, form.case.settings
    nodes, corners = grid.nodes, grid.corners
    x = case.coordinates(nodes.i, nodes.j)
    local = grid.join(case.start(x), np.full(nodes.size, material.fluidity),
                      np.full(corners.size, material.pressure))
    if settings.seed:
        mode = read_mode(settings, nodes, grid.comm.tompi4py())
        pressure = mode["pressure"][nodes.index(2 * corners.i, 2 * corners.j)]
        local = local + settings.seed_size * grid.join(
            mode["velocity"], mode.get("fluidity"), pressure)
    free, still = np.full(grid.n_local, np.nan), np.zeros((3, 9, grid.n_elements))
    return State(0.0, x, local, form.stress(local, Step(form, x, still, 0.0, free, free)))


def steady_start(form):
    """Return the `State` from which steady flow is sought.

    That of the snapshot which ``-pgran_restart`` names, or homogeneous flow at P0
    and g0 on the initial geometry. Raises `OptionError` where the snapshot does not fit.
    """
    grid, settings = form.grid, form.case.settings
    nodes, corners = grid.nodes, grid.corners
    if not settings.restart:
        return homogeneous(form)
    if any(grid.periodic):
        raise OptionError(f"-pgran_restart {settings.restart}: not for -pgran_case "
                          f"{settings.case}")
    attributes, fields = read_snapshot(settings, nodes, grid.comm.tompi4py())
    pressure = fields["pressure"][nodes.index(2 * corners.i, 2 * corners.j)]
    local = grid.join(fields["velocity"], fields["fluidity"], pressure)
    stress = SHAPE @ fields["deviator"][:, grid.element_nodes]
    return State(float(attributes["time"]), fields["coordinates"], local, stress)


def velocity(form, local, x):
    """Return the velocity (2, n_nodes) of material at nodes ``x``, base flow included, d gdot0."""
    return form.grid.split(local)[0] + form.case.base_gradient @ x


def setting(form, state, dt, frozen=False):
    """Return the `Step` of size ``dt`` from a state, and the angle (9, n) by which it turns stress.

    The mesh is predicted to second order; with a ``frozen`` mesh, or for ``dt`` = 0, which gives
    the rigid-viscous equations as they stand, nothing moves or turns.
    """
    x, stress, end, factor, angle = state.x, state.stress, state.time, 1.0, 0.0
    if dt > 0.0 and not frozen:
        middle = velocity(form, state.local + 0.5 * dt * state.rate, state.x)
        x = state.x + dt * middle
        angle = dt * form.spin(middle, 0.5 * (state.x + x))
        factor, stress = state.past(dt, angle)
        end = state.time + dt
    values = form.prescribed(end)
    rates = np.zeros_like(values)
    if end > state.time:
        rates = (values - form.prescribed(state.time)) / dt
    theta = factor * form.material.elastic_compliance(dt)
    return Step(form, x, stress, theta, values, rates), angle


def moved(form, state, step, local, dt):
    """Return the mesh (2, n_nodes) at the end of a step, by the trapezoidal rule."""
    mean = 0.5 * (velocity(form, state.local, state.x) + velocity(form, local, step.x))
    return state.x + dt * mean


class Evolution:
    """Steps a case through time with TS. Making, solving and asking for results are collective.

    Parameters: ``form`` `weakform.WeakForm`, ``settings`` `options.Settings`,
    ``state`` the initial `State`, ``targets`` the times to land on exactly, in
    increasing order, the last one ending the run (none with a frozen mesh, where
    TSPSEUDO decides). ``observer(evolution, report)`` is called after each accepted
    step. Attributes: ``state``, the last accepted one; ``frozen``; ``rejected``, how
    many steps were repeated.
    """

    def __init__(self, form, settings, state, targets, observer):
        self.form, self.case, self.grid = form, form.case, form.grid
        self.settings, self.state, self.observer = settings, state, observer
        self.frozen = frozen()
        self.targets = list(targets)
        self.comm = self.grid.comm.tompi4py()
        self.rejected = 0
        self._dt = self._step = self._committed = self._free_step = None
        self._attempts, self._starting = 0, False
        self._time = 0.0 if self.frozen else state.time
        self._resolved = 0.1 * form.material.loading_time  # yielding as a whole is not
        self.ts = self._create_ts()

    def _create_ts(self):
        form = self.form
        self.matrix, self._residual_vector = form.create_matrix(), self.grid.create_vector()
        self.schur = None
        ts = PETSc.TS().create(comm=self.grid.comm)
        ts.setDM(fieldsplit.field_shell(form))
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setEquationType(PETSc.TS.EquationType.IMPLICIT)
        ts.setType(PETSc.TS.Type.BEULER)
        ts.setIFunction(self._ifunction, self._residual_vector)
        ts.setIJacobian(self._ijacobian, self.matrix, self.matrix)
        ts.setPostStep(self._post_step)
        ts.getSNES().setInitialGuess(self._predict)
        ts.getSNES().setForceIteration(True)  # a step that needs none has not moved
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        ts.setMaxSNESFailures(-1)  # -pgran_step_min ends the repetition of a step
        ts.setMaxStepRejections(1000)
        ts.setMaxSteps(10**9)
        ts.setErrorIfStepFails(False)
        ts.setTime(self._time)
        ts.setTimeStep(self.first_step())
        ts.setFromOptions()
        self.schur = fieldsplit.configure(ts.getSNES().getKSP(), form)
        return ts

    @property
    def started(self):
        """Whether a step was accepted."""
        return self._committed is not None

    def first_step(self):
        """Return the first time step, 1/gdot0."""
        return self.settings.step_first or min(self.settings.step_max, self._resolved)

    # What a step is solved with

    def step(self, dt):
        """Return the `Step` of size ``dt``; 0 gives the rigid-viscous equations as they stand.

        Raises `StepError` below ``-pgran_step_min``, to which failed steps have then shrunk.
        """
        if self._dt is not None and abs(dt - self._dt) <= 1e-9 * dt:  # equal but for rounding
            return self._step
        if 0.0 < dt < self.settings.step_min:
            raise StepError(f"no step down to -pgran_step_min {self.settings.step_min:g} "
                            f"converges at time {self.state.time:.6g}")
        self._attempts += 1
        self._dt = dt
        self._step, self._angle = setting(self.form, self.state, dt, self.frozen)
        return self._step

    def _current_step(self, ts, time):
        # TS evaluates a step at the time it leads to, and steady residuals at the present one;
        # but the TSPSEUDO of PETSc 3.26 starts each step's Newton method at the present one too.
        dt = ts.getTimeStep() if self._starting else time - ts.getTime()
        self._starting = False
        return self.step(dt)

    def _ifunction(self, ts, time, u, rate, f):
        with PETSc.Log.Stage("Residual"):
            grid = self.grid
            local, local_rate = grid.to_local(u), grid.to_local(rate)
            f.setArray(self.form.residual(local, local_rate, self._current_step(ts, time)))

    def _ijacobian(self, ts, time, u, rate, shift, jacobian, preconditioner):
        with PETSc.Log.Stage("Jacobian"):
            local, step = self.grid.to_local(u), self._current_step(ts, time)
            self.form.jacobian(local, shift, step, preconditioner)
            if self.schur is not None:
                self.form.pressure_mass(local, step, self.schur)

    # Acceptance

    def solve(self):
        """Run to the end. Raises `StepError` where no step converges, or no flow becomes steady."""
        u = self.grid.create_vector()
        self.grid.from_local(self.state.local, u)
        if not self.frozen:
            self._aim(self.ts.getTimeStep())
        try:
            with PETSc.Log.Stage("Solve"):
                self.ts.solve(u)
        except PETSc.Error as error:  # petsc4py 3.26 wraps what a callback raises, 3.18 does not
            if isinstance(error.__cause__, (StepError, OptionError)):
                raise error.__cause__ from None
            raise
        reason, reasons = self.ts.getConvergedReason(), PETSc.TS.ConvergedReason
        if reason < 0:
            raise StepError(f"TS stopped with reason {reason} at time {self._time:.6g}")
        if self.frozen and reason in (reasons.CONVERGED_ITS, reasons.CONVERGED_TIME):
            raise StepError(f"no steady flow within -ts_max_steps {self.ts.getMaxSteps()}: the "
                            f"residual is {self.steady_residual():.3e} |sigma_1| d")

    def steady_residual(self):
        """Return the norm of the rigid-viscous residual (2.9)-(2.11) of the present state."""
        with np.errstate(invalid="ignore", divide="ignore"):
            rows = self.form.residual(self.state.local, np.zeros(self.grid.n_local), self.step(0.0))
        return float(np.sqrt(self.comm.allreduce(rows @ rows)))

    def _predict(self, snes, u):
        """Start Newton's method from the last two states; from the last alone after a failure."""
        # A failed attempt has called `step` before, and may have left anything in u.
        dt = self.ts.getTimeStep() if self._attempts == 0 else 0.0
        self.grid.from_local(self.state.extrapolated(dt)[0], u)
        self._starting = True

    def _post_step(self, ts):
        state, settings = self.state, self.settings
        dt = ts.getTime() - self._time
        if dt <= 0.0:  # TS gave up, and says why in its reason
            return
        local = self.grid.to_local(ts.getSolution())
        step = self.step(dt)
        stress = self.form.stress(local, step)
        if not self.frozen:
            departure = self._departure(local, stress, dt)
            if departure > 2.0 * settings.step_error and dt > 2.0 * self._resolved:
                self.rejected += 1
                ts.rollBack()
                ts.setTimeStep(max(0.3, np.sqrt(settings.step_error / departure)) * dt)
                return
        self._committed = local, (local - state.local) / dt, step
        self.state = self._accepted(stress, dt)
        self._time, self._dt, self._attempts = ts.getTime(), None, 0
        landed = bool(self.targets) and self.state.time >= self.targets[0] * (1.0 - 1e-12)
        if landed:
            self.state.time = self.targets.pop(0)
        snes, I = ts.getSNES(), self.form.inertial_number(local, step)
        self.observer(self, {
            "landed": landed,  # on the next of the targets
            "step_size": dt,
            "newton_iterations": snes.getIterationNumber(),
            "linear_iterations": snes.getLinearSolveIterations(),
            "inertial_number_min": self.comm.allreduce(I.min(), MPI.MIN),
            "inertial_number_max": self.comm.allreduce(I.max(), MPI.MAX)})
        if not self.frozen:
            self._choose_step(dt, departure)

    def _accepted(self, stress, dt):
        """The state at the end of the step that was just solved: moved mesh, new stress."""
        state, (local, rate, step) = self.state, self._committed
        if self.frozen:
            return State(state.time, state.x, local, stress)
        return State(state.time + dt, moved(self.form, state, step, local, dt), local, stress, dt,
                     rheology.rotated(state.stress, self._angle), rate)

    def _departure(self, local, stress, dt):
        """The departure from the extrapolation of the last two states, which limits the step.

        The larger of max|v - v*| / max|v - v0| and max|sigma' - sigma'*| / (mu_s P0), with v* and
        sigma'* extrapolated and v0 the homogeneous flow: a growing perturbation counts by its
        own size from ``-pgran_step_perturbation`` times max|v| on.
        """
        state, owned, settings = self.state, self.grid.nodes.owned, self.settings
        expected, expected_stress = state.extrapolated(dt)
        x = self._step.x
        now, then = (velocity(self.form, unknowns, x)[:, owned] for unknowns in (local, expected))
        homogeneous = (self.case.start(x) + self.case.base_gradient @ x)[:, owned]
        off, size, apart, stress_off = (
            self.comm.allreduce(np.abs(part).max(initial=0.0), MPI.MAX) for part in
            (now - then, now, now - homogeneous, stress - expected_stress))
        scale = max(apart, settings.step_perturbation * size)
        return max(off / scale, stress_off / self.form.material.yield_stress)

    def _choose_step(self, dt, departure):
        settings = self.settings
        if not self.targets:
            self.ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)
            return
        wanted = dt * min(settings.step_growth,
                          0.9 * np.sqrt(settings.step_error / max(departure, 1e-300)))
        wanted = max(wanted, min(self._resolved, dt * settings.step_growth))
        if self._free_step is not None:  # the last step was cut to land on a target
            wanted = max(wanted, self._free_step)
        self._aim(min(wanted, settings.step_max))

    def _aim(self, wanted):
        """Set the next step to ``wanted``, or to what lands on the next target without a sliver."""
        left = self.targets[0] - self.state.time
        dt = left if wanted >= left * (1.0 - 1e-9) else min(wanted, 0.5 * left)
        self._free_step = wanted if dt < wanted else None
        self.ts.setTimeStep(dt)

    # What observers ask for

    def cost(self):
        """Return the steps and iterations so far, those of repeated steps included."""
        ts = self.ts
        return {"steps": ts.getStepNumber(),
                "steps_repeated": self.rejected + ts.getStepRejections(),
                "newton_iterations": ts.getSNESIterations(),
                "linear_iterations": ts.getKSPIterations()}

    def plate_stress(self):
        """Return the mean normal stress on the plate in the last step, |sigma_1|; nan without one.

        The force on the plate over its width.
        """
        side = self.case.plate
        if side is None:
            return float("nan")
        local, rate, step = self._committed
        force = self.comm.allreduce(self.form.reaction(local, rate, step, side)[1])
        nodes = np.intersect1d(self.grid.side_nodes(side), self.grid.nodes.owned)
        x = step.x[0, nodes]
        right = self.comm.allreduce(x.max(initial=-np.inf), MPI.MAX)
        return force / (right - self.comm.allreduce(x.min(initial=np.inf), MPI.MIN))

    def fields(self):
        """Return the nodal fields of the last state, {name: (..., n_nodes)}, for `Writer.snapshot`.

        Complete at owned nodes.
        """
        local, _, step = self._committed
        return {"coordinates": self.state.x, "velocity": velocity(self.form, local, self.state.x),
                **self.form.nodal_fields(local, step),
                "deviator": np.array([self.form.at_nodes(part) for part in self.state.stress])}


def frozen():
    """Whether ``-ts_type`` asks for pseudo-time on a frozen mesh. Raises `OptionError`."""
    kind = PETSc.Options().getString("ts_type", PETSc.TS.Type.BEULER)
    if kind not in (PETSc.TS.Type.BEULER, PETSc.TS.Type.PSEUDO):
        raise OptionError(f"-ts_type {kind}: allowed is beuler | pseudo")
    return kind == PETSc.TS.Type.PSEUDO
