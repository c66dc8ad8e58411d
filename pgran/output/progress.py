"""How long a run will still take; numpy only."""

import numpy as np

#: Steps grow as this power of how far the run is. Over the runs of figure 6, a slope and a chute
#: the estimate is then 0.6 to 1.95 of the truth, from the first tenth on.
GROWTH = 0.45
#: Before this share is done nothing is said of what is left.
EARLY = 0.04
#: What a Newton iteration costs in linear iterations: its residual, Jacobian and set-up.
NEWTON = 12.0


def left(done, spent):
    """Return what a run will still take, in the unit of ``spent``; None before it can be told.

    Steps get longer while a run goes on. So the pace of the last half of the steps, over the share
    from s0 to s, is taken to grow as s^q, q = `GROWTH`: with w spent on it the rest takes
    (s^(q - 1) - 1)/(1 - q) s/(s - s0) w. Where nothing has yielded yet in the first tenth of a
    run this is too short by up to five times.

    Parameters
    ----------
    done : sequence of float
        The share of the run that lay behind after each step, 0 to 1.
    spent : sequence of float
        What was spent until then, such as seconds.
    """
    if len(done) < 3:
        return None
    half = (len(done) - 1) // 2
    s, s0 = done[-1], done[half]
    if not s0 < s:
        return None
    steps = (min(s, 1.0)**(GROWTH - 1.0) - 1.0) / (1.0 - GROWTH) * s / (s - s0)
    return steps * (spent[-1] - spent[half])


def work(history):
    """Return the work (n,) until each step of a history {name: (n,)}, in linear iterations."""
    return np.cumsum(history["linear_iterations"] + NEWTON * history["newton_iterations"])


def words(seconds):
    """Return a duration in words."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    if seconds < 6000.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
