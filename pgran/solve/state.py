"""The state of a run, where it starts, and what one time step solves.

A step predicts the mesh at its end to third order (Adams-Bashforth), turns the last two stresses
with the material, and asks for the solution there with the stress rate of BDF2. After acceptance
the mesh moves by the trapezoidal rule, and the new stress is kept. Where the flow grows as
exp(r t), this rule adds (r dt)^3/12 in a step, and a prediction of second order would take
5/12 (r dt)^4, which is more from r dt = 1/5 on. On a fixed mesh the flow rotates and advects the
stress instead. In pseudo-time stress neither rotates nor moves, so that the steady state is that of
rigid-viscous flow.
"""

from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ..material.elasticity import rotate, stress_rate
from ..options import ParameterError
from ..output import checkpoint
from ..output.files import Disk
from ..output.reader import opened
from ..output.start import read_mode, read_snapshot
from ..space.advection import Advection
from ..space.element import DIM, SHAPE

#: Departure from the reference flow, over its size, from which on a perturbation is a band.
FORMED = 1.0
#: Changes of the perturbation below this share of what is resolved are those of rounding and of
#: what Newton's method leaves.
NOISE = 1e-3
#: Numbers of a checkpoint without which no run goes on.
NUMBERS = ("time", "period", "ts_time", "wanted", "steps", "history", "snapshots", "stored", "work",
           "dissipation")


class State:
    """The last accepted state of a rank: all that a step starts from.

    Attributes
    ----------
    time : float
        1/gdot0.
    x : ndarray, (2, n_nodes)
        Mesh, d.
    local : ndarray, (n_local,)
        Unknowns.
    stress : ndarray, (3, points, n)
        Deviator, stress.
    dt : float or None
        Size of the step that led here; None at the start.
    earlier : ndarray, (3, points, n), or None
        The stress that this step started from, rotated and advected with the material.
    rate : ndarray, (n_local,)
        Difference quotient of the unknowns over this step; zero at the start.
    bend : ndarray, (2, n_nodes), or None
        Second divided difference of the velocity over the last two steps; None before there were
        two.
    pace : float or None
        That of the `Departure` of this step; None at the start.
    """

    def __init__(self, time, x, local, stress, dt=None, earlier=None, rate=None, bend=None,
                 pace=None):
        self.time, self.x, self.local, self.stress = time, x, local, stress
        self.dt, self.earlier, self.bend, self.pace = dt, earlier, bend, pace
        self.rate = np.zeros_like(local) if rate is None else rate

    def extrapolated(self, dt):
        """Return the unknowns and the stress on the line through the last two states."""
        if self.dt is None:
            return self.local, self.stress
        return (self.local + dt * self.rate,
                self.stress + dt / self.dt * (self.stress - self.earlier))

    def mean_velocity(self, form, dt):
        """Return the velocity (2, n_nodes) expected in a step ``dt``, its mean, d gdot0.

        It is that of the parabola through the last three states.
        """
        found = velocity(form, self.local + 0.5 * dt * self.rate, self.x)
        return found if self.bend is None else found + dt * (dt / 3.0 + self.dt / 2.0) * self.bend

    def nodal(self, form):
        """Return velocity, pressure, perhaps fluidity, and deviator at nodes, {name: (..., n)}."""
        velocity, fluidity, pressure = form.grid.split(self.local)
        fields = {"velocity": velocity, "pressure": form.grid.corner_field(pressure),
                  "deviator": np.array([form.grid.at_nodes(part) for part in self.stress])}
        return fields if fluidity is None else {**fields, "fluidity": fluidity}

    # On any number of ranks

    def arrays(self, grid):
        """Return the arrays of a checkpoint, as `pgran.output.checkpoint.write` has them."""
        nodes, corners = {"coordinates": self.x}, {}
        for kind, local in (("", self.local), ("_rate", self.rate)):
            velocity, fluidity, corners[f"pressure{kind}"] = grid.split(local)
            nodes[f"velocity{kind}"] = velocity
            if fluidity is not None:
                nodes[f"fluidity{kind}"] = fluidity
        if self.bend is not None:
            nodes["velocity_bend"] = self.bend
        elements = {"stress": self.stress}
        if self.earlier is not None:
            elements["earlier_stress"] = self.earlier
        return {"nodes": nodes, "corners": corners, "elements": elements}

    def values(self, grid):
        """Return the numbers of a checkpoint. Collective."""
        return {"time": self.time, "dt": self.dt, "pace": self.pace,
                "period": grid.period(self.x)}

    @classmethod
    def of(cls, form, values, arrays):
        """Return the state that `values` and `arrays` describe, at the local points of a form."""
        grid, nodes, corners = form.grid, arrays["nodes"], arrays["corners"]
        x, lattice = _initial_mesh(form), grid.nodes
        if form.case.moving:
            x = nodes["coordinates"].copy()
            for index, n, period in zip((lattice.i, lattice.j), lattice.shape, values["period"]):
                x += np.outer(period, index // n)  # beyond the ends of a periodic grid
        local, rate = (grid.join(nodes[f"velocity{kind}"], nodes.get(f"fluidity{kind}"),
                                 corners[f"pressure{kind}"]) for kind in ("", "_rate"))
        stress, earlier = (
            None if part is None else np.ascontiguousarray(part)
            for part in (arrays["elements"]["stress"], arrays["elements"].get("earlier_stress")))
        dt, pace = (None if values.get(name) is None else float(values[name])
                    for name in ("dt", "pace"))
        return cls(float(values["time"]), x, local, stress, dt, earlier, rate,
                   nodes.get("velocity_bend"), pace)

    def past(self, dt, stresses):
        """Return f and S of `stress_rate` for a step ``dt``.

        ``stresses`` are those that `TimeStep.transport` returns.
        """
        stress, *earlier = stresses
        return stress_rate(dt, stress, self.dt, *earlier)


def _unknowns(form, fields, x):
    """Local unknowns (n_local,) of ``fields(points)``, that is velocity, fluidity and pressure."""
    grid = form.grid
    corners = x[:, grid.nodes.index(2 * grid.corners.i, 2 * grid.corners.j)]
    velocity, fluidity, _ = fields(x)
    return grid.join(velocity, fluidity, fields(corners)[2])


def _initial_mesh(form):
    return form.case.coordinates(form.grid.nodes.i, form.grid.nodes.j)


def rest(form):
    """Return the `State` at rest before loading: no stress deviator, and the model's fluidity."""
    case, x = form.case, _initial_mesh(form)

    def start(points):
        velocity, fluidity, pressure = case.start(points)
        share = case.material.model.start_fluidity
        return velocity, fluidity + share * case.reference(points)[1], pressure

    return State(0.0, x, _unknowns(form, start, x), form.no_stress())


def reference(form):
    """Return the `State` of the reference flow of the case, rigid-viscous. Collective."""
    return _rigid_viscous(form, _unknowns(form, form.case.reference, _initial_mesh(form)))


def _rigid_viscous(form, local):
    """The `State` of unknowns on the initial mesh, whose stress follows from them."""
    x = _initial_mesh(form)
    increment = form.increment(x, form.no_stress(), 0.0, 0.0)
    increment.prescribed = np.full(form.grid.n_local, np.nan)  # nothing is imposed on this flow
    return State(0.0, x, local, form.stress(local, increment))


def seeded(form):
    """Return the `State` of the flow that the mode of a seed is one of, plus the mode. Collective.

    That is the reference flow, or the snapshot that the mode was found about; its stress is kept.

    Raises
    ------
    ParameterError
        If the mode does not fit.
    """
    mode, base = read_mode(form.case.parameters, form)
    change = form.case.parameters.mode_amplitude * _joined(form, mode)
    if base:
        return State(0.0, _initial_mesh(form), _joined(form, base) + change,
                     _at_points(form, base["deviator"]))
    return _rigid_viscous(form, _unknowns(form, form.case.reference, _initial_mesh(form)) + change)


def _joined(form, fields):
    """Local unknowns (n_local,) of nodal fields {name: (..., n_nodes)} of a result."""
    grid = form.grid
    corners = grid.nodes.index(2 * grid.corners.i, 2 * grid.corners.j)
    return grid.join(fields["velocity"], fields.get("fluidity"), fields["pressure"][corners])


def _at_points(form, nodal):
    """The values (k, points, n) of nodal fields (k, n_nodes) at the Gauss points."""
    return SHAPE @ nodal[:, form.grid.element_nodes]


def steady_start(form):
    """Return the `State` from which steady flow is sought. Collective.

    It is that of the snapshot which a restart names, or the reference flow on the initial mesh.

    Raises
    ------
    ParameterError
        If the snapshot does not fit.
    """
    if not form.case.parameters.restart:
        # Stress that follows from a strain rate is out of balance: LI starts without.
        return reference(form) if form.grid.has_fluidity else rest(form)
    return snapshot_start(form)


def snapshot_start(form):
    """Return the `State` of the snapshot that a restart names. Collective.

    Raises
    ------
    ParameterError
        If the snapshot does not fit.
    """
    grid, parameters = form.grid, form.case.parameters
    if any(grid.periodic) and form.case.moving:
        raise ParameterError("restart", parameters.restart, f"not for @case {parameters.case}, "
                             "whose grid is periodic and moves")
    attributes, fields = read_snapshot(parameters, form)
    x = fields["coordinates"] if form.case.moving else _initial_mesh(form)
    return State(float(attributes["time"]), x, _joined(form, fields),
                 _at_points(form, fields["deviator"]))


def frozen(form, state):
    """Return the `Increment` in which a steady state stays as it is. Collective.

    The elastic element keeps the stress and bears what deforms within ``steady_time``, so that the
    stress of material at rest has its place, and what creeps counts.
    """
    return TimeStep(form, state, form.case.parameters.steady_time, still=True).increment


def checkpoint_start(form):
    """Return the `State` of the newest good checkpoint of the run that a restart names. Collective.

    Returns
    -------
    state : State
    values : dict
        The numbers of the checkpoint.
    damaged : list of str
        Newer checkpoints that could not be read.

    Raises
    ------
    ParameterError
        If there is none.
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
        if np.shape(values["period"]) != (DIM, DIM) or min(counts) < 0 or min(sizes) <= 0:
            raise ValueError("its numbers are those of no run")
        like = rest(form)
        like.earlier = like.stress if "dt" in values else None
        like.bend = like.x if "nodes/velocity_bend" in file else None
        return values, checkpoint.read_arrays(file, form.grid, like.arrays(form.grid))

    (values, arrays), _, damaged = checkpoint.newest(path, disk.do(run), accept, disk)
    return State.of(form, values, arrays), values, damaged


def velocity(form, local, x):
    """Return the velocity (2, n_nodes) of material at nodes ``x``, base flow included, d gdot0."""
    return form.grid.split(local)[0] + form.case.base_gradient @ x


class Departure(NamedTuple):
    """How far a solution departs from what was expected, and from the reference flow v0.

    Attributes
    ----------
    error : float
        From the extrapolation of the last two states: the larger of max|v - v*|/max|v - v0| and
        max|sigma' - sigma'*|/(mu_s P0), where v* and sigma'* are extrapolated.
    perturbation : float
        From the reference flow, over the size of the flow: max|v - v0|/max|v|.
    pace : float
        Largest change of v - v0 over the step, over its size dt; 0 where it is `NOISE`.
    exponent : float
        How much ln(pace) grows in a step of this size, by this step and the last one:
        ln(pace/pace') 2 dt/(dt + dt'). Zero where it falls, or before there were two steps. An
        imperfection has a response that stays as it is: this hides what grows from ``error``, but
        not from ``exponent``.
    """

    error: float
    perturbation: float
    pace: float
    exponent: float

    @property
    def to_come(self):
        """The departure that the next step would have at this size.

        exp(r t) departs from the line through its last two values by (r dt)^2 of itself.
        """
        return max(self.error, self.exponent**2) if self.perturbation < FORMED else self.error


class TimeStep:
    """One implicit time step from a state. Making it is collective.

    Parameters
    ----------
    form : pgran.space.weakform.WeakForm
    state : State
    dt : float
        Size of the step, 1/gdot0; 0 gives the rigid-viscous equations as they stand.
    still : bool
        Whether mesh, walls and stress stay as they are, as in pseudo-time.

    Attributes
    ----------
    increment : pgran.space.weakform.Increment
        What is fixed while the step is solved.
    courant_number : float
        Largest number of elements that material crosses in the step; 0 where the mesh moves with
        the material, or where everything stays.
    """

    def __init__(self, form, state, dt, still=False):
        self.form, self.state, self.dt, self.still = form, state, dt, still or dt == 0.0
        x, stress, end, factor = state.x, state.stress, state.time, 1.0
        self.courant_number = 0.0
        if not self.still:
            middle = state.mean_velocity(form, dt)
            if form.case.moving:
                x = state.x + dt * middle
            else:
                self._advection = Advection(form.grid, middle, x)
                self.courant_number = self._advection.courant_number(dt)
            self._angle = dt * form.spin(middle, 0.5 * (state.x + x))
            stresses = self.transport(state)
            self._earlier = stresses[0]
            factor, stress = state.past(dt, stresses)
            end = state.time + dt
        theta = factor * form.material.elastic_compliance(dt)
        self.increment = form.increment(x, stress, theta, end, rate_from=state.time)

    def transport(self, state):
        """Return the last one or two stress deviators of a state as this step transports them.

        Each is (3, points, n), the latest one first. They rotate with the material. On a fixed mesh
        they are advected too, after half of the rotation, which makes both together second order
        in time. Collective.
        """
        stresses = [state.stress] if state.dt is None else [state.stress, state.earlier]
        if self.form.case.moving:
            return [rotate(stress, self._angle) for stress in stresses]
        half = 0.5 * self._angle
        fields = np.concatenate([rotate(stress, half) for stress in stresses])
        fields = self._advection.advect(fields, self.dt)
        return [rotate(stress, half) for stress in np.split(fields, len(stresses))]

    def mesh_at_end(self, local):
        """Return the mesh (2, n_nodes) at the end of the step, by the trapezoidal rule."""
        if not self.form.case.moving:
            return self.state.x
        mean = 0.5 * (velocity(self.form, self.state.local, self.state.x)
                      + velocity(self.form, local, self.increment.x))
        return self.state.x + self.dt * mean

    def end(self, local, stress, pace=None):
        """Return the `State` at the end of the step, with its solution and new stress.

        ``pace`` is that of its `departure`.
        """
        state = self.state
        if self.still:
            return State(state.time, state.x, local, stress)
        rate, bend = (local - state.local) / self.dt, None
        if state.dt is not None:
            bend = self.form.grid.split(rate - state.rate)[0] / (self.dt + state.dt)
        return State(state.time + self.dt, self.mesh_at_end(local), local, stress, self.dt,
                     self._earlier, rate, bend, pace)

    def departure(self, local, stress, resolution):
        """Return the `Departure` of the solution. Collective.

        A growing perturbation v - v0 counts by its own size, once this exceeds ``resolution`` times
        max|v|.
        """
        form, owned, state = self.form, self.form.grid.nodes.owned, self.state
        x, comm = self.increment.x, form.grid.comm.tompi4py()
        expected, expected_stress = state.extrapolated(self.dt)
        now, then = (velocity(form, unknowns, x)[:, owned] for unknowns in (local, expected))
        apart, before = (
            form.grid.split(unknowns)[0][:, owned] - form.case.reference(points)[0][:, owned]
            for unknowns, points in ((local, x), (state.local, state.x)))
        off, size, change, apart, stress_off = (
            comm.allreduce(np.abs(part).max(initial=0.0), MPI.MAX) for part in
            (now - then, now, apart - before, apart, stress - expected_stress))
        scale, exponent = max(apart, resolution * size), 0.0
        pace = change / self.dt if change > NOISE * scale else 0.0
        if state.pace and pace > state.pace:
            exponent = np.log(pace / state.pace) * 2.0 * self.dt / (self.dt + state.dt)
        return Departure(max(off / scale, stress_off / form.material.yield_stress),
                         apart / size if size else 0.0, pace, exponent)
