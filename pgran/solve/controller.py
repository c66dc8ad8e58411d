"""The size of the time steps: pure arithmetic, without PETSc and without a flow."""

import math

#: A step that departs this many times as far as the limit allows is repeated smaller.
TOLERATED = 2.0
#: A step that is repeated shrinks at most to this share of its size at a time.
LEAST_SHARE = 0.3
#: The next step aims at this share of the size that would just meet the limit.
SAFETY = 0.9
#: Times that differ by less than this share are the same.
SAME = 1e-12


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
        #: The step that is wanted, before it is cut to land on a target.
        self.wanted = None
        self._cut = None  # the step that was cut to land on a target

    @property
    def finished(self):
        """Whether the last target was reached."""
        return not self.targets

    def start(self, time, wanted):
        """Return the first step from ``time``, where ``wanted`` would be free to choose.

        Targets that lie behind are left out. A run that goes on passes the `wanted` of its
        checkpoint.
        """
        while self.targets and self._reached(time):
            self.targets.pop(0)
        self.wanted = min(wanted, self.largest)
        return self._aim(time)

    def smaller(self, dt, departure):
        """Return the size with which to repeat a step, or None if the step is acceptable."""
        if departure <= TOLERATED * self.limit or dt <= 2.0 * self.unresolved:
            return None
        return max(LEAST_SHARE, math.sqrt(self.limit / departure)) * dt

    def land(self, time):
        """Return the target that an accepted step has reached, or None; the target is then done."""
        return self.targets.pop(0) if self.targets and self._reached(time) else None

    def _reached(self, time):
        return time >= self.targets[0] * (1.0 - SAME)

    def next(self, time, dt, departure):
        """Return the size of the step that follows an accepted one of size ``dt``."""
        wanted = dt * min(self.growth, SAFETY * math.sqrt(self.limit / max(departure, 1e-300)))
        wanted = max(wanted, min(self.unresolved, dt * self.growth))
        if self._cut is not None and dt >= self._cut * (1.0 - 1e-9):  # and did not fail
            wanted = max(wanted, self.wanted)
        self.wanted = min(wanted, self.largest)
        return self._aim(time)

    def _aim(self, time):
        """Return the step that is wanted, or what lands on the next target without a sliver."""
        if not self.targets:
            return self.wanted
        left = self.targets[0] - time
        dt = left if self.wanted >= left * (1.0 - 1e-9) else min(self.wanted, 0.5 * left)
        self._cut = dt if dt < self.wanted else None
        return dt
