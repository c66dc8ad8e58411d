"""Accuracy of the mesh motion and step sizes for growing flows."""

from types import SimpleNamespace

import numpy as np
import pytest
from petsc4py import PETSc

from pgran.solve.controller import SAFETY, StepController
from pgran.solve.state import NOISE, ErrorEstimate, State, TimeStep

#: Rate of the flow v1 = GROWTH x1 of one node, and its v2 in the reference flow, where v1 = 0.
GROWTH, REFERENCE = 300.0, 1e7


def form_of_one_node(response=0.0):
    """Return a form of one node with a constant deviation ``response`` of v2."""
    def increment(x, *_, **__):
        return SimpleNamespace(x=x)

    grid = SimpleNamespace(comm=PETSc.COMM_SELF, nodes=SimpleNamespace(owned=np.array([0])),
                           n_local=2, split=lambda local: (local.reshape(2, 1), None, None),
                           gradient=lambda velocity, x: np.zeros((2, 2, 1, 1)))
    case = SimpleNamespace(moving=True, base_gradient=np.zeros((2, 2)),
                           reference=lambda x: (np.array([[0.0], [REFERENCE]]), None, None))
    material = SimpleNamespace(elastic_compliance=lambda dt: 1.0, yield_stress=1.0)
    return SimpleNamespace(grid=grid, case=case, material=material, increment=increment,
                           response=response)


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
    control = StepController(0.25, 1.0, 1.5, 1e-9, [1.0])
    wanted = control.next(0.0, dt, found[-1].next_error)
    assert wanted == pytest.approx(SAFETY * 0.5 / (found[-1].exponent / dt))


def test_growth_of_noise_or_of_a_band_does_not_limit_the_step():
    _, found = followed(2e-3, 8e-3, form_of_one_node(response=1e9 / NOISE))
    assert [estimate.exponent for estimate in found] == [0.0] * len(found)
    assert ErrorEstimate(0.1, 2.0, 1.0, 3.0).next_error == 0.1
