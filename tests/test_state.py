"""Time steps: accuracy of the mesh motion, step sizes and tolerances."""

from types import SimpleNamespace

import numpy as np
import pytest
from petsc4py import PETSc

from pgran.kinematics import PLANE
from pgran.solve.controller import SAFETY, StepController
from pgran.solve.state import NOISE, ErrorEstimate, State, TimeStep
from pgran.solve.tolerances import SHARE, Tolerances

#: Rate of the flow v1 = GROWTH x1 of one node, and its v2 in the reference flow, where v1 = 0.
GROWTH, REFERENCE = 300.0, 1e7


def form_of_one_node(response=0.0):
    """Return a form of one node with a constant deviation ``response`` of v2."""
    def increment(x, *_, **__):
        return SimpleNamespace(x=x)

    grid = SimpleNamespace(comm=PETSc.COMM_SELF, nodes=SimpleNamespace(owned=np.array([0])),
                           n_local=2, split=lambda local: (local.reshape(2, 1), None, None),
                           gradient=lambda velocity, x: (np.zeros((2, 2, 1, 1)), None))
    case = SimpleNamespace(moving=True, base_gradient=np.zeros((2, 2)),
                           reference=lambda x: (np.array([[0.0], [REFERENCE]]), None, None))
    material = SimpleNamespace(elastic_compliance=lambda dt: 1.0, yield_stress=1.0)
    return SimpleNamespace(grid=grid, case=case, material=material, increment=increment,
                           response=response, kinematics=PLANE)


def followed(dt, end, form=None):
    """Move the node from x1 = 1 to the time ``end``; return x1 and all error estimates."""
    form, stress, found = form or form_of_one_node(), np.zeros((3, 1, 1)), []
    v2 = REFERENCE + form.response
    state = State(0.0, np.array([[1.0], [0.0]]), np.array([GROWTH, v2]), stress)
    while state.time < end * (1.0 - 1e-9):
        step = TimeStep(form, state, dt)
        local = np.array([GROWTH * step.increment.x[0, 0], v2])
        found.append(step.error_estimate(local, stress, 1e-3))
        state = step.end(local, stress, found[-1].growth_signal)
    return state.x[0, 0], found


def test_the_mesh_is_predicted_from_the_parabola_through_the_last_three_states():
    def speed(t):
        return np.array([1.0 + 2.0 * t - 5.0 * t**2, t**2])

    times, form = (0.0, 0.1, 0.4), form_of_one_node()
    first, last = ((speed(b) - speed(a)) / (b - a) for a, b in zip(times, times[1:]))
    state = State(times[2], np.zeros((2, 1)), speed(times[2]), None, times[2] - times[1],
                  rate=last,
                  velocity_curvature=((last - first) / (times[2] - times[0])).reshape(2, 1))
    dt, exact = 0.25, np.array([[1.0 * 0.25 + (0.65**2 - 0.4**2) - 5.0 / 3.0 * (0.65**3 - 0.4**3)],
                                [(0.65**3 - 0.4**3) / 3.0]])
    assert dt * state.mean_velocity(form, dt) == pytest.approx(exact)


def test_mesh_motion_in_a_growing_flow_has_the_error_of_the_trapezoidal_rule():
    end, errors = 0.04, []
    for dt in (1e-3, 5e-4, 2.5e-4):
        x, _ = followed(dt, end)
        errors.append(np.log(x) / (GROWTH * end) - 1.0)
    assert np.abs(errors[0]) < (GROWTH * 1e-3)**2 / 12.0
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.3)


def test_a_growing_mode_limits_the_step_although_a_constant_response_hides_it():
    dt, form = 2e-3, form_of_one_node(response=1e5)
    _, found = followed(dt, 8e-3, form)
    assert found[-1].error < 0.01  # which would allow a much larger step
    assert found[-1].exponent == pytest.approx(GROWTH * dt, rel=0.2)
    control = controller(limit=0.25, largest=1.0, unresolved=1e-9)
    wanted = control.next(0.0, dt, found[-1].next_error)
    assert wanted == pytest.approx(SAFETY * 0.5 / (found[-1].exponent / dt))


def test_growth_of_noise_or_of_a_band_does_not_limit_the_step():
    _, found = followed(2e-3, 8e-3, form_of_one_node(response=1e9 / NOISE))
    assert [estimate.exponent for estimate in found] == [0.0] * len(found)
    assert ErrorEstimate(0.1, 2.0, 1.0, 3.0).next_error == 0.1


def controller(targets=(1.0,), limit=0.1, largest=0.05, growth=1.5, unresolved=1e-4):
    return StepController(limit, largest, growth, unresolved, targets)


def steps(control, error, first=1e-3, maximum=10_000):
    """Return the times of the steps of a run with the error estimate ``error(time, dt)``."""
    time, dt, times = 0.0, control.start(0.0, first), [0.0]
    for _ in range(maximum):
        while (smaller := control.smaller(dt, error(time, dt))) is not None:
            assert smaller < dt
            dt = smaller
        time += dt
        target = control.land(time)
        time = time if target is None else target
        times.append(time)
        if control.finished:
            return np.array(times)
        dt = control.next(time, dt, error(times[-2], dt))
    raise AssertionError("the run does not end")


def test_every_target_is_reached_exactly_without_a_tiny_step():
    targets = (0.1, 0.1003, 0.5, 1.0)
    times = steps(controller(targets), lambda time, dt: 0.0)
    assert set(targets) <= set(times)
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    # A step is never followed by one that is much smaller because a target is near.
    assert (after > 0.3 * before)[(before < 1e-4) | (after > 3e-4)].all()


def test_steps_grow_to_the_largest_one_and_no_faster():
    sizes = np.diff(steps(controller(growth=1.2), lambda time, dt: 0.0))
    assert sizes.max() <= 0.05 * (1.0 + 1e-12)
    assert (sizes[1:] / sizes[:-1]).max() < 1.2 + 1e-9
    assert len(sizes) < 45


def test_errors_stay_within_twice_the_limit():
    """A growing mode: the error is proportional to dt^2."""
    def error(time, dt):
        return 40.0 * (1.0 + 5.0 * np.sin(20.0 * time)**2) * dt**2

    times = steps(controller(), error)
    found = [error(time, dt) for time, dt in zip(times, np.diff(times))]
    assert max(found) <= 0.2
    assert np.median(found) > 0.02  # and steps are not needlessly small


def test_errors_do_not_reduce_steps_below_the_resolved_size():
    control = controller(unresolved=0.01)
    assert control.smaller(0.015, 1e6) is None
    assert control.smaller(0.03, 1e6) == pytest.approx(0.3 * 0.03)
    assert control.next(0.0, 0.015, 1e6) == pytest.approx(0.01)


def test_a_step_reduced_for_a_target_is_followed_by_the_desired_step_unless_it_failed():
    control = controller(targets=(0.012, 1.0), largest=0.01)
    assert control.start(0.0, 0.01) == pytest.approx(0.006)  # half of what is left
    assert control.next(0.006, 0.006, 0.1) == pytest.approx(0.006)
    assert control.land(0.012) == 0.012
    assert control.next(0.012, 0.006, 0.1) == pytest.approx(0.01)
    control = controller(largest=1.0, unresolved=1e-9)
    assert control.start(0.0, 0.8) == pytest.approx(0.5)
    assert control.next(0.03125, 0.03125, 0.1) == pytest.approx(0.9 * 0.03125)


class Solver(PETSc.SNES):
    """A solver with tolerances and with a given norm of the residual."""

    norm = None

    def getFunctionNorm(self):
        return self.norm


@pytest.fixture
def solver():
    solver = Solver().create(PETSc.COMM_SELF)
    solver.setTolerances(atol=1e-4)
    solver.getKSP().setTolerances(rtol=3e-2)
    return solver


def linear(tolerances, solver, *norms):
    """Return the linear tolerances for these norms of the residual."""
    found = []
    for solver.norm in norms:
        tolerances.next(solver)
        found.append(solver.getKSP().getTolerances()[0])
    return found


def test_the_tolerance_is_proportional_to_the_growing_perturbation(solver):
    tolerances, found = Tolerances(solver, 1.0, 1e-3), []
    for perturbation in (0.0, 1e-6, 1e-2, 0.5, 1.0, 3.0):
        tolerances.begin(solver, perturbation)
        found.append(solver.getTolerances()[1])
    assert found == pytest.approx([1e-7, 1e-7, 1e-6, 5e-5, 1e-4, 1e-4])


def test_linear_tolerances_follow_the_convergence_of_newtons_method(solver):
    tolerances = Tolerances(solver, 1.0, 1e-3)
    tolerances.begin(solver, 1.0)
    first, slow, fast, last = linear(tolerances, solver, 10.0, 5.0, 5e-2, 5e-4)
    assert first == slow == last == 3e-2  # the value of the options is the upper bound
    assert fast == pytest.approx(1e-2**1.5)
    assert linear(tolerances, solver, 5e-5 * 1e3, 2e-3)[1] == pytest.approx(SHARE * 1e-4 / 2e-3)


def test_zero_keeps_the_tolerances_of_the_options(solver):
    tolerances = Tolerances(solver, 0.0, 1e-3)
    tolerances.begin(solver, 1e-6)
    assert linear(tolerances, solver, 1.0, 1e-3) == [3e-2, 3e-2]
    assert solver.getTolerances()[1] == 1e-4
