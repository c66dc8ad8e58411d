"""Reading of result files, h5py only; an invalid file is refused with the reason."""

import os
from contextlib import contextmanager

import h5py
import numpy as np

from .. import cases
from ..options import PREFIX, OptionError, ParameterError, plain, written
from .files import error_text
from .snapshots import linked, problem_of

#: Version of the layout of result files, and the oldest one that is read, of release 0.2.
FORMAT, OLDEST = 4, 3
#: Options of a result that are not used by a run that starts from it.
NOT_TAKEN = "restart", "restart_snapshot", "output", "progress"


class ResultError(ValueError):
    """A file is not a valid result; ``reason`` does not contain the name of the file."""

    def __init__(self, path, reason):
        super().__init__(f"{path}: {reason}")
        self.reason = reason


@contextmanager
def opened(path, snapshots=0, only=None):
    """Open a result file for reading, as a context. Not collective.

    All snapshots are checked, or the one named ``only``. Raises `ResultError` if it is not a result
    file or has less than ``snapshots`` snapshots, also while it is read.
    """
    try:
        if not os.path.isfile(path):
            raise ResultError(path, "it is not a regular file" if os.path.exists(path) else
                              "there is no such file")
        with h5py.File(path, "r", locking=False) as file:  # it is never changed in place
            _check(path, file, snapshots, only)
            yield file
    except ResultError:
        raise
    except (OSError, KeyError, RuntimeError, TypeError, AttributeError) as problem:
        raise ResultError(path, f"it cannot be read as a pgran result file ({error_text(problem)})"
                          ) from None


def _check(path, file, snapshots, only):
    def check(valid, reason):
        if not valid:
            raise ResultError(path, reason)

    version = file.attrs.get("format", FORMAT)
    check(version <= FORMAT, f"its format {version} belongs to a later version of pgran; this "
          f"version reads formats up to {FORMAT}")
    check(version >= OLDEST, f"its format {version} was written by a release older than 0.2; read "
          "it with that release")
    groups = file.get("snapshots")
    check(isinstance(groups, h5py.Group), "not a pgran result file: /snapshots is missing")
    check(len(groups) >= snapshots, f"it holds {len(groups)} snapshots")
    run, targets = file.attrs.get("run"), linked(file)
    for name in {only} & set(targets) if only else targets:
        problem = targets[name] and problem_of(path, run, targets[name])
        check(not problem, f"snapshot {name}: {problem}")
        group = groups[name]
        x = group.get("coordinates") if isinstance(group, h5py.Group) else None
        dim = x.ndim - 1 if isinstance(x, h5py.Dataset) else 0
        check(dim in (2, 3) and x.shape[dim] == dim,
              f"snapshot {name} has no coordinates (ny, nx, 2)")
        for key, data in group.items():
            check(isinstance(data, h5py.Dataset) and data.dtype.kind == "f"
                  and data.shape[:dim] == x.shape[:dim],
                  f"{key} of snapshot {name} is not a field of numbers on its nodes")


def field_of(file, snapshot, name):
    """Return the values (ny, nx, ...) of a field of an `opened` result; raises `ResultError`."""
    group = file["snapshots"][snapshot]
    if name not in group:
        raise ResultError(file.filename, f"snapshot {snapshot} has no field {name}; it has "
                          + ", ".join(group))
    values = group[name][...]
    if not np.isfinite(values).all():
        raise ResultError(file.filename, f"field {name} of snapshot {snapshot} contains NaN or "
                          "infinite values")
    return values


def stored_parameters(file):
    """Return the `pgran.options.Parameters` of an open result; raises `ResultError`."""
    text = file.attrs.get("options")
    if not isinstance(text, str):
        raise ResultError(file.filename, "not a pgran result file: its options are missing")
    try:
        return cases.read(written(text), stored=True)
    except (OptionError, ParameterError, ValueError) as problem:
        raise ResultError(file.filename, f"its options cannot be read ({problem})") from None


def continued(texts):
    """Return the options of a run that continues from a checkpoint, {name: text}.

    Options that are missing in ``texts`` come from the run that ``pgran_restart`` names, as does
    the output. Raises `ParameterError` if it is not a result, or if options contradict it.
    """
    path = texts[f"{PREFIX}restart"]
    stored, merged = _merged(texts, NOT_TAKEN, "a restarted run")
    mine = cases.read(merged)
    _refuse_changes(path, "a restarted run", texts, stored, [
        option.name for option in mine.options if not option.changeable
        and getattr(mine, option.name) != getattr(stored, option.name, None)])
    return {f"{PREFIX}output": path, **merged}


def begun_from(texts):
    """Return the options of a computation that starts from a snapshot; see `continued`."""
    return _merged(texts, (*NOT_TAKEN, "mode_file", "mode_amplitude"),
                   "a computation from a snapshot")[1]


def _merged(texts, left_out, what):
    """Return the parameters of the result that a restart names, and its options with ``texts``."""
    path = texts[f"{PREFIX}restart"]
    try:
        with opened(path) as file:
            stored, found = stored_parameters(file), written(file.attrs["options"])
    except ResultError as problem:
        raise ParameterError("restart", path, problem.reason) from None
    for name in left_out:
        found.pop(f"{PREFIX}{name}", None)
    _refuse_changes(path, what, texts, stored, [
        kind.name for kind in cases.KINDS
        if texts.get(PREFIX + kind.name, getattr(stored, kind.name)) != getattr(stored, kind.name)])
    return stored, {**found, **texts}


def _refuse_changes(path, what, texts, stored, names):
    if names:
        raise ParameterError("restart", path, f"{what} cannot change " + ", ".join(
            f"@{name} (here {texts[PREFIX + name]}, there {plain(getattr(stored, name, None))})"
            for name in sorted(names) if PREFIX + name in texts))
