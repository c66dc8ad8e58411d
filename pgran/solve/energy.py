"""Energy balance of a run: work, dissipation and stored energy."""

from dataclasses import dataclass


@dataclass
class Balance:
    """Work and dissipation of a run, integrated over its steps by the trapezoidal rule.

    The exact solution satisfies work = dissipation + change of the stored energy.

    Parameters
    ----------
    stored : float
        Stored energy at the start, stress d^2 per unit depth.
    work, dissipation : float
        Values up to now, stress d^2 per unit depth.
    received, dissipated : float or None
        Powers at the end of the last step, stress d^2 gdot0. If they are None, the powers at the
        end of the next step hold for the entire step.
    """

    stored: float
    work: float = 0.0
    dissipation: float = 0.0
    received: float = None
    dissipated: float = None

    def add(self, dt, received, dissipated):
        """Add a step of size ``dt`` with the powers at its end."""
        before = (received, dissipated) if self.received is None else (
            self.received, self.dissipated)
        self.work += 0.5 * dt * (before[0] + received)
        self.dissipation += 0.5 * dt * (before[1] + dissipated)
        self.received, self.dissipated = received, dissipated

    def report(self, stored, volume):
        """Return the columns of the history, {name: float}, from stored energy and volume (d^2)."""
        change = stored - self.stored
        scale = max(abs(self.work), abs(self.dissipation), abs(change))
        missing = self.work - self.dissipation - change
        return {"work": self.work, "dissipation": self.dissipation, "stored_energy": change,
                "energy_error": missing / scale if scale else 0.0, "volume": volume}
