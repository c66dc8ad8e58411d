"""The size of the time steps: pure arithmetic, without PETSc and without a flow."""

import math

#: A step that departs this many times as far as the limit allows is repeated smaller.
TOLERATED = 2.0
#: A step that is repeated shrinks at most to this share of its size at a time.
LEAST_SHARE = 0.3
#: The next step aims at this share of the size that would just meet the limit.
SAFETY = 0.9


class StepController:
    """Chooses step sizes so that departures stay near a limit and targets are met exactly.

    The departure of a step from an extrapolation goes with the square of its size.

    Parameters
    ----------
    limit : float
        Departure that is aimed at.
    largest, growth : float
        Largest step, 1/gdot0, and largest ratio of successive steps.
    unresolved : float
        Step size, 1/gdot0, below which departures do not ask for smaller steps.
    targets : sequence of float
        Times to land on exactly, in increasing order; the last one ends the run.
    """

    def __init__(self, limit, largest, growth, unresolved, targets):
        self.limit, self.largest, self.growth = limit, largest, growth
        self.unresolved, self.targets = unresolved, list(targets)
        self._free = None  # the step that was wanted before it was cut to land on a target

    @property
    def finished(self):
        """Whether the last target was reached."""
        return not self.targets

    def start(self, time, wanted):
        """Return the first step from ``time``, where ``wanted`` would be free to choose."""
        return self._aim(time, wanted)

    def smaller(self, dt, departure):
        """Return the size with which to repeat a step, or None if the step is acceptable."""
        if departure <= TOLERATED * self.limit or dt <= 2.0 * self.unresolved:
            return None
        return max(LEAST_SHARE, math.sqrt(self.limit / departure)) * dt

    def land(self, time):
        """Return the target that an accepted step has reached, or None; the target is then done."""
        if self.targets and time >= self.targets[0] * (1.0 - 1e-12):
            return self.targets.pop(0)
        return None

    def next(self, time, dt, departure):
        """Return the size of the step that follows an accepted one of size ``dt``."""
        wanted = dt * min(self.growth, SAFETY * math.sqrt(self.limit / max(departure, 1e-300)))
        wanted = max(wanted, min(self.unresolved, dt * self.growth))
        if self._free is not None:
            wanted = max(wanted, self._free)
        return self._aim(time, min(wanted, self.largest))

    def _aim(self, time, wanted):
        """Return ``wanted``, or what lands on the next target without leaving a sliver."""
        left = self.targets[0] - time
        dt = left if wanted >= left * (1.0 - 1e-9) else min(wanted, 0.5 * left)
        self._free = wanted if dt < wanted else None
        return dt
