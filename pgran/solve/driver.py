"""Time steps with TS and SNES: solution, acceptance, repetition and recording.

With backward Euler each step of TS solves a `TimeStep`, and `StepController` chooses its size. With
pseudo-time continuation the mesh is frozen, and the elasticity provides the rate in pseudo-time.
"""

from dataclasses import fields

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..options import Interrupted, ParameterError, SolutionError
from ..space import coarse, diagnostics, galerkin, multigrid, schur
from ..versions import callback_error
from .controller import LEAST_SHARE, StepController
from .energy import Balance
from .failure import describe, name_of, place
from .petsc_options import check_options, matrix_type
from .state import TimeStep, steady_residual, velocity
from .tolerances import Tolerances


class AcceptedStep:
    """An accepted step, at ``time`` (1/gdot0), for `pgran.cases.Case.observe`."""

    def __init__(self, form, time, local, forces, x):
        self.form, self.time, self._local, self._forces, self._x = form, time, local, forces, x
        self._comm = form.grid.comm.tompi4py()

    def reaction(self, side):
        """Return the force (c,) on a side of the material, stress times d or d^2. Collective."""
        return self._comm.allreduce(diagnostics.reaction(self.form.grid, self._forces, side))

    def torque(self, side):
        """Return the torque about the origin or the axis on a side. Collective.

        It is in stress d^2 per unit depth, and with rotational symmetry in stress d^3.
        """
        nodes, kinematics = self._owned_nodes(side), self.form.kinematics
        x, force = self._x[:, nodes], self.form.grid.split(self._forces)[0][:, nodes]
        if kinematics.axisymmetric:
            turning = force[2] if kinematics.velocities == 3 else 0.0 * x[0]
            arms = kinematics.circumference * x[0] * turning
        else:
            arms = x[0] * force[1] - x[1] * force[0]
        return float(self._comm.allreduce(arms.sum()))

    def mean_velocity(self, side=None):
        """Return the mean velocity (c,) of a side or of the volume, d gdot0. Collective."""
        grid, x = self.form.grid, self._x
        nodal = velocity(self.form, self._local, x)
        if side:
            sums = diagnostics.side_integrals(grid, nodal, x, side)
        else:
            sums = diagnostics.integrals(grid, nodal, grid.geometry(x))
        sums = self._comm.allreduce(sums)
        return sums[:-1] / sums[-1]

    def extent(self, side):
        """Return the lengths (dim,) of a side along the coordinates, d. Collective."""
        x = self._x[:, self._owned_nodes(side)]
        highest, lowest = np.empty(len(x)), np.empty(len(x))
        self._comm.Allreduce(x.max(axis=1, initial=-np.inf), highest, MPI.MAX)
        self._comm.Allreduce(x.min(axis=1, initial=np.inf), lowest, MPI.MIN)
        return highest - lowest

    def _owned_nodes(self, side):
        return np.intersect1d(self.form.grid.side_nodes(side), self.form.grid.nodes.owned)


class Driver:
    """Solves a case in time or for its steady flow. Its methods are collective.

    Parameters
    ----------
    form, state
        Form and initial state of the run; the attribute ``state`` is the last accepted one.
    observer : callable
        ``observer(driver, landed, report)`` is called after each accepted step. ``landed`` is
        whether the step reached a target, and ``report`` contains the columns of the history.
    steady : bool
        Whether to solve for the steady flow in pseudo-time.
    targets : sequence of float, optional
        Times to reach exactly, 1/gdot0; by default the targets of the case.
    checkpoint : dict, optional
        The `values` of a checkpoint from which the run continues.
    stop_requested : callable, optional
        ``stop_requested()`` returns on each rank the reason why the run shall stop, or None.
    """

    def __init__(self, form, state, observer, steady=False, targets=None, checkpoint=None,
                 stop_requested=lambda: None):
        self.form, self.case, self.grid = form, form.case, form.grid
        self.parameters = parameters = form.case.parameters
        self.state, self.observer, self.steady = state, observer, steady
        self.comm = form.grid.comm.tompi4py()
        self._checkpoint, self._stop_requested = checkpoint or {}, stop_requested
        targets = [] if steady else form.case.targets if targets is None else targets
        unresolved = 0.1 * form.material.loading_time
        self._first_step = parameters.step_first or min(parameters.step_max, unresolved)
        self._check_sizes(targets)
        self.controller = StepController(parameters.step_error, parameters.step_max,
                                         parameters.step_growth, unresolved, targets)
        # The last accepted step: (unknowns, rates, increment), its size and its elastic rate.
        self._accepted, self._last, self._creep = None, self._first_step, 1.0
        # The attempted step: its size, its equations, its last unknowns and their residual.
        self._dt = self._step = self._tried = self._residual = None
        self._starting = False  # whether Newton's method has not yet evaluated the residual
        # Repetition: attempts of this step; (reason, remedy) of the last failure; the initial guess
        # and the term eps that remove the root mu = mu_s, and whether they were used.
        self.rejected, self._attempts, self._failure = 0, 0, None
        self._guess, self._decay, self._guarded = None, 0.0, False
        if "repeat" in self._checkpoint:
            self._attempts = 1
            self._failure = self._checkpoint["failure"], self._checkpoint["cure"]
            self._decay = self._checkpoint.get("decay", 0.0)
        self._rest_speed = getattr(parameters, "rest_speed", 0.0)
        # Whether the last step was faster than this; False at the start of a run.
        self._moving = state.dt is not None and self._fast(state)
        #: Whether the flow has come to rest, which ends the run.
        self.at_rest = bool(self._checkpoint.get("at_rest")) and self._rest_speed > 0.0 and (
            not self._moving)
        self._time = self._checkpoint.get("ts_time", 0.0 if steady else state.time)
        self.balance = None if steady else self._initial_balance()
        self.ts = self._create_ts()
        self._tolerances = Tolerances(
            self.ts.getSNES(), 0.0 if steady else parameters.tolerance_full_deviation,
            parameters.tolerance_min_factor)
        self._deviation = self._checkpoint.get("perturbation", 0.0)

    def _check_sizes(self, targets):
        """Refuse a smallest step that exceeds the first step or the distance of two targets."""
        least = self.parameters.step_min
        for before, after in zip([self.state.time, *targets], targets):
            if 0.0 < after - before < least:
                raise ParameterError(
                    "step_min", least, f"two times to reach lie closer, {self.case.label(before)} "
                    f"and {self.case.label(after)}; must be less than {after - before:.3g}")
        if self._first_step < least:
            raise ParameterError(
                "step_min", least, "the first step, a tenth of the time of elastic loading, is "
                f"smaller, {self._first_step:.3g}; use a smaller @step_min, a smaller "
                f"@shear_modulus than {self.parameters.shear_modulus:g}, or @step_first")

    def _initial_balance(self):
        if self._checkpoint:
            return Balance(*(self._checkpoint.get(field.name) for field in fields(Balance)))
        stressed = self.comm.allreduce(bool(self.state.stress.any()), MPI.LOR)
        stored, _ = self._stored_energy(self.state.local)
        power = None if stressed else 0.0  # without stress all powers are zero
        return Balance(stored, received=power, dissipated=power)

    def _create_ts(self):
        form = self.form
        kind, corrected = matrix_type(), self.parameters.coarse_correction
        if kind == PETSc.Mat.Type.NEST and galerkin.requested() and not corrected:
            kind = "blocked"
        self.matrix = form.create_matrix(kind)
        ts = PETSc.TS().create(comm=self.grid.comm)
        ts.setDM(multigrid.field_shell(form))
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setEquationType(PETSc.TS.EquationType.IMPLICIT)
        ts.setType(PETSc.TS.Type.BEULER)
        ts.setIFunction(self._ifunction, self.grid.create_vector())
        ts.setIJacobian(self._ijacobian, self.matrix, self.matrix)
        ts.setPostStep(self._post_step)
        ts.getSNES().setInitialGuess(self._predict)
        # Without an iteration a flow in time would not change. In steady flow a trust region cannot
        # reduce a residual that is a rounding error.
        ts.getSNES().setForceIteration(not self.steady)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        ts.setMaxSNESFailures(-1)  # -pgran_step_min limits the repetitions of a step
        ts.setMaxStepRejections(1000)
        ts.setMaxSteps(10**9)
        ts.setErrorIfStepFails(False)
        ts.setTime(self._time)
        ts.setStepNumber(int(self._checkpoint.get("steps", 0)))
        ts.setTimeStep(self._first_step)
        ts.setFromOptions()
        check_options(ts, self._time, self.grid.has_fluidity, corrected)
        ksp = ts.getSNES().getKSP()
        self.schur = schur.configure(ksp, form)
        self.hierarchy = galerkin.Hierarchy(ksp, form) if galerkin.requested() else None
        self._correction = coarse.correct(ksp, ts.getDM(), form) if corrected else None
        return ts

    def destroy(self):
        """Free the objects of PETSc: garbage collection does not detect their cycles."""
        dm = self.ts.getDM()  # destroyed last, so that its callbacks are freed
        self._tolerances = self.hierarchy = self.schur = None  # they refer to SNES, KSP and PC
        self.ts.destroy()
        if self._correction:
            self._correction.inner.destroy()
        dm.destroy()

    @property
    def started(self):
        """Whether a step was accepted."""
        return self._accepted is not None

    # One attempt of a step: its equations, its initial guess and its callbacks

    def time_step(self, dt):
        """Return the `TimeStep` of size ``dt`` from the last accepted state.

        Raises `SolutionError` if repeated steps have become smaller than the smallest step.
        """
        if self._dt is not None and abs(dt - self._dt) <= 1e-9 * dt:  # equal except for rounding
            return self._step
        if 0.0 < dt < self.parameters.step_min:
            least = f"@step_min {self.parameters.step_min:g}"
            if self._failure:
                raise self._step_failed(f"no step down to {least} converges")
            raise SolutionError(f"the required step {self._now} is {dt:.3g}, below {least}")
        self._attempts += 1
        # Between steps of pseudo-time TS evaluates residuals: with the elasticity of the last step.
        size = dt or (self._last if self.steady else 0.0)
        self._dt, self._step = dt, TimeStep(self.form, self.state, size, self.steady)
        return self._step

    @property
    def _now(self):
        return f"at {self.case.label(self.state.time)} (time {self.state.time:.6g})"

    def _step_failed(self, what):
        why, remedy = self._failure
        return SolutionError(f"{what} {self._now}: {why}. What may help: {remedy}")

    def _predict(self, snes, u):
        """Set the initial guess: extrapolated, or constant after a failure."""
        # A failed attempt has set the size of this one, and has left arbitrary values in u.
        dt = self.ts.getTimeStep() if self._attempts == 0 else 0.0
        if self._attempts and snes.getConvergedReason() < 0:
            self._failure = describe(snes, self.form, self._step.increment, self._tried)
            pc = snes.getKSP().getPC()
            if pc.getType() in (PETSc.PC.Type.LU, PETSc.PC.Type.CHOLESKY):
                pc.reset()  # after a failure of MUMPS PETSc would skip all later factorisations
            if self.ts.getTimeStep() > (1.0 - 1e-9) * self._dt:
                raise self._step_failed(f"a step of {self._dt:.3g} fails, and PETSc's options "
                                        "repeat it without making it smaller")
            self._decay = self.form.spurious_root(self._tried, self._step.increment)
            self._guess, self._guarded = None, False
        start = self.state.extrapolated(dt)[0] if self._guess is None else self._guess
        self.grid.from_local(start, u)
        self._starting = True
        self._tolerances.begin(snes, self._deviation)

    def _increment(self, ts, time):
        # TS evaluates a step at the time of its end, and steady residuals at the current time;
        # but TSPSEUDO of PETSc 3.26 also begins Newton's method at the current time.
        dt = ts.getTimeStep() if self._starting else time - ts.getTime()
        self._starting = False
        increment = self.time_step(dt).increment
        increment.decay = self._decay
        return increment

    def _ifunction(self, ts, time, u, rate, f):
        with PETSc.Log.Stage("Residual"):
            for reason in filter(None, self.comm.allgather(self._stop_requested())):
                raise Interrupted(reason)
            self._tried, local_rate = self.grid.to_local(u), self.grid.to_local(rate)
            rows = self.form.residual(self._tried, local_rate, self._increment(ts, time))
            if self.steady and self._dt == 0.0 and self.comm.rank == 0:
                # TS requires a norm between steps. Stress may change in equilibrium, where all
                # residuals vanish: add the elastic strain rate to the first one.
                rows[:1] = np.hypot(rows[:1], self._creep)
            self._residual = rows
            f.setArray(rows)

    def _ijacobian(self, ts, time, u, rate, shift, jacobian, preconditioner):
        with PETSc.Log.Stage("Jacobian"):
            local, increment = self.grid.to_local(u), self._increment(ts, time)
            self._tolerances.next(ts.getSNES())
            defect = self._fluidity_defect(local, rate, increment)
            self.fill(local, shift, increment, jacobian, preconditioner, defect)

    def fill(self, local, shift, increment, jacobian, preconditioner, defect=None):
        """Fill the Jacobian, as `WeakForm.jacobian` does, and its preconditioner. Collective."""
        more = self.hierarchy.filled if self.hierarchy else ()
        self.form.jacobian(local, shift, increment, preconditioner, defect, more)
        if self.schur is not None:
            self.schur.fill(local, shift, increment, preconditioner)
        if self.hierarchy:
            self.hierarchy.update(jacobian, preconditioner)

    def _fluidity_defect(self, local, rate, increment):
        """Return the defect for `WeakForm.jacobian`, or None for the tangent."""
        if not self.parameters.secant or not self.grid.has_fluidity:
            return None
        # SNES has usually evaluated the residual at these unknowns.
        known, rows = self._tried is not None and np.array_equal(local, self._tried), self._residual
        if self.comm.allreduce(not known, MPI.LOR):
            rows = self.form.residual(local, self.grid.to_local(rate), increment)
        return self.form.fluidity_defect(rows, increment)

    # The run

    def solve(self):
        """Solve until the end of the run.

        Raises `SolutionError` if no step converges, no steady flow is found, or the mesh becomes
        invalid, and `Interrupted` if the run was requested to stop.
        """
        u = self.grid.create_vector()
        self.grid.from_local(self.state.local, u)
        if not self.steady:
            first = self.controller.start(
                self.state.time, self._checkpoint.get("wanted", self.ts.getTimeStep()))
            self.ts.setTimeStep(self._checkpoint.get("repeat", first))
            if self.at_rest:
                self.controller.targets.clear()
            if self.controller.finished:
                return
        try:
            with PETSc.Log.Stage("Solve"):
                self.ts.solve(u)
        except PETSc.Error as error:
            raise callback_error(error) from None
        reason, reasons = self.ts.getConvergedReason(), PETSc.TS.ConvergedReason
        if reason < 0:
            why, remedy = self._failure or ("no step was accepted", "a smaller @step_max")
            raise SolutionError(
                f"TS stopped at {self.case.label(self.state.time)} ({name_of(reasons, reason)}): "
                f"{why}. What may help: {remedy}")
        if self.steady and reason in (reasons.CONVERGED_ITS, reasons.CONVERGED_TIME):
            raise SolutionError(
                f"no steady flow within @@ts_max_steps {self.ts.getMaxSteps()}: the residual is "
                f"{self.steady_residual():.3e} {self.case.stress_unit} d")

    # The end of a step: accept it or repeat it

    def _post_step(self, ts):
        """Accept the step that Newton's method has solved, or repeat it."""
        dt = ts.getTime() - self._time
        if dt <= 0.0:  # TS has given up, and its reason is reported by `solve`
            return
        local, step, estimate = self.grid.to_local(ts.getSolution()), self.time_step(dt), None
        step.dt = dt  # the time of TS, which differs by rounding
        if self._decay:  # solve the unmodified equations from this solution
            return self._repeat(ts, dt, local)
        # At the root mu = mu_s of F, g differs from g_loc. F + eps g, eps = mu_loc(I) - mu_s, does
        # not have it: g decreases until mu exceeds mu_loc(I). From there Newton's method converges
        # to mu_loc(I) when eps returns to zero.
        excess = self.form.spurious_root(local, step.increment)
        if excess and not self._guarded:
            return self._repeat(ts, dt, local, excess)
        if excess:
            self._failure = ("Newton's method converges to mu = mu_s, which does not solve (2.5)",
                             "a smaller @step_max")
            return self._repeat(ts, LEAST_SHARE * dt)
        stress = self.form.stress(local, step.increment)
        if not self.steady:
            estimate = step.error_estimate(local, stress, self.parameters.step_min_deviation)
            smaller = self.controller.smaller(dt, estimate.error)
            if smaller is not None:
                self._failure = (f"error estimate {estimate.error:.3g} of the last step (dt = "
                                 f"{dt:.3g}) exceeds @step_error", "a larger @step_error")
                return self._repeat(ts, smaller)
        self._accept(ts, dt, local, stress, estimate)

    def _accept(self, ts, dt, local, stress, estimate):
        """Make the end of the step the new state, choose the next step and report."""
        state, step = self.state, self._step
        end = step.end(local, stress, estimate and estimate.growth_signal)
        if not self.steady:
            self._check_mesh(end)
            self._deviation = estimate.deviation
        creep = np.abs(stress - state.stress).max(initial=0.0) / (2.0 * self.form.material.G * dt)
        self._creep = self.comm.allreduce(creep, MPI.MAX)
        self._accepted = local, (local - state.local) / dt, step.increment
        self.state, self._time, self._last = end, ts.getTime(), dt
        self._dt, self._attempts, self._failure = None, 0, None
        self._guess, self._guarded = None, False
        target = self.controller.land(end.time)
        if target is not None:
            end.time = target
        if not self.steady:
            ts.setTimeStep(self.controller.next(end.time, dt, estimate.next_error))
            fast = self._fast(end)
            self.at_rest, self._moving = self._moving and not fast, fast
            if self.at_rest:
                self.controller.targets.clear()
            if self.controller.finished:
                ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)
        self.observer(self, target is not None or self.at_rest, self._report(dt))

    def _repeat(self, ts, dt, guess=None, decay=0.0):
        """Repeat the step with size ``dt`` from a guess (n_local,) or, if None, a prediction."""
        self.rejected += 1
        self._guess, self._decay, self._guarded = guess, decay, guess is not None
        if self.steady:  # TSPSEUDO cannot roll back, and may have regarded the step as its last
            self.grid.from_local(self.state.local, ts.getSolution())
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_ITERATING)
            self._time = ts.getTime()
        else:
            ts.rollBack()
        ts.setTimeStep(dt)

    def _fast(self, state):
        """Return whether the largest velocity exceeds ``rest_speed`` > 0."""
        if not self._rest_speed:
            return False
        speed = velocity(self.form, state.local, state.x)[:, self.grid.nodes.owned]
        return self.comm.allreduce(np.abs(speed).max(initial=0.0), MPI.MAX) > self._rest_speed

    def _check_mesh(self, state):
        """Raise an error if elements are inverted or the mesh leaves its domain."""
        nodes, owned = self.grid.nodes, self.grid.nodes.owned
        x, elements = state.x[:, owned], self.grid.element_nodes[:, self.grid.elements.owned]
        element, found = self.grid.element, None
        determinants = element.least_determinant(state.x[:, elements])
        out = self.case.nodes_outside(state.time, x, *nodes.index[:, owned])
        if not (determinants > 0.0).all():
            middle = state.x[:, elements[element.nodes // 2]]
            found = "an element is inverted", middle[:, np.argmin(determinants)]
        elif out and out[0].any():
            found = out[1], x[:, np.argmax(out[0])]
        for what, at in filter(None, self.comm.allgather(found)):
            raise SolutionError(
                f"the mesh becomes invalid at {self.case.label(state.time)}: {what} "
                f"{place(at)}. What may help: an earlier end, or a smaller @step_max or "
                "@step_error")

    # Results

    def steady_residual(self):
        """Return the norm of the residual (2.9)-(2.11) of the last state without rates."""
        return steady_residual(self.form, self.state)

    def _report(self, dt):
        snes, (local, rate, increment) = self.ts.getSNES(), self._accepted
        I = self.form.inertial_number(local, increment)
        forces = self.form.forces(local, rate, increment)
        step = AcceptedStep(self.form, self.state.time, local, forces, increment.x)
        report = {
            "time": self.state.time, "step_size": dt, "courant_number": self._step.courant_number,
            "newton_iterations": snes.getIterationNumber(),
            "linear_iterations": snes.getLinearSolveIterations(),
            "inertial_number_min": self.comm.allreduce(I.min(), MPI.MIN),
            "inertial_number_max": self.comm.allreduce(I.max(), MPI.MAX), **self.case.observe(step)}
        if self.balance:
            self.balance.add(dt, *diagnostics.power(self.form, local, forces, increment))
            report.update(self.balance.report(*self._stored_energy(local)))
        return report

    def _stored_energy(self, local):
        """Return the stored energy and the volume of the last accepted state."""
        return diagnostics.stored_energy(self.form, local, self.state.stress,
                                         self.grid.geometry(self.state.x))

    def cost(self):
        """Return the numbers of steps and iterations so far, including repeated steps."""
        counts = {"steps_repeated": self.rejected + self.ts.getStepRejections(),
                  "newton_iterations": self.ts.getSNESIterations(),
                  "linear_iterations": self.ts.getKSPIterations()}
        return {"steps": self.ts.getStepNumber(), **{
            name: int(self._checkpoint.get(name, 0)) + count for name, count in counts.items()}}

    def values(self, repeat=True):
        """Return the numbers of a checkpoint, the argument ``checkpoint`` of `Driver`. Collective.

        A restart repeats a failed attempt of the next step unless ``repeat`` is False.
        """
        found = {**self.cost(), **vars(self.balance), **self.state.values(self.grid),
                 "ts_time": self._time, "wanted": self.controller.wanted or self._first_step,
                 "perturbation": self._deviation, "at_rest": int(self.at_rest)}
        if repeat and self._failure is not None:
            found["repeat"] = self.ts.getTimeStep()
            found["failure"], found["cure"] = self._failure
            found["decay"] = self._decay if self._guess is None else 0.0
        return found

    def fields(self):
        """Return the nodal fields of the last state for `Writer.snapshot`, {name: (..., n_nodes)}.

        Ghost nodes may lack contributions of other ranks.
        """
        (local, _, increment), form, x = self._accepted, self.form, self.state.x
        speed, fields = velocity(form, local, x), diagnostics.nodal_fields(form, local, increment)
        kinematics = form.kinematics
        deviator = form.grid.at_nodes(kinematics.tensor(self.state.stress))
        pressure = np.multiply.outer(kinematics.diagonal, fields["pressure"])
        return {"coordinates": x, "velocity": speed, **fields, "deviator": deviator,
                "stress_tensor": deviator - pressure, **diagnostics.nodal_strains(form, speed, x)}
