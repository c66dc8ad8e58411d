"""Signals that stop a run. The module imports little, so that it notes them early."""

import signal
import threading
from contextlib import contextmanager

#: Batch systems send them before they end a job.
SIGNALS = signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2


@contextmanager
def preserved():
    """Restore the handlers of `SIGNALS` afterwards; yield whether this thread can set handlers."""
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield True
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


class Signals:
    """Handles `SIGNALS` and notes the last one."""

    def __init__(self):
        self._name = None
        for number in SIGNALS:
            signal.signal(number, self._note)

    def _note(self, number, frame):
        self._name = signal.Signals(number).name

    def __call__(self):
        """Return the name of the received signal, or None."""
        return self._name
