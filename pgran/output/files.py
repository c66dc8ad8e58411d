"""Files that are written whole or not at all, by rank 0, with errors that all ranks share.

A file is never changed in place. A draft of its next version is written under a private name,
flushed to the disk, and renamed. Whoever reads the file, and whatever kills the run, finds the last
whole version. Only rank 0 touches the disk: it receives the blocks of the other ranks one after the
other. A full disk, a quota or a folder that disappears therefore strikes one rank in Python, which
tells the others, and none of them is left waiting in a collective write of HDF5.
"""

import errno
import fcntl
import io
import os
import shutil
import socket
import sys
from pathlib import Path

import h5py
import numpy as np

from ..options import PREFIX, ParameterError

#: The folder that is made where it is missing, like those below it.
RESULTS = "results"
#: Errors of flock on file systems without locks, such as Lustre mounted without ``-o flock``.
NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}
#: Largest message with field values between ranks, bytes.
PIECE = 1 << 23
#: Bytes that HDF5 may need for its own structures in one update of a file.
STRUCTURES = 1 << 20


class Disk:
    """What rank 0 does with the files that one option names.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    name, value : str
        The option and what it was given, for messages.
    prefix : str
        What the option's name begins with.
    """

    def __init__(self, comm, name, value, prefix=PREFIX):
        self.comm, self._option = comm, (name, value, prefix)

    def do(self, action):
        """Do ``action()`` on rank 0; every rank gets its answer, or its `ParameterError`."""
        answer = error = None
        if self.comm.rank == 0:
            try:
                answer = action()
            except (OSError, RuntimeError, KeyError, ValueError) as problem:  # h5py raises any
                error = told(problem)
        return self.agree(answer, error)

    def agree(self, answer, error):
        """Return the ``answer`` of rank 0 on all ranks, or raise its ``error``, a text."""
        answer, error = self.comm.bcast((answer, error))
        if error:
            name, value, prefix = self._option
            raise ParameterError(name, value, error, prefix)
        return answer


def together(comm, action):
    """Do ``action()`` on every rank, and return its answer. Collective.

    If it raises a `ParameterError` on some rank, all ranks raise the first one.
    """
    answer = error = None
    try:
        answer = action()
    except ParameterError as problem:
        error = problem.name, problem.value, problem.reason, problem.prefix
    for found in comm.allgather(error):
        if found:
            raise ParameterError(*found)
    return answer


def told(problem):
    """Return what an error of the system or of HDF5 says, in one line."""
    text = getattr(problem, "reason", None) or getattr(problem, "strerror", None) or str(problem)
    return (text.splitlines() or [type(problem).__name__])[0]


class Lock:
    """The right to write a file, held by one run at a time. It ends with the process.

    On a file system without locks nothing is held, and a warning on standard error says so.

    Raises
    ------
    OSError
        If another run holds it.
    """

    def __init__(self, path):
        self.path = Path(path).with_name(f".{Path(path).name}.lock")
        while True:
            self._file = open(self.path, "a+")  # held as long as the run
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as problem:
                if problem.errno in NO_LOCKS:
                    print(f"pgran: warning: {path}: the file system has no locks "
                          f"({problem.strerror}); nothing prevents another run from writing this "
                          "file at the same time", file=sys.stderr, flush=True)
                    break
                if not isinstance(problem, BlockingIOError):
                    self._file.close()
                    raise
                self._file.seek(0)
                holder = self._file.read().strip() or "unknown"
                self._file.close()
                raise OSError(f"another run writes it ({holder})") from None
            try:  # whoever held it before may have removed the file in between
                if os.path.samestat(os.fstat(self._file.fileno()), os.stat(self.path)):
                    break
            except FileNotFoundError:
                pass
            self._file.close()
        self._file.truncate(0)
        self._file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        self._file.flush()

    def release(self):
        """Give the right back."""
        if not self._file.closed:
            self.path.unlink(missing_ok=True)
            self._file.close()


def this_process():
    """Return a text that identifies this process: its machine, its number and when it began.

    It is empty where the system has no /proc.
    """
    return _process("self") and f"{_machine()} {os.getpid()} {_process('self')}"


def is_running(identity):
    """Return whether the process with the text of `this_process` still runs on this machine.

    None where that is not known: the process belongs to another machine or container.
    """
    machine, _, rest = identity.partition(" ")
    number, _, began = rest.partition(" ")
    if not began or machine != _machine():
        return None
    return _process(number) == began


def _machine():
    """Identify this boot of this machine, and its numbering of processes; empty without /proc."""
    try:
        return (Path("/proc/sys/kernel/random/boot_id").read_text().strip()
                + f"/{os.stat('/proc/self/ns/pid').st_ino}")
    except OSError:
        return ""


def _process(number):
    """Return when a process began, in ticks of the machine's clock; empty if it has ended."""
    try:
        fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]


class Draft:
    """The next version of an HDF5 file, under a private name until it is whole.

    Parameters
    ----------
    path : Path
        The file.
    room : int
        Bytes that will be added. They are reserved first, so that a full disk or a quota is met
        here, and not inside HDF5.
    source : Path, optional
        The version to start from; an empty file unless given.
    unfinished : Path, optional
        The private name; that of `private` unless given.

    Attributes
    ----------
    file : h5py.File
        The draft.
    """

    def __init__(self, path, room, source=None, unfinished=None):
        self.path, self._private = Path(path), unfinished or private(path)
        try:
            if source:
                shutil.copyfile(source, self._private)
            else:
                self._private.write_bytes(_empty())
            with open(self._private, "r+b") as file:
                os.posix_fallocate(file.fileno(), 0,
                                   os.fstat(file.fileno()).st_size + room + STRUCTURES)
            self.file = h5py.File(self._private, "r+", locking=False)  # the name is private
        except BaseException:
            self._remove()
            raise

    def __enter__(self):
        return self

    def __exit__(self, kind, problem, trace):
        """Drop the draft after an error; otherwise it stays open."""
        if kind:
            self.drop()

    def publish(self, flush):
        """Close the draft and put it in the place of the file.

        ``flush`` says whether to wait until the disk has it, so that it also outlives the machine.
        """
        try:
            self.file.close()
            if flush:
                with open(self._private, "rb") as file:
                    os.fsync(file.fileno())
            self._private.replace(self.path)
            if flush:
                folder = os.open(self.path.parent, os.O_RDONLY)
                os.fsync(folder)
                os.close(folder)
        except BaseException:
            self._remove()
            raise

    def drop(self):
        """Forget the draft; the file stays as it is."""
        try:
            self.file.close()
        finally:
            self._remove()

    def _remove(self):
        try:
            self._private.unlink(missing_ok=True)
        except OSError:  # the folder may be gone or read-only
            pass


def private(path):
    """Return the name under which the next version of a file is written."""
    return Path(path).with_name(f".{Path(path).name}.part")


def make_parents(path):
    """Make the missing folders of a file if they are `RESULTS` or lie below it; return them.

    Raises
    ------
    OSError
        If another folder is missing: the path may be mistyped.
    """
    missing = [folder for folder in Path(path).parents if not folder.exists()]
    if any(RESULTS not in folder.parts for folder in missing):
        raise OSError(f"there is no folder {Path(path).parent}; only {RESULTS} and the folders "
                      "below it are made")
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    return missing


def write_text(path, text):
    """Write a text file, whole or not at all."""
    private(path).write_text(text)
    private(path).replace(path)


def _empty():
    """An HDF5 file without content, bytes."""
    image = io.BytesIO()
    with h5py.File(image, "w"):
        pass
    return image.getvalue()


def write_blocks(comm, file, data):
    """Write the blocks of all ranks into datasets of an open file. Collective.

    Ranks send buffers of at most `PIECE` bytes, so that rank 0 needs memory for one of them only.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    file : h5py.Group or None
        Where rank 0 writes; None on the other ranks, and on rank 0 after an error.
    data : iterable of (str, tuple of slice, ndarray)
        Name of a dataset of real numbers, this rank's block of its first two axes, and the values
        of the block. All ranks give the same names and components in the same order.

    Returns
    -------
    str or None
        On rank 0, what went wrong. The blocks of the other ranks were received all the same.
    """
    problem = None
    for name, block, values in data:
        ends, components = np.array([[part.start, part.stop] for part in block]), values.shape[2:]
        if comm.rank:
            comm.Send(ends, 0)
            for rows, columns in pieces(ends, components):
                comm.Send(np.ascontiguousarray(
                    values[rows.start - ends[0, 0]:rows.stop - ends[0, 0],
                           columns.start - ends[1, 0]:columns.stop - ends[1, 0]], float), 0)
            continue
        for source in range(comm.size):
            if source:
                comm.Recv(ends, source)
            parts = pieces(ends, components) if source else [block]
            for part in parts:
                if source:
                    values = np.empty((*(axis.stop - axis.start for axis in part), *components))
                    comm.Recv(values, source)
                if file is None or problem:
                    continue
                try:
                    file[name][part] = values
                except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
                    problem = told(error)
    return problem


def pieces(ends, components=()):
    """Yield the blocks (slice, slice) of at most `PIECE` bytes that make up a larger block.

    ``ends`` (2, 2) are the first and last indices of the larger block along each axis, and
    ``components`` is the shape of the real values at a point. A point with more is one piece.
    """
    (j0, j1), (i0, i1) = ends.tolist()
    points = max(1, PIECE // (8 * int(np.prod(components, dtype=int))))
    wide = min(points, max(i1 - i0, 1))
    high = points // wide
    for j in range(j0, j1, high):
        for i in range(i0, i1, wide):
            yield slice(j, min(j + high, j1)), slice(i, min(i + wide, i1))


def blocks_of(lattice, fields):
    """Yield (name, block, values) of nodal ``fields``, {name: (..., n_local)}, on a lattice.

    The blocks lie in arrays (nj, ni, ...).
    """
    block = (slice(lattice.j0, lattice.j1), slice(lattice.i0, lattice.i1))
    shape = lattice.j1 - lattice.j0, lattice.i1 - lattice.i0
    for name, values in fields.items():
        parts = values.shape[:-1]
        yield name, block, np.moveaxis(
            values[..., lattice.owned].reshape(parts + shape), (-2, -1), (0, 1)).copy()


def local_part(data, i, j):
    """Return the values (..., n) of a dataset (nj, ni, ...) at global indices ``i``, ``j`` (n,).

    The indices fill a rectangle, ``i`` fastest. Where the grid is periodic they may lie beyond its
    ends.
    """
    nj, ni = data.shape[:2]
    rows, columns = (np.arange(index.min(), index.max() + 1) % n for index, n in ((j, nj), (i, ni)))
    slab = tuple(slice(index.min(), index.max() + 1) for index in (rows, columns))
    values = data[slab][np.ix_(rows - rows.min(), columns - columns.min())]
    return np.moveaxis(values, (0, 1), (-2, -1)).reshape(data.shape[2:] + (-1,))
