"""TS and SNES drive a form through time steps.

With backward Euler each step of TS is a `TimeStep`; `StepController` says how large it is. With
pseudo-time continuation the mesh is frozen, and the elastic element makes the pseudo-time.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..options import Interrupted, OptionError, ParameterError, SolutionError
from ..space import coarse, diagnostics, galerkin, multigrid, schur
from ..space.element import DIM, NODES, Geometry, least_determinant
from ..versions import callback_error
from .controller import LEAST_SHARE, StepController
from .energy import Balance
from .failure import described, name_of
from .state import TimeStep, frozen, velocity
from .tolerances import Tolerances

#: What a callback may raise on all ranks together.
ERRORS = SolutionError, ParameterError, OptionError, Interrupted


def matrix_type():
    """Return which matrix ``-dm_mat_type`` asks for, aij or nest.

    Raises `pgran.options.ParameterError` for another one.
    """
    kind = PETSc.Options().getString("dm_mat_type", PETSc.Mat.Type.AIJ)
    if kind not in (PETSc.Mat.Type.AIJ, PETSc.Mat.Type.NEST):
        raise ParameterError("dm_mat_type", kind, "allowed is aij or nest", prefix="")
    return kind


class AcceptedStep:
    """An accepted step as a case observes it, see `pgran.cases.Case.observe`.

    Attributes
    ----------
    time : float
        1/gdot0.
    """

    def __init__(self, form, time, local, forces, x):
        self.form, self.time, self._local, self._forces, self._x = form, time, local, forces, x
        self._comm = form.grid.comm.tompi4py()

    def reaction(self, side):
        """Return the force (2,) on a side of the material, stress times d. Collective."""
        return self._comm.allreduce(diagnostics.reaction(self.form.grid, self._forces, side))

    def torque(self, side):
        """Return the torque about the origin on a side, stress times d^2. Collective."""
        grid = self.form.grid
        nodes = np.intersect1d(grid.side_nodes(side), grid.nodes.owned)
        x, force = self._x[:, nodes], grid.split(self._forces)[0][:, nodes]
        return float(self._comm.allreduce((x[0] * force[1] - x[1] * force[0]).sum()))

    def mean_velocity(self, side=None):
        """Return the mean velocity (2,) along a side, or over the volume, d gdot0. Collective.

        The base flow is included.
        """
        form, x = self.form, self._x
        nodal = velocity(form, self._local, x)
        if side:
            sums = diagnostics.side_integrals(form.grid, nodal, x, side)
        else:
            sums = diagnostics.integrals(
                form.grid, nodal, Geometry(x[:, form.grid.element_nodes]))
        sums = self._comm.allreduce(sums)
        return sums[:DIM] / sums[DIM]

    def extent(self, side):
        """Return the lengths (2,) of a side along x1 and x2, d. Collective."""
        grid = self.form.grid
        nodes = np.intersect1d(grid.side_nodes(side), grid.nodes.owned)
        x = self._x[:, nodes]
        highest, lowest = np.empty(len(x)), np.empty(len(x))
        self._comm.Allreduce(x.max(axis=1, initial=-np.inf), highest, MPI.MAX)
        self._comm.Allreduce(x.min(axis=1, initial=np.inf), lowest, MPI.MIN)
        return highest - lowest


class Driver:
    """Drives a case through time. Making it, solving and asking for results are collective.

    Parameters
    ----------
    form : pgran.space.weakform.WeakForm
    state : pgran.solve.state.State
        Where the run starts.
    observer : callable
        ``observer(driver, landed, report)`` is called after each accepted step. ``landed`` says
        whether the step reached a target, and ``report`` holds a value for each column of the
        history.
    steady : bool
        Whether to find the steady flow by pseudo-time instead of following the flow in time.
    targets : sequence of float, optional
        Times to land on, 1/gdot0; those of the case unless given.
    behind : dict, optional
        The `values` of a checkpoint that the run goes on from.
    interrupted : callable, optional
        ``interrupted()`` says on each rank whether the run shall stop, as a text, or None.

    Attributes
    ----------
    state : pgran.solve.state.State
        The last accepted state.
    controller : pgran.solve.controller.StepController
    rejected : int
        How many steps were repeated because they departed too far.
    at_rest : bool
        Whether the flow has come to rest, which ends the run.
    """

    def __init__(self, form, state, observer, steady=False, targets=None, behind=None,
                 interrupted=None):
        self.form, self.case, self.grid = form, form.case, form.grid
        self.parameters, self.state, self.observer = form.case.parameters, state, observer
        self.steady, self.comm, self.rejected = steady, form.grid.comm.tompi4py(), 0
        self._behind, self._interrupted = dict(behind or {}), interrupted or (lambda: None)
        parameters, unresolved = self.parameters, 0.1 * form.material.loading_time
        targets = [] if steady else form.case.targets if targets is None else targets
        self._check_targets(targets)
        self.controller = StepController(parameters.step_error, parameters.step_max,
                                         parameters.step_growth, unresolved, targets)
        self._first_step = parameters.step_first or min(parameters.step_max, unresolved)
        if self._first_step < parameters.step_min:
            raise ParameterError(
                "step_min", parameters.step_min, "the first step, a tenth of the time of elastic "
                f"loading, is {self._first_step:.3g}, which is smaller; allowed is less than it, a "
                f"smaller @shear_modulus than {parameters.shear_modulus:g}, or a @step_first")
        self._dt = self._step = self._committed = self._tried = self._rows = None
        self._last, self._creep = self._first_step, 1.0
        self._attempts, self._starting, self._failure = 0, False, None
        self._decay, self._guess, self._guarded = 0.0, None, False
        if "repeat" in self._behind:
            self._attempts = 1
            self._failure = tuple(self._behind[name] for name in ("failure", "cure"))
            self._decay = self._behind.get("decay", 0.0)
        #: Whether the last step was faster than ``rest_speed``; a run that begins has none.
        self._moving = state.dt is not None and self._fast(state)
        self.at_rest = bool(self._behind.get("at_rest")) and self._rest_speed > 0.0 and (
            not self._moving)
        self._time = self._behind.get("ts_time", 0.0 if steady else state.time)
        self.balance = None if steady else self._balance()
        self.ts = self._create_ts()
        self._tolerances = Tolerances(self.ts.getSNES(), 0.0 if self.steady else
                                      parameters.tolerance_full_deviation, parameters.tolerance_min_factor)
        self._perturbation = self._behind.get("perturbation", 0.0)

    def _check_targets(self, targets):
        least = self.parameters.step_min
        for before, after in zip([self.state.time, *targets], targets):
            if 0.0 < after - before < least:
                raise ParameterError(
                    "step_min", least, f"two times to reach lie closer, {self.case.label(before)} "
                    f"and {self.case.label(after)}; allowed is less than {after - before:.3g}")

    def _balance(self):
        names = "stored", "work", "dissipation", "received", "dissipated"
        if self._behind:
            return Balance(**{name: self._behind.get(name) for name in names})
        state, still = self.state, not self.comm.allreduce(bool(self.state.stress.any()), MPI.LOR)
        stored, _ = diagnostics.stored_energy(self.form, state.local, state.stress,
                                              Geometry(state.x[:, self.grid.element_nodes]))
        power = 0.0 if still else None  # without stress nothing works yet
        return Balance(stored, received=power, dissipated=power)

    def _create_ts(self):
        form = self.form
        kind = matrix_type()
        if kind == PETSc.Mat.Type.NEST and galerkin.requested() and not (
                self.parameters.coarse_correction):
            kind = "blocked"
        self.matrix = form.create_matrix(kind)
        self._residual_vector = self.grid.create_vector()
        self.schur = self.hierarchy = self._correction = None
        ts = PETSc.TS().create(comm=self.grid.comm)
        ts.setDM(multigrid.field_shell(form))
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setEquationType(PETSc.TS.EquationType.IMPLICIT)
        ts.setType(PETSc.TS.Type.BEULER)
        ts.setIFunction(self._ifunction, self._residual_vector)
        ts.setIJacobian(self._ijacobian, self.matrix, self.matrix)
        ts.setPostStep(self._post_step)
        ts.getSNES().setInitialGuess(self._predict)
        ts.getSNES().setForceIteration(True)  # a step that needs none has not moved
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        ts.setMaxSNESFailures(-1)  # the smallest step ends the repetition of a step
        ts.setMaxStepRejections(1000)
        ts.setMaxSteps(10**9)
        ts.setErrorIfStepFails(False)
        ts.setTime(self._time)
        ts.setStepNumber(int(self._behind.get("steps", 0)))
        ts.setTimeStep(self._first_step)
        ts.setFromOptions()
        self._check_options(ts)
        ksp = ts.getSNES().getKSP()
        self.schur = schur.configure(ksp, form)
        self.hierarchy = galerkin.Hierarchy(ksp, form) if galerkin.requested() else None
        if self.parameters.coarse_correction:
            self._correction = coarse.correct(ksp, ts.getDM(), form)
        return ts

    def _check_options(self, ts):
        """Refuse options of PETSc with which a run would never end, or not as it should."""
        def check(name, value, good, allowed):
            if not good:
                raise ParameterError(name, f"{value:g}", f"allowed is {allowed}", prefix="")

        check("ts_max_steps", ts.getMaxSteps(), ts.getMaxSteps() >= 1, "an integer >= 1")
        check("ts_init_time", ts.getTime(), ts.getTime() == self._time,
              f"{self._time:g}, where this run begins")
        database = PETSc.Options()
        for name in ("ts_dt", "ts_time_step"):  # the latter from PETSc 3.23 on
            if database.hasName(name):
                raise ParameterError(name, database.getString(name), "the size of a step follows "
                                     "from @step_first, @step_max and @step_error; allowed are "
                                     "these", prefix="")
        # PETSc 3.26 takes a negative number as no limit.
        most = database.getInt("snes_max_it", ts.getSNES().getTolerances()[3])
        check("snes_max_it", most, most >= 1, "an integer >= 1")
        for name in ("snes_error_if_not_converged", "ksp_error_if_not_converged",
                     "ts_error_if_step_fails"):
            check(name, 1, not database.getBool(name, False),
                  "false: a step that fails is repeated smaller")
        if matrix_type() == PETSc.Mat.Type.NEST:
            self._check_blocks(ts.getSNES().getKSP().getPC().getType(), database, check)
        elif self.parameters.coarse_correction:
            raise ParameterError("coarse_correction", "true", "it takes the Jacobian as blocks; "
                                 "allowed with @@dm_mat_type nest")
        share = database.getReal("ts_adapt_scale_solve_failed", 0.25)
        check("ts_adapt_scale_solve_failed", share, 0.0 < share < 1.0, "a number > 0 and < 1: a "
              "step that fails is repeated smaller")

    def _check_blocks(self, solver, database, check):
        """Refuse options that do not take a Jacobian of blocks as it is."""
        rules = [("pc_type", solver, PETSc.PC.Type.FIELDSPLIT)]
        if self.grid.has_fluidity:  # without it no other split is possible
            joined = database.getString("pc_fieldsplit_0_fields", "0")
            rules.append(("pc_fieldsplit_0_fields", joined, "0,1"))
        for option, found, good in rules:
            if found != good:
                raise ParameterError("dm_mat_type", "nest", f"not with @@{option} {found}; allowed "
                                     f"with {good}", prefix="")
        # The solver of a block has the block itself, so that nothing in it can be older.
        lag = database.getInt("snes_lag_preconditioner", 1)
        check("snes_lag_preconditioner", lag, lag == 1, "1 with @@dm_mat_type nest")

    def destroy(self):
        """Free the objects of PETSc, so that Python can free the rest. Collective.

        TS and SNES hold methods of the driver as their callbacks, and the driver holds TS and SNES.
        Python's collector of cycles does not see the references within PETSc.
        """
        dm = self.ts.getDM()  # to end last, or what its callbacks refer to would stay
        self._tolerances = self.hierarchy = self.schur = None  # they hold SNES, KSP and PC
        self.ts.destroy()
        if self._correction:
            self._correction.inner.destroy()
            self._correction = None
        dm.destroy()

    @property
    def started(self):
        """Whether a step was accepted."""
        return self._committed is not None

    # What a step is solved with

    def time_step(self, dt):
        """Return the `TimeStep` of size ``dt`` from the last accepted state.

        Raises
        ------
        SolutionError
            If failed steps have shrunk below the smallest one.
        """
        if self._dt is not None and abs(dt - self._dt) <= 1e-9 * dt:  # equal but for rounding
            return self._step
        if 0.0 < dt < self.parameters.step_min:
            least = f"@step_min {self.parameters.step_min:g}"
            if self._failure is None:
                raise SolutionError(f"the step that is wanted {self._now} is {dt:.3g}, below "
                                    f"{least}")
            raise self._given_up(f"no step down to {least} converges")
        self._attempts += 1
        # Between steps of pseudo-time TS asks for residuals: those of the last step's elasticity.
        whole = dt or (self._last if self.steady else 0.0)
        self._dt, self._step = dt, TimeStep(self.form, self.state, whole, self.steady)
        return self._step

    @property
    def _now(self):
        return f"at {self.case.label(self.state.time)} (time {self.state.time:.6g})"

    def _given_up(self, what):
        """Return the error of a step that is not tried again, with why the last attempt failed."""
        why, cure = self._failure
        return SolutionError(f"{what} {self._now}: {why}. What may help: {cure}")

    def _increment(self, ts, time):
        # TS evaluates a step at the time it leads to, and steady residuals at the present one;
        # but the TSPSEUDO of PETSc 3.26 starts each step's Newton method at the present one too.
        dt = ts.getTimeStep() if self._starting else time - ts.getTime()
        self._starting = False
        increment = self.time_step(dt).increment
        increment.decay = self._decay
        return increment

    def _ifunction(self, ts, time, u, rate, f):
        with PETSc.Log.Stage("Residual"):
            self._stop_if_asked()
            grid = self.grid
            self._tried, local_rate = grid.to_local(u), grid.to_local(rate)
            rows = self.form.residual(self._tried, local_rate, self._increment(ts, time))
            if self.steady and self._dt == 0.0:
                # TS needs a norm between steps. Stress may grow in equilibrium, where all rows
                # vanish: the elastic strain rate joins the first row of all ranks.
                if self.comm.rank == 0:
                    rows[:1] = np.hypot(rows[:1], self._creep)
            self._rows = rows
            f.setArray(rows)

    def _ijacobian(self, ts, time, u, rate, shift, jacobian, preconditioner):
        with PETSc.Log.Stage("Jacobian"):
            local, increment = self.grid.to_local(u), self._increment(ts, time)
            self._tolerances.next(ts.getSNES())
            defect = self._fluidity_defect(local, rate, increment)
            self.fill(local, shift, increment, jacobian, preconditioner, defect)

    def fill(self, local, shift, increment, jacobian, preconditioner, defect=None):
        """Fill the Jacobian, as `WeakForm.jacobian` does, and what preconditions it. Collective."""
        more = self.hierarchy.filled if self.hierarchy else ()
        self.form.jacobian(local, shift, increment, preconditioner, defect, more)
        if self.schur is not None:
            self.schur.fill(local, shift, increment, preconditioner)
        if self.hierarchy:
            self.hierarchy.update(jacobian, preconditioner)

    def _fluidity_defect(self, local, rate, increment):
        """The defect that `WeakForm.jacobian` asks for, or None for the tangent. Collective."""
        if not self.parameters.secant or not self.grid.has_fluidity:
            return None
        # SNES has just asked for the residual there.
        known, rows = self._tried is not None and np.array_equal(local, self._tried), self._rows
        if self.comm.allreduce(not known, MPI.LOR):
            rows = self.form.residual(local, self.grid.to_local(rate), increment)
        return self.form.fluidity_defect(rows, increment)

    def _stop_if_asked(self):
        """Raise `Interrupted` on all ranks if one of them was asked to stop."""
        asked = [text for text in self.comm.allgather(self._interrupted()) if text]
        if asked:
            raise Interrupted(asked[0])

    # Acceptance

    def solve(self):
        """Run to the end.

        Raises
        ------
        SolutionError
            If no step converges, no flow becomes steady, or the mesh cannot go on.
        Interrupted
            If the run was asked to stop.
        """
        u = self.grid.create_vector()
        self.grid.from_local(self.state.local, u)
        if not self.steady:
            first = self.controller.start(
                self.state.time, self._behind.get("wanted", self.ts.getTimeStep()))
            self.ts.setTimeStep(self._behind.get("repeat", first))
            if self.at_rest:
                self.controller.targets.clear()
            if self.controller.finished:
                return
        try:
            with PETSc.Log.Stage("Solve"):
                self.ts.solve(u)
        except PETSc.Error as error:
            raised = callback_error(error)
            if isinstance(raised, ERRORS):
                raise raised from None
            raise
        reason, reasons = self.ts.getConvergedReason(), PETSc.TS.ConvergedReason
        if reason < 0:
            why, cure = self._failure or ("no step was accepted", "a smaller @step_max")
            raise SolutionError(
                f"TS stopped at {self.case.label(self.state.time)} ({name_of(reasons, reason)}): "
                f"{why}. What may help: {cure}")
        if self.steady and reason in (reasons.CONVERGED_ITS, reasons.CONVERGED_TIME):
            raise SolutionError(
                f"no steady flow within @@ts_max_steps {self.ts.getMaxSteps()}: the residual is "
                f"{self.steady_residual():.3e} {self.case.stress_unit} d")

    def steady_residual(self):
        """Return the norm of the residual (2.9)-(2.11) of the present state without rates."""
        with np.errstate(invalid="ignore", divide="ignore"):
            rows = self.form.residual(self.state.local, np.zeros(self.grid.n_local),
                                      frozen(self.form, self.state))
        return float(np.sqrt(self.comm.allreduce(rows @ rows)))

    def _predict(self, snes, u):
        """Start Newton's method from the last two states; only from the last after a failure."""
        # A failed attempt has made a step before, and may have left anything in u.
        dt = self.ts.getTimeStep() if self._attempts == 0 else 0.0
        if self._attempts and snes.getConvergedReason() < 0:
            self._failure = described(snes, self.form, self._step.increment, self._tried)
            pc = snes.getKSP().getPC()
            if pc.getType() in (PETSc.PC.Type.LU, PETSc.PC.Type.CHOLESKY):
                pc.reset()  # after a failure of MUMPS PETSc would leave out all that follow
            if self.ts.getTimeStep() > (1.0 - 1e-9) * self._dt:
                raise self._given_up(f"a step of {self._dt:.3g} fails, and PETSc's options repeat "
                                     "it without making it smaller")
            self._decay = self.form.spurious_root(self._tried, self._step.increment)
            self._guess, self._guarded = None, False
        start = self.state.extrapolated(dt)[0] if self._guess is None else self._guess
        self.grid.from_local(start, u)
        self._starting = True
        self._tolerances.begin(snes, self._perturbation)

    def _post_step(self, ts):
        dt = ts.getTime() - self._time
        if dt <= 0.0:  # TS gave up, and says why in its reason
            return
        state, local, step = self.state, self.grid.to_local(ts.getSolution()), self.time_step(dt)
        step.dt = dt  # as TS counts it, which differs by rounding
        if self._decay:  # the equations themselves come next, from this solution
            self._repeat(ts, dt, local)
            return
        excess = self.form.spurious_root(local, step.increment)
        if excess:
            self._avoid_spurious_root(ts, dt, local, excess)
            return
        stress = self.form.stress(local, step.increment)
        if not self.steady:
            departure = step.departure(local, stress, self.parameters.step_min_deviation)
            smaller = self.controller.smaller(dt, departure.error)
            if smaller is not None:
                self._failure = (f"the last step, of {dt:.3g}, departs {departure.error:.3g} from "
                                 "the extrapolation", "a larger @step_error")
                self._repeat(ts, smaller)
                return
        end = step.end(local, stress, None if self.steady else departure.pace)
        if not self.steady:
            self._check_mesh(end)
            self._perturbation = departure.perturbation
        creep = np.abs(stress - state.stress).max(initial=0.0) / (2.0 * self.form.material.G * dt)
        self._creep = self.comm.allreduce(creep, MPI.MAX)
        self.state, self._failure = end, None
        self._guess, self._guarded = None, False
        self._committed = local, (local - state.local) / dt, step.increment
        self._courant_number = step.courant_number
        self._time, self._dt, self._last, self._attempts = ts.getTime(), None, dt, 0
        target = self.controller.land(self.state.time)
        if target is not None:
            self.state.time = target
        if not self.steady:
            ts.setTimeStep(self.controller.next(self.state.time, dt, departure.to_come))
            fast = self._fast(end)
            self.at_rest, self._moving = self._moving and not fast, fast
            if self.at_rest:
                self.controller.targets.clear()
            if self.controller.finished:
                ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_USER)
        self.observer(self, target is not None or self.at_rest, self._report(dt))

    def _avoid_spurious_root(self, ts, dt, local, excess):
        """Repeat a step that converged to mu = mu_s, where F = 0 although g differs from g_loc.

        With F + eps g, eps = mu_loc(I) - mu_s, this root is absent, and g decreases until mu
        exceeds mu_loc(I). From there Newton's method reaches mu_loc(I) when eps returns to zero.
        A step that converges to mu = mu_s all the same is repeated smaller.
        """
        if not self._guarded:
            self._repeat(ts, dt, local, excess)
            return
        self._failure = ("Newton's method converges to mu = mu_s, which is no solution of (2.5)",
                         "a smaller @step_max")
        self._repeat(ts, LEAST_SHARE * dt)

    def _repeat(self, ts, dt, guess=None, decay=0.0):
        """Repeat the step with a size, from a guess (n_local,) or the extrapolation for None."""
        self.rejected += 1
        self._guess, self._decay, self._guarded = guess, decay, guess is not None
        if self.steady:  # TSPSEUDO cannot roll back, and may have taken the step for its last
            self.grid.from_local(self.state.local, ts.getSolution())
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_ITERATING)
            self._time = ts.getTime()
        else:
            ts.rollBack()
        ts.setTimeStep(dt)

    @property
    def _rest_speed(self):
        return getattr(self.parameters, "rest_speed", 0.0)

    def _fast(self, state):
        """Return whether a state is faster than ``rest_speed``; False if this is 0. Collective."""
        if not self._rest_speed:
            return False
        speed = velocity(self.form, state.local, state.x)[:, self.grid.nodes.owned]
        return self.comm.allreduce(np.abs(speed).max(initial=0.0), MPI.MAX) > self._rest_speed

    def _check_mesh(self, state):
        """Refuse a state whose mesh is turned inside out, or leaves its domain. Collective."""
        nodes, owned = self.grid.nodes, self.grid.nodes.owned
        elements = self.grid.element_nodes[:, self.grid.elements.owned]
        turned = least_determinant(state.x[:, elements])
        found = None
        if not (turned > 0.0).all():
            middle = state.x[:, elements[NODES // 2]]
            found = "an element is turned inside out", middle[:, np.argmin(turned)].tolist()
        out = self.case.nodes_outside(state.time, state.x[:, owned], nodes.i[owned], nodes.j[owned])
        if out is not None and found is None and out[0].any():
            found = out[1], state.x[:, owned][:, np.argmax(out[0])].tolist()
        found = [answer for answer in self.comm.allgather(found) if answer]
        if found:
            what, at = found[0]
            raise SolutionError(
                f"the mesh cannot go on at {self.case.label(state.time)}: {what} at x = "
                f"({at[0]:.4g}, {at[1]:.4g}) d. What may help: an earlier end, or a smaller "
                "@step_max or @step_error")

    def _report(self, dt):
        """The columns of the history for the step that was just accepted."""
        snes, (local, rate, increment) = self.ts.getSNES(), self._committed
        I = self.form.inertial_number(local, increment)
        forces = self.form.forces(local, rate, increment)
        report = {
            "time": self.state.time,
            "step_size": dt,
            "courant_number": self._courant_number,
            "newton_iterations": snes.getIterationNumber(),
            "linear_iterations": snes.getLinearSolveIterations(),
            "inertial_number_min": self.comm.allreduce(I.min(), MPI.MIN),
            "inertial_number_max": self.comm.allreduce(I.max(), MPI.MAX),
            **self.case.observe(AcceptedStep(self.form, self.state.time, local, forces, increment.x))}
        if self.balance:
            self.balance.add(dt, *diagnostics.power(
                self.form, local, forces, increment))
            report.update(self.balance.report(*diagnostics.stored_energy(
                self.form, local, self.state.stress,
                Geometry(self.state.x[:, self.grid.element_nodes]))))
        return report

    # What observers ask for

    def cost(self):
        """Return the steps and iterations so far, those of repeated steps included."""
        ts = self.ts
        return {"steps": ts.getStepNumber(), **{
            name: int(self._behind.get(name, 0)) + count for name, count in (
                ("steps_repeated", self.rejected + ts.getStepRejections()),
                ("newton_iterations", ts.getSNESIterations()),
                ("linear_iterations", ts.getKSPIterations()))}}

    def values(self, repeat=True):
        """Return the numbers of a checkpoint: what a `Driver` needs as ``behind``. Collective.

        If the last attempt of the next step failed, they contain the size of the next attempt and
        the reason, unless ``repeat`` is False. A restart then makes the same attempt. Without them
        it begins with the step that is wanted, as it must after an error.
        """
        found = {**self.cost(), **self.balance.values(), **self.state.values(self.grid),
                 "ts_time": self._time, "wanted": self.controller.wanted or self._first_step,
                 "perturbation": self._perturbation, "at_rest": int(self.at_rest)}
        if repeat and self._failure is not None:
            found["repeat"] = self.ts.getTimeStep()
            found["failure"], found["cure"] = self._failure
            found["decay"] = self._decay if self._guess is None else 0.0
        return found

    def fields(self):
        """Return the nodal fields of the last state, {name: (..., n_nodes)}, for `Writer.snapshot`.

        Complete at owned nodes.
        """
        local, _, increment = self._committed
        form, x = self.form, self.state.x
        speed, fields = velocity(form, local, x), diagnostics.nodal_fields(
            form, local, increment)
        deviator = np.array([form.grid.at_nodes(part) for part in self.state.stress])
        pressure = np.multiply.outer([1.0, 1.0, 0.0], fields["pressure"])
        return {"coordinates": x, "velocity": speed, **fields, "deviator": deviator,
                "stress_tensor": deviator - pressure, **diagnostics.nodal_strains(form, speed, x)}
