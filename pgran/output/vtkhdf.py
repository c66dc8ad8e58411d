"""A result file is a VTKHDF file too: a temporal UnstructuredGrid of biquadratic quadrilaterals.

ParaView and pyvista then show Q2 fields as Q2. ``/VTKHDF`` holds the elements once. Points and
point data are virtual datasets: links to the fields of the snapshots, padded with zeros where VTK
wants three components or nine, without a second copy.
"""

import h5py
import numpy as np

from ..material.elasticity import COMPONENTS
from ..space.element import DIM
from .result import q2_elements

#: The version of VTK's layout.
VERSION = 2, 0
#: VTK's number of a biquadratic quadrilateral.
BIQUADRATIC_QUAD = 28
#: Components of VTK's tensors that have those of a plane symmetric one: 11, 22 and 12.
TENSOR = (0,), (4,), (1, 3)
#: What VTK calls the rows of its table of steps.
OFFSETS = "PartOffsets", "PointOffsets", "CellOffsets", "ConnectivityIdOffsets"


def link(file, closed=(False, False)):
    """Let an open result file have all its snapshots as VTKHDF.

    On a grid that is periodic without being closed in space, the first nodes are repeated at the
    end of the period: ``/repeated/NNNN`` holds the fields there, see `repeat`.

    Parameters
    ----------
    file : h5py.File
        Open for writing, with the values of its snapshots.
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    """
    groups = [group for _, group in sorted(file["snapshots"].items())]
    for name in set(file.get("repeated", ())) - set(file["snapshots"]):
        del file["repeated"][name]
    if not groups:
        file.pop("VTKHDF", None)
        return
    shape = groups[0]["coordinates"].shape[:2]
    ends = tuple(map(all, zip(*(open_ends(group, closed) for group in groups))))
    more = [repeat(file, group, ends) for group in groups] if any(ends) else []
    elements = q2_elements(shape, closed, ends)
    nodes = int(np.prod(shape)) + (len(more[0]["coordinates"]) if more else 0)
    root = file.require_group("VTKHDF")
    if "Types" not in root or root["NumberOfPoints"][0] != nodes:
        _elements(root, elements, nodes)
    for name in ("Points", "PointData", "Steps"):
        root.pop(name, None)
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = len(groups)
    steps["Values"] = [float(group.attrs["time"]) for group in groups]
    starts = np.arange(len(groups), dtype="i8") * nodes
    none = np.zeros_like(starts)
    steps["NumberOfParts"] = none + 1
    for name in OFFSETS:
        two = none if name in OFFSETS[:2] else none[:, None]  # one for each kind of cells
        steps[name] = starts if name == "PointOffsets" else two

    def sources(name):
        return list(zip(*([group[name] for group in part] for part in (groups, more) if part)))

    _virtual(root, "Points", sources("coordinates"), nodes)
    root.create_group("PointData")
    steps.create_group("PointDataOffsets")
    for name in groups[0]:
        if name != "coordinates" and all(name in group for group in groups):
            _virtual(root["PointData"], name, sources(name), nodes)
            steps["PointDataOffsets"][name] = starts


def open_ends(group, closed):
    """Return whether the grid of a snapshot (h5py.Group) is periodic without being closed in space.

    Along x1 and x2, by the attribute ``period`` of its coordinates.
    """
    period = group["coordinates"].attrs.get("period", np.zeros((DIM, DIM)))
    return tuple(not wrap and bool(np.any(shift)) for wrap, shift in zip(closed, period))


def repeat(file, group, ends):
    """Write the fields of a snapshot at the repeated nodes, unless they are there; return them.

    Parameters
    ----------
    file : h5py.File
        Where ``/repeated/NNNN`` lies.
    group : h5py.Group
        The snapshot. Fields with an attribute ``period`` change by it.
    ends : tuple of bool
        Along which of x1 and x2 the first nodes are repeated.

    Returns
    -------
    h5py.Group
        Fields (n, ...) in the order in which `q2_elements` numbers the repeated nodes.
    """
    found = file.require_group(f"repeated/{group.name.rsplit('/', 1)[-1]}")
    for name, data in group.items():
        if name in found:
            continue
        along, up = data.attrs.get("period", np.zeros(DIM))
        parts = []
        if ends[0]:
            parts.append(data[:, 0] + along)
        if ends[1]:
            parts.append(data[0] + up)
        if all(ends):
            parts.append(data[:1, 0] + along + up)
        found[name] = np.concatenate(parts)
    return found


def _elements(root, elements, nodes):
    """Write what does not change: the elements, and how many of everything there are."""
    count, size = elements.shape
    root.attrs["Version"] = np.array(VERSION, dtype="i8")
    kind = b"UnstructuredGrid"
    root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
    for name, values in {
            "NumberOfPoints": [nodes], "NumberOfCells": [count],
            "NumberOfConnectivityIds": [elements.size],
            "Connectivity": elements.ravel().astype("i8"),
            "Offsets": np.arange(count + 1, dtype="i8") * size,
            "Types": np.full(count, BIQUADRATIC_QUAD, dtype="u1")}.items():
        root.pop(name, None)
        root[name] = values


def _virtual(root, name, sources, nodes):
    """Make a dataset that shows one after the other what the ``sources`` hold.

    For each snapshot these are a field (ny, nx, ...), and perhaps the same field (n, ...) at the
    repeated nodes; ``nodes`` is the number of all of them.
    """
    components = sources[0][0].shape[2:]
    wide = {(): (), (DIM,): (3,), (COMPONENTS,): (9,)}.get(components, components)
    layout = h5py.VirtualLayout((len(sources) * nodes, *wide), dtype="f8")
    for number, parts in enumerate(sources):
        first = number * nodes
        for part in parts:
            whole = h5py.VirtualSource(".", part.name, part.shape, dtype="f8")
            count = part.size // int(np.prod(components, dtype=int))
            rows, first = slice(first, first + count), first + count
            if not components:
                layout[rows] = whole
            elif components == (COMPONENTS,):
                for component, places in enumerate(TENSOR):
                    for place in places:
                        layout[rows, place] = whole[..., component]
            else:
                layout[rows, :components[0]] = whole
    root.create_virtual_dataset(name, layout, fillvalue=0.0)
