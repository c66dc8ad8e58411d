"""States of a run, initial states and the equations of one time step.

A step predicts the mesh at its end to third order (Adams-Bashforth), rotates the last two stresses
with the material, and solves for the unknowns at its end with the stress rate of BDF2. After
acceptance the mesh moves by the trapezoidal rule, and the new stress is stored. If the flow grows
as exp(r t), this rule adds an error of (r dt)^3/12 per step; a prediction of second order would
subtract 5/12 (r dt)^4, which is larger for r dt > 1/5. On a fixed mesh the flow rotates and
advects the stress instead. In pseudo-time it does neither.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ..material.elasticity import stress_rate
from ..options import ParameterError
from ..output import checkpoint
from ..output.files import Disk
from ..output.reader import opened
from ..output.start import read_mode, read_snapshot
from ..space.advection import Advection

#: Relative deviation from the reference flow above which a perturbation is a band.
FORMED = 1.0
#: Relative changes of the perturbation below this value are due to rounding and Newton's method.
NOISE = 1e-3
#: Numbers that a checkpoint must contain.
NUMBERS = ("time", "period", "ts_time", "wanted", "steps", "history", "snapshots", "stored", "work",
           "dissipation")


@dataclass
class State:
    """An accepted state on one rank, from which a step starts; the end of the previous step."""

    time: float  #: 1/gdot0
    x: np.ndarray  #: mesh (dim, n_nodes), d
    local: np.ndarray  #: unknowns (n_local,)
    stress: np.ndarray  #: deviator (m, points, n) in Mandel notation
    dt: float = None  #: size of the last step
    previous_stress: np.ndarray = None  #: at the start of that step, transported to its end
    rate: np.ndarray = None  #: difference quotient of the unknowns over that step, or zero
    velocity_curvature: np.ndarray = None  #: second divided difference (c, n_nodes)
    growth_signal: float = None  #: `ErrorEstimate.growth_signal` of that step

    def __post_init__(self):
        if self.rate is None:
            self.rate = np.zeros_like(self.local)

    def extrapolated(self, dt):
        """Return unknowns and stress after ``dt``, extrapolated from the last two states."""
        if self.dt is None:
            return self.local, self.stress
        return (self.local + dt * self.rate,
                self.stress + dt / self.dt * (self.stress - self.previous_stress))

    def mean_velocity(self, form, dt):
        """Return the mean (c, n_nodes) over ``dt`` of the parabola through the last velocities."""
        mean = velocity(form, self.local + 0.5 * dt * self.rate, self.x)
        if self.velocity_curvature is None:
            return mean
        return mean + dt * (dt / 3.0 + self.dt / 2.0) * self.velocity_curvature

    def past_stress(self, dt, stresses):
        """Return f and S of `stress_rate` for the result of `TimeStep.transport`."""
        stress, *previous = stresses
        return stress_rate(dt, stress, self.dt, *previous)

    def nodal(self, form):
        """Return velocity, pressure, perhaps fluidity, and deviator at nodes, {name: (..., n)}."""
        velocity, fluidity, pressure = form.grid.split(self.local)
        fields = {"velocity": velocity, "pressure": form.grid.corner_field(pressure),
                  "deviator": form.grid.at_nodes(form.kinematics.tensor(self.stress))}
        return fields if fluidity is None else {**fields, "fluidity": fluidity}

    # Checkpoints, for any number of ranks

    def arrays(self, grid):
        """Return the arrays of a checkpoint for `pgran.output.checkpoint.write`."""
        nodes, corners = {"coordinates": self.x}, {}
        for kind, local in (("", self.local), ("_rate", self.rate)):
            velocity, fluidity, corners[f"pressure{kind}"] = grid.split(local)
            nodes[f"velocity{kind}"] = velocity
            if fluidity is not None:
                nodes[f"fluidity{kind}"] = fluidity
        if self.velocity_curvature is not None:
            nodes["velocity_bend"] = self.velocity_curvature
        elements = {"stress": self.stress}
        if self.previous_stress is not None:
            elements["earlier_stress"] = self.previous_stress
        return {"nodes": nodes, "corners": corners, "elements": elements}

    def values(self, grid):
        """Return the numbers of a checkpoint. Collective."""
        return {"time": self.time, "dt": self.dt, "pace": self.growth_signal,
                "period": grid.period(self.x), "mandel": 1}

    @classmethod
    def of(cls, form, values, arrays):
        """Return the state from the `values` and `arrays` of a checkpoint on this rank."""
        grid, nodes, corners = form.grid, arrays["nodes"], arrays["corners"]
        x, lattice = _initial_mesh(form), grid.nodes
        if form.case.moving:
            x = nodes["coordinates"].copy()
            for index, n, period in zip(lattice.index, lattice.shape, values["period"]):
                x += np.outer(period, index // n)  # beyond the ends of a periodic grid
        local, rate = (grid.join(nodes[f"velocity{kind}"], nodes.get(f"fluidity{kind}"),
                                 corners[f"pressure{kind}"]) for kind in ("", "_rate"))
        stresses = {name: np.ascontiguousarray(part) for name, part in arrays["elements"].items()}
        if not values.get("mandel"):  # before release 0.4
            stresses = {name: form.kinematics.mandel(part) for name, part in stresses.items()}
        return cls(values["time"], x, local, stresses["stress"], values.get("dt"),
                   stresses.get("earlier_stress"), rate, nodes.get("velocity_bend"),
                   values.get("pace"))


def velocity(form, local, x):
    """Return the velocity (c, n_nodes) of the material with the base flow at ``x``, d gdot0."""
    return form.grid.split(local)[0] + form.case.base_gradient @ x


# Initial states

def _initial_mesh(form):
    return form.case.coordinates(*form.grid.nodes.index)


def _joined(grid, velocity, fluidity, pressure):
    """Return the unknowns of nodal fields (..., n_nodes)."""
    return grid.join(velocity, fluidity, pressure[grid.corner_nodes()])


def _stored(grid, fields):
    """Return the unknowns of the nodal fields of a file, {name: (..., n_nodes)}."""
    return _joined(grid, *map(fields.get, ("velocity", "fluidity", "pressure")))


def _deviator(form, nodal):
    """Return the deviator (m, points, n) of its tensor components (m, n_nodes) at nodes."""
    return form.kinematics.mandel(form.element.shape @ nodal[:, form.grid.element_nodes])


def rest(form):
    """Return the `State` at rest before loading: no stress deviator, and the model's fluidity."""
    case, x = form.case, _initial_mesh(form)
    velocity, fluidity, pressure = case.start(x)
    fluidity = fluidity + case.material.model.start_fluidity * case.reference(x)[1]
    return State(0.0, x, _joined(form.grid, velocity, fluidity, pressure), form.no_stress())


def reference(form, change=0.0):
    """Return the `State` of the rigid-viscous reference flow of the case. Collective.

    ``change`` is added to its unknowns.
    """
    x = _initial_mesh(form)
    local = _joined(form.grid, *form.case.reference(x)) + change
    increment = form.increment(x, form.no_stress(), 0.0, 0.0)
    increment.prescribed = np.full(form.grid.n_local, np.nan)  # no boundary values
    return State(0.0, x, local, form.stress(local, increment))


def seeded(form):
    """Return the `State` of the sum of a flow and the mode of ``-pgran_mode_file``. Collective.

    The flow is the reference flow, or the snapshot about which the mode was computed. Raises
    `pgran.options.ParameterError` if the mode does not fit.
    """
    mode, base = read_mode(form.case.parameters, form)
    change = form.case.parameters.mode_amplitude * _stored(form.grid, mode)
    if base:
        return State(0.0, _initial_mesh(form), _stored(form.grid, base) + change,
                     _deviator(form, base["deviator"]))
    return reference(form, change)


def steady_start(form):
    """Return the snapshot of ``-pgran_restart`` or else the reference flow. Collective."""
    if form.case.parameters.restart:
        return snapshot_start(form)
    # Stress that follows from a strain rate is not in equilibrium: LI starts without stress.
    return reference(form) if form.grid.has_fluidity else rest(form)


def snapshot_start(form):
    """Return the `State` of the snapshot of ``-pgran_restart``. Collective.

    Raises `pgran.options.ParameterError` if the snapshot does not fit.
    """
    parameters = form.case.parameters
    if any(form.grid.periodic) and form.case.moving:
        raise ParameterError("restart", parameters.restart, "not possible for @case "
                             f"{parameters.case}, whose periodic grid moves")
    attributes, fields = read_snapshot(parameters, form)
    x = fields["coordinates"] if form.case.moving else _initial_mesh(form)
    return State(float(attributes["time"]), x, _stored(form.grid, fields),
                 _deviator(form, fields["deviator"]))


def frozen(form, state):
    """Return the `Increment` of a steady state. Collective.

    Its elastic stress relaxes within ``steady_time``: material at rest can bear it, and creep
    contributes to the residual.
    """
    return TimeStep(form, state, form.case.parameters.steady_time, frozen=True).increment


def steady_residual(form, state):
    """Return the norm of the residual of a state without rates, stress d. Collective."""
    with np.errstate(invalid="ignore", divide="ignore"):
        rows = form.residual(state.local, np.zeros_like(state.local), frozen(form, state))
    return float(np.sqrt(form.grid.comm.tompi4py().allreduce(rows @ rows)))


def checkpoint_start(form):
    """Return the newest valid checkpoint of ``-pgran_restart``. Collective.

    Returns its `State`, its numbers {name: value}, and the newer checkpoints that could not be
    read, a list of str. Raises `pgran.options.ParameterError` if no checkpoint is valid.
    """
    path = form.case.parameters.restart
    disk = Disk(form.grid.comm.tompi4py(), "restart", path)

    def run():
        with opened(path) as file:
            return file.attrs.get("run", "")

    def accept(file):
        values = checkpoint.read_numbers(file, NUMBERS)
        counts, sizes = ([values.get(name, 1) for name in names] for names in (
            ("steps", "history", "snapshots"), ("wanted", "dt", "repeat")))
        if np.shape(values["period"]) != (form.grid.dim,) * 2 or min(counts) < 0 or min(sizes) <= 0:
            raise ValueError("it contains invalid numbers")
        like = rest(form)
        like.previous_stress = like.stress if "dt" in values else None
        like.velocity_curvature = like.x if "nodes/velocity_bend" in file else None
        return values, checkpoint.read_arrays(file, form.grid, like.arrays(form.grid))

    (values, arrays), _, damaged = checkpoint.newest(path, disk.do(run), accept, disk)
    return State.of(form, values, arrays), values, damaged


# One time step

class ErrorEstimate(NamedTuple):
    """Error estimate of a step and deviation of its solution from the reference flow v0.

    A constant response to an imperfection can hide a growing mode in ``error``, but not in
    ``exponent``.
    """

    #: Difference from the extrapolation (v*, sigma'*) of the last two states: the larger of
    #: max|v - v*|/max|v - v0| and max|sigma' - sigma'*|/(mu_s P0).
    error: float
    #: max|v - v0|/max|v|.
    deviation: float
    #: Largest change of v - v0 in the step, divided by dt; 0 if the change is `NOISE`.
    growth_signal: float
    #: Growth of ln(growth_signal) in a step of this size: ln(s/s') 2 dt/(dt + dt'), or 0.
    exponent: float

    @property
    def next_error(self):
        """Expected error of the next step if it has the same size."""
        # The line through the last two values of exp(r t) has a relative error of (r dt)^2.
        return max(self.error, self.exponent**2) if self.deviation < FORMED else self.error


class TimeStep:
    """The equations of one implicit time step from a state. Its methods are collective.

    Parameters
    ----------
    form : pgran.space.weakform.WeakForm
    state : State
    dt : float
        Size of the step, 1/gdot0; 0 gives the rigid-viscous equations.
    frozen : bool
        Whether mesh, walls and stress do not move, as in pseudo-time.

    Attributes
    ----------
    increment : pgran.space.weakform.Increment
    courant_number : float
        Largest number of elements of a fixed mesh that the material crosses in the step.
    """

    def __init__(self, form, state, dt, frozen=False):
        self.form, self.state, self.dt, self.frozen = form, state, dt, frozen or dt == 0.0
        x, stress, end, factor, self.courant_number = state.x, state.stress, state.time, 1.0, 0.0
        if not self.frozen:
            middle = state.mean_velocity(form, dt)
            if form.case.moving:
                x = state.x + dt * middle
            else:
                self._advection = Advection(form.grid, middle, x)
                self.courant_number = self._advection.rate * dt
            gradients = form.grid.gradient(middle, 0.5 * (state.x + x))
            self._angle = dt * form.kinematics.spin(*gradients)
            stresses = self.transport(state)
            self._previous_stress = stresses[0]
            factor, stress = state.past_stress(dt, stresses)
            end = state.time + dt
        theta = factor * form.material.elastic_compliance(dt)
        self.increment = form.increment(x, stress, theta, end, rate_from=state.time)

    def transport(self, state):
        """Return the last one or two deviators (m, points, n), transported to the step's end.

        They rotate with the material. On a fixed mesh they are also advected, between two halves of
        the rotation, which is second order in time.
        """
        stresses = [state.stress] if state.dt is None else [state.stress, state.previous_stress]
        rotate = self.form.kinematics.rotate
        if self.form.case.moving:
            return [rotate(stress, self._angle) for stress in stresses]
        half = 0.5 * self._angle
        fields = np.concatenate([rotate(stress, half) for stress in stresses])
        fields = self._advection.advect(fields, self.dt)
        return [rotate(stress, half) for stress in np.split(fields, len(stresses))]

    def mesh_at_end(self, local):
        """Return the mesh (dim, n_nodes) at the end of the step, by the trapezoidal rule."""
        if not self.form.case.moving:
            return self.state.x
        mean = 0.5 * (velocity(self.form, self.state.local, self.state.x)
                      + velocity(self.form, local, self.increment.x))
        return self.state.x + self.dt * mean

    def end(self, local, stress, growth_signal=None):
        """Return the `State` at the end of the step from its solution and its new stress."""
        state = self.state
        if self.frozen:
            return State(state.time, state.x, local, stress)
        rate, curvature = (local - state.local) / self.dt, None
        if state.dt is not None:
            curvature = self.form.grid.split(rate - state.rate)[0] / (self.dt + state.dt)
        return State(state.time + self.dt, self.mesh_at_end(local), local, stress, self.dt,
                     self._previous_stress, rate, curvature, growth_signal)

    def error_estimate(self, local, stress, min_deviation):
        """Return the `ErrorEstimate` of the solution, relative to at least ``min_deviation``."""
        form, owned, state = self.form, self.form.grid.nodes.owned, self.state
        x, comm = self.increment.x, form.grid.comm.tompi4py()
        expected, expected_stress = state.extrapolated(self.dt)
        now, predicted = (velocity(form, unknowns, x)[:, owned] for unknowns in (local, expected))
        perturbation, before = (
            form.grid.split(unknowns)[0][:, owned] - form.case.reference(points)[0][:, owned]
            for unknowns, points in ((local, x), (state.local, state.x)))
        error, size, change, perturbation, stress_error = (
            comm.allreduce(np.abs(part).max(initial=0.0), MPI.MAX) for part in
            (now - predicted, now, perturbation - before, perturbation, stress - expected_stress))
        scale, exponent = max(perturbation, min_deviation * size), 0.0
        signal = change / self.dt if change > NOISE * scale else 0.0
        if state.growth_signal and signal > state.growth_signal:
            exponent = np.log(signal / state.growth_signal) * 2.0 * self.dt / (self.dt + state.dt)
        return ErrorEstimate(max(error / scale, stress_error / form.material.yield_stress),
                             perturbation / size if size else 0.0, signal, exponent)
