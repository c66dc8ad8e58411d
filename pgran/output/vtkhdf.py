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
    end of the period. Where coordinates or velocity differ there by a constant, ``/repeated`` holds
    them.

    Parameters
    ----------
    file : h5py.File
        Open for writing, with the values of its snapshots.
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    """
    groups = [group for _, group in sorted(file["snapshots"].items())]
    if not groups:
        file.pop("VTKHDF", None)
        file.pop("repeated", None)
        return
    shape = groups[0]["coordinates"].shape[:2]
    ends = [_open_ends(group, closed) for group in groups]
    repeated = tuple(map(all, zip(*ends)))
    pieces = _pieces(shape, repeated)
    whole = tuple(n + int(more) for n, more in zip(shape, repeated[::-1]))
    nodes = int(np.prod(whole))
    root = file.require_group("VTKHDF")
    if "Types" not in root or root["NumberOfPoints"][0] != nodes:
        _elements(root, whole, closed, nodes)
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
    for name in set(file.get("repeated", ())) - set(file["snapshots"]):
        del file["repeated"][name]
    _virtual(root, "Points", [_sources(file, group, "coordinates", pieces) for group in groups],
             nodes)
    root.create_group("PointData")
    steps.create_group("PointDataOffsets")
    for name in groups[0]:
        if name != "coordinates" and all(name in group for group in groups):
            _virtual(root["PointData"], name,
                     [_sources(file, group, name, pieces) for group in groups], nodes)
            steps["PointDataOffsets"][name] = starts


def _elements(root, shape, closed, nodes):
    """Write what does not change: the elements, and how many of everything there are."""
    elements = q2_elements(shape, closed)
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


def _open_ends(group, closed):
    """Whether the grid of a snapshot is periodic without being closed, along x1 and x2."""
    period = group["coordinates"].attrs.get("period", np.zeros((DIM, DIM)))
    return tuple(not wrap and bool(np.any(shift)) for wrap, shift in zip(closed, period))


def _pieces(shape, repeated):
    """The parts of a grid of ``shape`` = (ny, nx) nodes with its ``repeated`` first nodes.

    {name: (nodes, places, axes)}: the places (slices) of nodes of the file, in whose order the
    ``nodes`` (slice) of the grid are, and along which axes the part is moved by the period.
    """
    ny, nx = shape
    right, top = repeated
    wide, every, first = nx + int(right), slice(None), slice(0, 1)
    found = {"inner": (h5py.MultiBlockSlice(0, wide, ny, nx) if right else slice(0, ny * nx),
                       (every, every), ())}
    if right:
        found["right"] = slice(nx, ny * wide, wide), (every, first), (0,)
    if top:
        found["top"] = slice(ny * wide, ny * wide + nx), (first, every), (1,)
    if right and top:
        found["corner"] = slice(ny * wide + nx, (ny + 1) * wide), (first, first), (0, 1)
    return found


def _sources(file, group, name, pieces):
    """The shape of the components of a field, and where the grid has its values from.

    The latter is a list of the nodes (slice) of the grid, a virtual source, and the places (slices)
    of these nodes in it, see `_pieces`.
    """
    data, found = group[name], []
    period = data.attrs.get("period", np.zeros(DIM))
    for piece, (nodes, places, axes) in pieces.items():
        shift = sum(period[axis] for axis in axes)
        if np.any(shift):
            path = f"repeated/{group.name.rsplit('/', 1)[-1]}/{name}/{piece}"
            if path not in file:
                file[path] = data[places] + shift
            stored, places = file[path], (slice(None), slice(None))
        else:
            stored = data
        source = h5py.VirtualSource(".", stored.name, stored.shape, dtype="f8")
        found.append((nodes, source, places))
    return data.shape[2:], found


def _virtual(root, name, sources, nodes):
    """Make a dataset that shows one after the other what the ``sources`` of `_sources` hold."""
    components = sources[0][0]
    wide = {(): (), (DIM,): (3,), (COMPONENTS,): (9,)}.get(components, components)
    layout = h5py.VirtualLayout((len(sources) * nodes, *wide), dtype="f8")
    for number, (_, parts) in enumerate(sources):
        for rows, source, places in parts:
            rows = _moved(rows, number * nodes)
            if not components:
                layout[rows] = source[places]
            elif components == (COMPONENTS,):
                for part, columns in enumerate(TENSOR):
                    for column in columns:
                        layout[rows, column] = source[(*places, part)]
            else:
                layout[rows, :components[0]] = source[places]
    root.create_virtual_dataset(name, layout, fillvalue=0.0)


def _moved(rows, by):
    """A slice of h5py that begins later."""
    if isinstance(rows, h5py.MultiBlockSlice):
        return h5py.MultiBlockSlice(by + rows.start, rows.stride, rows.count, rows.block)
    return slice(by + rows.start, by + rows.stop, rows.step)
