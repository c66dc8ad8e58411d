"""Start files of a run: snapshots, modes and earlier results. Collective."""

from typing import NamedTuple

import h5py
import numpy as np

from ..options import ParameterError
from .files import collectively, local_part
from .reader import ResultError, opened, stored_parameters
from .snapshots import ordered

#: Prefix of the fields of the base flow of a mode.
BASE = "base_"


class Source(NamedTuple):
    """The first ``steps`` and ``snapshots`` of the result ``path`` that a run continues."""

    path: str
    run: str
    steps: int
    snapshots: int


def read_snapshot(parameters, form):
    """Return attributes and fields {name: (..., n_local)} of the snapshot named by a restart.

    Raises `ParameterError` if the file, the snapshot, its grid or its physics does not fit.
    """
    return _read_fields(parameters, "restart", parameters.restart_snapshot, form,
                        ("coordinates", "velocity", "pressure", "fluidity", "deviator"))


def read_mode(parameters, form):
    """Return the mode of a mode file and its base flow, {name: (..., n_local)}.

    The base flow is empty if it is the reference flow. Raises `ParameterError` like
    `read_snapshot`.
    """
    names = ("velocity", "pressure") + (("fluidity",) if form.grid.has_fluidity else ())
    base = tuple(BASE + name for name in (*names, "deviator"))
    _, fields = _read_fields(parameters, "mode_file", 0, form, names, base)
    return fields, {name[len(BASE):]: fields.pop(name) for name in base if name in fields}


def _read_fields(parameters, start, number, form, names, optional=()):
    path, lattice, dim = getattr(parameters, start), form.grid.nodes, form.grid.dim
    sizes = form.kinematics.sizes()

    def refuse(reason):
        raise ParameterError(start, path, reason)

    def read(file):
        if start == "mode_file" and "growth_rate" not in file.attrs:
            refuse("it holds no mode; mode files are written by pgran.eigen")
        found = ordered(file["snapshots"])
        if not -len(found) <= number < len(found):
            refuse(f"it holds {len(found)} snapshots; there is no snapshot {number}")
        group = file["snapshots"][found[number]]
        wanted = (*names, *(name for name in optional if name in group))
        for name in wanted:
            size = sizes.get(name.removeprefix(BASE), ())
            data = group.get(name)
            if not isinstance(data, h5py.Dataset) or data.shape[dim:] != size:
                refuse(f"snapshot {found[number]} has no field {name} of {len(size) + dim} "
                       "dimensions")
            if data.shape[:dim] != lattice.shape[::-1]:
                here, there = (" x ".join(map(str, shape)) for shape in (
                    lattice.shape, data.shape[dim - 1::-1]))
                refuse(f"its {there} nodes are not the {here} of this grid")
        stored = stored_parameters(file)
        if start == "mode_file" and stored.restart and not set(optional) <= set(wanted):
            refuse("its mode belongs to a deformed mesh; a run can start from modes of reference "
                   "flows and of fixed meshes")
        for option in parameters.options:
            mine, other = (getattr(of, option.name, None) for of in (parameters, stored))
            if start in option.shared and mine != other:
                raise ParameterError(option.name, mine, f"{path} was made with {other}")
        fields = {name: local_part(group[name], lattice.index) for name in wanted}
        for name, values in fields.items():
            if not np.isfinite(values).all():
                refuse(f"its field {name} contains NaN or infinite values")
        return dict(group.attrs), fields

    def action():
        try:
            with opened(path) as file:
                return read(file)
        except ResultError as problem:
            refuse(problem.reason)

    return collectively(form.grid.comm.tompi4py(), action)
