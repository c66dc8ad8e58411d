"""Step sizes of the step controller, without a flow."""

import numpy as np
import pytest

from pgran.solve.controller import StepController


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
