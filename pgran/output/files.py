"""Atomic writing of files by rank 0, with errors that all ranks raise.

A new version of a file is written under a private name, flushed to the disk and renamed, so that a
reader finds a complete version even if the run is killed. No rank hangs after an error of rank 0.
"""

import errno
import fcntl
import io
import os
import socket
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from ..options import PREFIX, ParameterError

#: This folder and the folders below it are created if they are missing.
RESULTS = "results"
#: Errors of flock on file systems without locks, such as Lustre mounted without ``-o flock``.
NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}
#: Errors of the system and of h5py when a file is read or written.
FILE_ERRORS = OSError, RuntimeError, KeyError, ValueError
#: Upper bound of what HDF5 adds to a file in one update besides the data, bytes.
OVERHEAD = 1 << 20


class Disk:
    """Operations of rank 0 on the file that is the ``value`` of the option ``name``."""

    def __init__(self, comm, name, value, prefix=PREFIX):
        self.comm, self._name, self._value, self._prefix = comm, name, value, prefix

    def do(self, action):
        """Return ``action()`` of rank 0 on all ranks, or raise its `ParameterError` on all."""
        result = error = None
        if self.comm.rank == 0:
            try:
                result = action()
            except FILE_ERRORS as problem:
                error = error_text(problem)
        return self.agree(result, error)

    def agree(self, result, error):
        """Return the ``result`` of rank 0 on all ranks, or raise its ``error``, a text."""
        result, error = self.comm.bcast((result, error))
        if error:
            raise ParameterError(self._name, self._value, error, self._prefix)
        return result


def collectively(comm, action):
    """Return ``action()`` of each rank; all ranks raise the first `ParameterError`. Collective."""
    result = error = None
    try:
        result = action()
    except ParameterError as problem:
        error = problem.name, problem.value, problem.reason, problem.prefix
    for found in comm.allgather(error):
        if found:
            raise ParameterError(*found)
    return result


def error_text(problem):
    """Return the message of an error in one line."""
    text = getattr(problem, "reason", None) or getattr(problem, "strerror", None) or str(problem)
    return (text.splitlines() or [type(problem).__name__])[0]


class Lock:
    """An exclusive lock on a result file, which ends with the process.

    Raises OSError if another run holds it. On a file system without locks it prints a warning.
    """

    def __init__(self, path):
        self.path = Path(path).with_name(f".{Path(path).name}.lock")
        while True:
            self._file = open(self.path, "a+")
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as problem:
                if problem.errno in NO_LOCKS:
                    print(f"pgran: warning: {path}: the file system has no locks "
                          f"({problem.strerror}); another run can write this file at the same "
                          "time", file=sys.stderr, flush=True)
                    break
                with self._file:
                    self._file.seek(0)
                    holder = self._file.read().strip() or "unknown"
                if not isinstance(problem, BlockingIOError):
                    raise
                raise OSError(f"another run writes it ({holder})") from None
            with suppress(FileNotFoundError):  # the previous holder may have removed the file
                if os.path.samestat(os.fstat(self._file.fileno()), os.stat(self.path)):
                    break
            self._file.close()
        self._file.truncate(0)
        self._file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        self._file.flush()

    def release(self):
        """Release the lock."""
        if not self._file.closed:
            self.path.unlink(missing_ok=True)
            self._file.close()


def process_identity(number=None):
    """Return the identity of a process (default: this one), empty if it ended or without /proc."""
    number = number or os.getpid()
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        namespace = os.stat("/proc/self/ns/pid").st_ino
        fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else f"{boot}/{namespace} {number} {fields[19]}"


def is_running(identity):
    """Return whether the process with this identity runs; None if it belongs to another machine."""
    machine, number = (*identity.split(), "", "")[:2]
    if not machine or machine != process_identity().partition(" ")[0]:
        return None
    return process_identity(number) == identity


class Draft:
    """The next version of an HDF5 file, open as ``file`` under a private name until it is complete.

    As a context manager it is removed after an error, and stays open otherwise. ``size`` bytes are
    reserved first, so that a full disk raises its error here and not inside HDF5.
    """

    def __init__(self, path, size, private_path=None):
        self.path, self._private = Path(path), private_path or private(path)
        empty = io.BytesIO()
        h5py.File(empty, "w").close()
        try:
            with open(self._private, "wb") as file:
                file.write(empty.getvalue())
                os.posix_fallocate(file.fileno(), 0, empty.getbuffer().nbytes + size + OVERHEAD)
            self.file = h5py.File(self._private, "r+", locking=False)
        except BaseException:
            self._remove()
            raise

    def __enter__(self):
        return self

    def __exit__(self, kind, problem, trace):
        if kind:
            self.drop()

    def publish(self, flush):
        """Close the draft and replace the file; ``flush`` waits until the data is on the disk."""
        with self:
            self.file.close()
            if flush:
                _sync(self._private)
            self._private.replace(self.path)
            if flush:
                _sync(self.path.parent)

    def drop(self):
        """Remove the draft; the file is unchanged."""
        try:
            self.file.close()
        finally:
            self._remove()

    def _remove(self):
        with suppress(OSError):  # the folder may be missing or read-only
            self._private.unlink()


def _sync(path):
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def private(path):
    """Return the name under which the next version of a file is written."""
    return Path(path).with_name(f".{Path(path).name}.part")


def make_parents(path):
    """Create and return the missing folders of a file, `RESULTS` and folders below it.

    Other missing folders raise OSError, because the path may be mistyped.
    """
    parent = Path(path).parent
    missing = [folder for folder in Path(path).parents if not folder.exists()]
    if any(RESULTS not in folder.parts for folder in missing):
        raise OSError(f"there is no folder {parent}; only {RESULTS} and the folders below it are "
                      "made")
    parent.mkdir(parents=True, exist_ok=True)
    return missing


def write_draft(disk, prepare, data, finish):
    """Write a file with the blocks of all ranks, see `write_blocks`. Collective.

    On rank 0 ``prepare()`` returns a `Draft` with empty datasets, and ``finish(draft)`` publishes
    it; its result is returned on all ranks. All ranks raise the `ParameterError` of rank 0.
    """
    draft = None

    def create():
        nonlocal draft
        draft = prepare()

    disk.do(create)
    error = write_blocks(disk.comm, draft and draft.file, data)
    if error:
        draft.drop()
    disk.agree(None, error)
    return disk.do(lambda: finish(draft))


def write_blocks(comm, file, data):
    """Write the blocks of all ranks into datasets of a ``file`` that is open on rank 0. Collective.

    ``data`` yields the same datasets on all ranks: the name, this rank's block of the first two
    axes (tuple of slice), and the values of the block. Rank 0 receives one block at a time, and all
    of them even after an error. Returns the error text on rank 0, or None.
    """
    error = None
    for name, block, values in data:
        if comm.rank:
            comm.send((block, values), 0)
            continue
        for source in range(comm.size):
            if source:
                block, values = comm.recv(source=source)
            try:
                if not error:
                    file[name][block] = values
            except (*FILE_ERRORS, TypeError) as problem:
                error = error_text(problem)
    return error


def blocks_of(lattice, fields, group=""):
    """Yield the data of `write_blocks` for ``fields``, {name: (..., n_local)}, on a lattice."""
    block = tuple(slice(*span) for span in lattice.ranges[::-1])
    shape = tuple(stop - start for start, stop in lattice.ranges[::-1])
    dim = len(block)
    for name, values in fields.items():
        yield f"{group}{name}", block, np.moveaxis(
            values[..., lattice.owned].reshape(values.shape[:-1] + shape),
            range(-dim, 0), range(dim))


def local_part(data, index):
    """Return the values (..., n) of a dataset (n_2, n_1, ...) at global indices (dim, n).

    The indices fill a box, the first one fastest. On a periodic grid they may exceed its ends.
    """
    dim = len(index)
    parts = [np.arange(along.min(), along.max() + 1) % n
             for along, n in zip(index[::-1], data.shape)]
    slab = tuple(slice(part.min(), part.max() + 1) for part in parts)
    values = data[slab][np.ix_(*(part - part.min() for part in parts))]
    return np.moveaxis(values, range(dim), range(-dim, 0)).reshape(data.shape[dim:] + (-1,))
