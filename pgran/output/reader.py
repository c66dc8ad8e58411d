"""Reading result files, by h5py only: what is no whole result is refused with the reason."""

import os
from contextlib import contextmanager

import h5py
import numpy as np

from .. import cases
from ..material.elasticity import COMPONENTS
from ..options import PREFIX, OptionError, ParameterError, plain, written
from ..space.element import DIM
from .files import told
from .snapshots import linked, problem_of

#: Version of the layout of result files. Those of 3 hold their snapshots, those of 2 also have no
#: /VTKHDF and no units; all are read.
FORMAT = 4
#: Components of fields that have any, (shape).
FIELDS = {"coordinates": (DIM,), "velocity": (DIM,), "deviator": (COMPONENTS,)}
#: Options of a result that what starts from it does not take over.
NOT_TAKEN = "restart", "restart_snapshot", "output", "progress"


class ResultError(ValueError):
    """A file is not a result of pgran, or not a whole one; ``reason`` does not name the file."""

    def __init__(self, path, reason):
        super().__init__(f"{path}: {reason}")
        self.reason = reason


@contextmanager
def opened(path, snapshots=0, only=None):
    """Open a result file to read it, as a context. Not collective.

    ``snapshots`` says how many snapshots it must hold at least. ``only`` names the snapshot that
    will be read; all of them are checked unless it is given.

    Raises
    ------
    ResultError
        If it is not one of pgran's results, or ends early, when it is opened or while it is read.
    """
    try:
        if not os.path.exists(path):
            raise ResultError(path, "there is no such file")
        if not os.path.isfile(path):
            raise ResultError(path, "it is not a regular file")
        with h5py.File(path, "r", locking=False) as file:  # it is never changed in place
            _check(path, file, snapshots, only)
            yield file
    except ResultError:
        raise
    except (OSError, KeyError, RuntimeError, TypeError, AttributeError) as problem:
        raise ResultError(path, f"it cannot be read as a result of pgran ({told(problem)})"
                          ) from None


def _check(path, file, snapshots, only):
    """Raise `ResultError` unless a file has the layout of a result."""
    version = file.attrs.get("format", FORMAT)
    if version > FORMAT:
        raise ResultError(path, f"its format is {version}, that of a later pgran; this one reads "
                          f"up to {FORMAT}")
    groups = file.get("snapshots")
    if not isinstance(groups, h5py.Group):
        raise ResultError(path, "it is no result of pgran: /snapshots is missing")
    if len(groups) < snapshots:
        raise ResultError(path, f"it holds {len(groups)} snapshots")
    run, targets = file.attrs.get("run"), linked(file)
    for name in targets if only is None else {only} & set(targets):
        if targets[name] and (problem := problem_of(path, run, targets[name])):
            raise ResultError(path, f"snapshot {name}: {problem}")
        group = groups[name]
        coordinates = group.get("coordinates") if isinstance(group, h5py.Group) else None
        if not isinstance(coordinates, h5py.Dataset) or coordinates.ndim != 3 \
                or coordinates.shape[2] != DIM:
            raise ResultError(path, f"snapshot {name} has no coordinates (ny, nx, {DIM})")
        for key, data in group.items():
            if not isinstance(data, h5py.Dataset) or data.dtype.kind != "f" \
                    or data.shape[:2] != coordinates.shape[:2]:
                raise ResultError(path, f"{key} of snapshot {name} is no field of numbers on its "
                                  "nodes")


def field_of(file, snapshot, name):
    """Return the values (ny, nx, ...) of a field of an `opened` result; raises `ResultError`."""
    group = file["snapshots"][snapshot]
    if name not in group:
        raise ResultError(file.filename, f"snapshot {snapshot} has no field {name}; it has "
                          + ", ".join(group))
    values = group[name][...]
    if not np.isfinite(values).all():
        raise ResultError(file.filename, f"field {name} of snapshot {snapshot} is not a number "
                          "everywhere")
    return values


def stored_parameters(file):
    """Return the `pgran.options.Parameters` that an open result was made with.

    Raises `ResultError` where they cannot be read.
    """
    text = file.attrs.get("options")
    if not isinstance(text, str):
        raise ResultError(file.filename, "it is no result of pgran: its options are missing")
    try:
        return cases.read(written(text), stored=True)
    except (OptionError, ParameterError, ValueError) as problem:
        raise ResultError(file.filename, f"its options cannot be read ({problem})") from None


def continued(texts):
    """Return the options of a run that goes on from the checkpoint of another one, {name: text}.

    What is not given in ``texts`` is as it was in the run that ``pgran_restart`` names, and the
    result goes on in its file.

    Raises
    ------
    ParameterError
        If the file is no result, or if options contradict it.
    """
    path = texts[f"{PREFIX}restart"]
    theirs, merged = _taken_over(texts, NOT_TAKEN, "a run that goes on")
    mine = cases.read(merged)
    _refuse_changes(path, "a run that goes on", texts, theirs, [
        row.name for row in mine.options if not row.changeable
        and getattr(mine, row.name) != getattr(theirs, row.name, None)])
    return {f"{PREFIX}output": path, **merged}


def begun_from(texts):
    """Return the options of a computation that begins at a snapshot of a result, {name: text}.

    What is not given in ``texts`` is as it was in the run that ``pgran_restart`` names.

    Raises
    ------
    ParameterError
        If the file is no result, or one of another case, model or law.
    """
    return _taken_over(texts, (*NOT_TAKEN, "mode_file", "mode_amplitude"), "what begins at a snapshot")[1]


def _taken_over(texts, left_out, what):
    """The parameters of the result that a restart names, and its options below ``texts``."""
    path = texts[f"{PREFIX}restart"]
    try:
        with opened(path) as file:
            theirs = stored_parameters(file)
            then = written(file.attrs["options"])
    except ResultError as problem:
        raise ParameterError("restart", path, problem.reason) from None
    for name in left_out:
        then.pop(f"{PREFIX}{name}", None)
    _refuse_changes(path, what, texts, theirs, [
        name for name in (kind.name for kind in cases.KINDS)
        if texts.get(f"{PREFIX}{name}", getattr(theirs, name)) != getattr(theirs, name)])
    return theirs, {**then, **texts}


def _refuse_changes(path, what, texts, theirs, names):
    if names:
        raise ParameterError("restart", path, f"{what} cannot change " + ", ".join(
            f"@{name} (here {texts[PREFIX + name]}, there {plain(getattr(theirs, name, None))})"
            for name in sorted(names) if PREFIX + name in texts))
