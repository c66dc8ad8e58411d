"""What the forces on a flow do, and where it goes: work, dissipation and stored energy."""


class Balance:
    """Work and dissipation of a run, by the trapezoidal rule over its steps.

    For the exact solution in time, work = dissipation + change of the stored energy. What is
    missing tells the error of the time steps and of Newton's method.

    Parameters
    ----------
    stored : float
        Energy that is stored at the start, stress d^2 per unit depth.
    work, dissipation : float
        What lies behind, stress d^2 per unit depth.
    received, dissipated : float or None
        Powers at the end of the last step, stress d^2 gdot0; None where they are not known, as at
        the start of a flow: those at the end of the first step then hold for all of it.
    """

    def __init__(self, stored, work=0.0, dissipation=0.0, received=None, dissipated=None):
        self.stored, self.work, self.dissipation = stored, work, dissipation
        self.received, self.dissipated = received, dissipated

    def add(self, dt, received, dissipated):
        """Add a step of size ``dt`` at whose end these powers hold."""
        before = (received, dissipated) if self.received is None else (
            self.received, self.dissipated)
        self.work += 0.5 * dt * (before[0] + received)
        self.dissipation += 0.5 * dt * (before[1] + dissipated)
        self.received, self.dissipated = received, dissipated

    def report(self, stored, volume):
        """Return the columns of the history, {name: float}.

        ``stored`` is the energy that is stored now, and ``volume`` that of the mesh, d^2.
        """
        change = stored - self.stored
        scale = max(abs(self.work), abs(self.dissipation), abs(change))
        missing = self.work - self.dissipation - change
        return {"work": self.work, "dissipation": self.dissipation, "stored_energy": change,
                "energy_error": missing / scale if scale else 0.0, "volume": volume}

    def values(self):
        """Return the numbers of a checkpoint: the arguments that make this balance again."""
        return {"stored": self.stored, "work": self.work, "dissipation": self.dissipation,
                "received": self.received, "dissipated": self.dissipated}
