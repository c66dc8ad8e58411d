"""Standard output and error that do not end a command when they cannot be written."""

import os
import sys


class _Stream:
    """A standard stream that discards further output after an error.

    ``failed`` says whether output was lost for another reason than a closed pipe.
    """

    def __init__(self, stream):
        self._stream, self.failed = stream, False

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text):
        return self._try(self._stream.write, text)

    def flush(self):
        self._try(self._stream.flush)

    def _try(self, action, *arguments):
        try:
            return action(*arguments)
        except OSError as error:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)
            if not isinstance(error, BrokenPipeError):
                self.failed = True
                print(f"pgran: warning: standard output cannot be written ({error.strerror}); "
                      "further output is discarded", file=sys.stderr, flush=True)


def guard_streams():
    """Keep standard streams usable after errors, and open the standard files if closed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:  # closed: no file of the run may get this number
            os.open(os.devnull, os.O_RDWR)
        stream = getattr(sys, name)
        if number and not isinstance(stream, _Stream):
            setattr(sys, name, _Stream(stream or open(number, "w", closefd=False)))
