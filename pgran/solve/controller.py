"""Step sizes from error estimates, without PETSc and without a flow."""

import math

#: A step is repeated if its error exceeds the limit by this factor.
TOLERATED = 2.0
#: Smallest ratio of the size of a repeated step to its previous size.
LEAST_SHARE = 0.3
#: Ratio of the next step to the step that would just meet the limit.
SAFETY = 0.9
#: Relative difference below which two times are equal.
SAME = 1e-12


class StepController:
    """Chooses step sizes so that errors stay near a limit and targets are met exactly.

    Parameters
    ----------
    limit : float
        Desired error estimate, which is proportional to the square of the step size.
    largest, growth : float
        Largest step, 1/gdot0, and largest ratio of successive steps.
    unresolved : float
        Step size, 1/gdot0, below which the error does not reduce a step.
    targets : sequence of float
        Times to reach exactly, in increasing order; the last one ends the run.
    """

    def __init__(self, limit, largest, growth, unresolved, targets):
        self.limit, self.largest, self.growth = limit, largest, growth
        self.unresolved, self.targets = unresolved, list(targets)
        #: The desired step before it is reduced to reach a target.
        self.wanted = None
        self._reduced = None  # the step that was reduced to reach a target

    @property
    def finished(self):
        """Whether the last target was reached."""
        return not self.targets

    def start(self, time, wanted):
        """Return the first step, if possible ``wanted``, and skip the targets up to ``time``."""
        while self.targets and self._reached(time):
            self.targets.pop(0)
        self.wanted = min(wanted, self.largest)
        return self._aim(time)

    def smaller(self, dt, error):
        """Return the size with which a step is repeated, or None if the step is acceptable."""
        if error <= TOLERATED * self.limit or dt <= 2.0 * self.unresolved:
            return None
        return max(LEAST_SHARE, math.sqrt(self.limit / error)) * dt

    def land(self, time):
        """Remove the target that an accepted step has reached; return it or None."""
        return self.targets.pop(0) if self.targets and self._reached(time) else None

    def _reached(self, time):
        return time >= self.targets[0] * (1.0 - SAME)

    def next(self, time, dt, error):
        """Return the size of the step that follows an accepted step of size ``dt``."""
        wanted = dt * min(self.growth, SAFETY * math.sqrt(self.limit / max(error, 1e-300)))
        wanted = max(wanted, min(self.unresolved, dt * self.growth))
        if self._reduced is not None and dt >= self._reduced * (1.0 - 1e-9):  # it did not fail
            wanted = max(wanted, self.wanted)
        self.wanted = min(wanted, self.largest)
        return self._aim(time)

    def _aim(self, time):
        """Return the desired step, or one that reaches the next target in one or two steps."""
        if not self.targets:
            return self.wanted
        left = self.targets[0] - time
        dt = left if self.wanted >= left * (1.0 - 1e-9) else min(self.wanted, 0.5 * left)
        self._reduced = dt if dt < self.wanted else None
        return dt
