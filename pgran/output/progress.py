"""Estimates of the remaining time of a run; numpy only."""

import numpy as np

#: Time steps grow as this power of the progress.
GROWTH = 0.45
#: No estimate is shown before this progress.
EARLY = 0.04
#: Cost of a Newton iteration (residual, Jacobian and set-up) in linear iterations.
NEWTON = 12.0


def left(done, spent):
    """Return the remaining cost of a run, in the unit of ``spent``, or None if it is unknown.

    ``done`` is the progress after each step, 0 to 1, and ``spent`` the cost until then. Steps grow,
    so the rate of progress is assumed to be proportional to s^q with q = `GROWTH`. If the last half
    of the steps, from s0 to s, has cost w, the rest costs (s^(q - 1) - 1)/(1 - q) s/(s - s0) w.
    """
    half = (len(done) - 1) // 2
    if len(done) < 3 or not done[half] < done[-1]:
        return None
    s, s0 = done[-1], done[half]
    ratio = (min(s, 1.0)**(GROWTH - 1.0) - 1.0) / (1.0 - GROWTH) * s / (s - s0)
    return ratio * (spent[-1] - spent[half])


def work(history):
    """Return the cost (n,) until each step of a history {name: (n,)}, in linear iterations."""
    return np.cumsum(history["linear_iterations"] + NEWTON * history["newton_iterations"])


def step_text(number, row):
    """Return a step with a row of the history as text."""
    return (f"step {number:4d}  dt {row['step_size']:.2e}  "
            f"Newton {row['newton_iterations']:2d}  linear {row['linear_iterations']:4d}  "
            f"I {row['inertial_number_min']:.2e} to {row['inertial_number_max']:.2e}")


def words(seconds):
    """Return a duration as text."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    if seconds < 6000.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
