"""Signals that ask a run to stop; the standard library only, so that they are noted at once."""

import signal

#: Batch systems send them before they kill.
SIGNALS = signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2


class Signals:
    """Notes the signals that ask a run to stop. Calling it gives the name of one, or None."""

    def __init__(self):
        self._name = None
        for number in SIGNALS:
            signal.signal(number, self._note)

    def _note(self, number, frame):
        self._name = signal.Signals(number).name

    def __call__(self):
        """Return the name of the signal that came, or None."""
        return self._name
