"""Energy balance of a run: work, dissipation and stored energy."""

from dataclasses import dataclass


@dataclass
class Balance:
    """Work and dissipation of a run, integrated over its steps by the trapezoidal rule.

    The exact solution satisfies work = dissipation + change of the stored energy. Energies are in
    stress d^2 per unit depth.
    """

    stored: float  #: at the start
    work: float = 0.0
    dissipation: float = 0.0
    #: Powers at the end of the last step; None if unknown, as at the start of a flow.
    received: float = None
    dissipated: float = None

    def add(self, dt, received, dissipated):
        """Add a step of size ``dt`` with the powers at its end."""
        if self.received is None:
            self.received, self.dissipated = received, dissipated
        self.work += 0.5 * dt * (self.received + received)
        self.dissipation += 0.5 * dt * (self.dissipated + dissipated)
        self.received, self.dissipated = received, dissipated

    def report(self, stored, volume):
        """Return the columns of the history, {name: float}, from stored energy and volume (d^2)."""
        change = stored - self.stored
        scale = max(abs(self.work), abs(self.dissipation), abs(change))
        missing = self.work - self.dissipation - change
        return {"work": self.work, "dissipation": self.dissipation, "stored_energy": change,
                "energy_error": missing / scale if scale else 0.0, "volume": volume}
