"""VTKHDF: a result file is also a temporal UnstructuredGrid of biquadratic quadrilaterals.

Points and point data are virtual datasets over the fields of the snapshots, without a second copy.
Vectors are padded with zeros to three components, and tensors to nine.
"""

import h5py
import numpy as np

from ..kinematics import AXISYMMETRIC, OUT_OF_PLANE, PLANE, SOLID, TENSORS
from .connectivity import numbers, q2_elements
from .snapshots import REPEATED, ordered

#: The version of VTK's layout.
VERSION = 2, 0
#: VTK's number of a biquadratic quadrilateral.
BIQUADRATIC_QUAD = 28
#: Directions of the components of a tensor by their number.
TENSOR = {len(kind): kind.components for kind in (PLANE, OUT_OF_PLANE, AXISYMMETRIC, SOLID)}
#: Directions of a vector.
VECTOR = 3
#: Groups of ``/VTKHDF`` that link to the snapshots and to their repeated nodes, by 0, 1, ...
NUMBERED = {"snapshots": "Snapshots", REPEATED: "Repeated"}


def link(file, closed=(False, False)):
    """Write ``/VTKHDF`` and the repeated nodes of an open result file that has all snapshots."""
    groups = {name: file["snapshots"][name] for name in ordered(file["snapshots"])}
    if not groups:
        return
    ends = tuple(map(all, zip(*(open_ends(group, closed) for group in groups.values()))))
    for name, group in groups.items():
        repeat(group, file, f"{REPEATED}/{name}", ends)
    first, *more = groups.values()
    write(file, [float(group.attrs["time"]) for group in groups.values()],
          first["coordinates"].shape[:2],
          {name: data.shape[2:] for name, data in first.items()
           if name != "coordinates" and all(name in group for group in more)}, closed, ends)


def write(file, times, shape, fields, closed=(False, False), ends=(False, False)):
    """Write ``/VTKHDF`` into an open result file; no snapshot is opened.

    ``times`` (1/gdot0) belong to the snapshots on ``shape`` = (ny, nx) nodes, ``ends`` are the
    directions with repeated nodes, and ``fields`` = {name: shape of its components}.
    """
    elements, count = q2_elements(shape, closed, ends), len(times)
    nodes, own = numbers(shape, ends).size, shape[0] * shape[1]
    parts = {"snapshots": (shape, 0)}  # {group: shape and first number of its nodes}
    if nodes > own:
        parts[REPEATED] = (nodes - own,), own
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = np.array(VERSION, dtype="i8")
    kind = b"UnstructuredGrid"
    root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
    root["NumberOfPoints"], root["NumberOfCells"] = [nodes], [len(elements)]
    root["NumberOfConnectivityIds"] = [elements.size]
    for name, values in {
            "Connectivity": elements.ravel().astype("i8"),
            "Offsets": np.arange(len(elements) + 1, dtype="i8") * elements.shape[1],
            "Types": np.full(len(elements), BIQUADRATIC_QUAD, dtype="u1")}.items():
        root.create_dataset(name, data=values, shuffle=True, compression="gzip")
    for source in parts:
        numbered = root.create_group(NUMBERED[source])
        for number, name in enumerate(ordered(file["snapshots"])):
            numbered[str(number)] = h5py.SoftLink(f"/{source}/{name}")
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = count
    steps["Values"] = times
    zeros = np.zeros(count, dtype="i8")
    steps["NumberOfParts"] = zeros + 1
    steps["PartOffsets"], steps["PointOffsets"] = zeros, np.arange(count, dtype="i8") * nodes
    steps["CellOffsets"] = steps["ConnectivityIdOffsets"] = zeros[:, None]  # one kind of cells
    _virtual(root, "Points", "coordinates", (2,), count, nodes, parts)
    root.create_group("PointData")
    steps.create_group("PointDataOffsets")
    for name, components in fields.items():
        _virtual(root["PointData"], name, name, components, count, nodes, parts)
        steps["PointDataOffsets"][name] = steps["PointOffsets"]


def open_ends(group, closed):
    """Return along which of x1 and x2 a snapshot (h5py.Group) is periodic but not closed."""
    period = group["coordinates"].attrs.get("period", np.zeros((2, 2)))
    return tuple(not wrap and bool(np.any(shift)) for wrap, shift in zip(closed, period))


def repeat(group, file, target, ends):
    """Write the fields of a snapshot at its repeated nodes, if any, into a new group ``target``.

    The nodes are in the order of `numbers`.
    """
    for name, data in group.items():
        along, up = data.attrs.get("period", np.zeros(2))
        parts = []
        if ends[0]:
            parts.append(data[:, 0] + along)
        if ends[1]:
            parts.append(data[0] + up)
        if all(ends):
            parts.append(data[:1, 0] + along + up)
        if parts:
            file[f"{target}/{name}"] = np.concatenate(parts)


def _virtual(root, name, field, components, count, nodes, parts):
    """Create a dataset that shows a field of all snapshots one after the other.

    One mapping is sufficient, because HDF5 inserts the number of the snapshot into the name of the
    source.
    """
    tensor = TENSOR[components[0]] if field in TENSORS else None
    width = (VECTOR**2,) if tensor else (VECTOR,) if components == (2,) else components
    size, maximum = (count * nodes, *width), (h5py.h5s.UNLIMITED, *width)
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.VIRTUAL)
    properties.set_fill_value(np.zeros(1))
    if tensor:  # (component of VTK, number of components, own component)
        columns = [((column,), (1,), own) for own, (i, j) in enumerate(tensor)
                   for column in sorted({VECTOR * i + j, VECTOR * j + i})]
    else:
        columns = [((0,) * len(components), components, None)]
    for source, (grid, start) in parts.items():
        for first, block, own in columns:
            rows = h5py.h5s.create_simple(size, maximum)
            ones = (1,) * len(first)
            rows.select_hyperslab((start, *first), (h5py.h5s.UNLIMITED, *ones), (nodes, *ones),
                                  (int(np.prod(grid)), *block))
            space = h5py.h5s.create_simple((*grid, *components))
            if own is not None:
                space.select_hyperslab((*(0 for _ in grid), own), (1,) * (len(grid) + 1),
                                       block=(*grid, 1))
            properties.set_virtual(
                rows, b".", f"/VTKHDF/{NUMBERED[source]}/%b/{field}".encode(), space)
    space = h5py.h5s.create_simple(size, maximum)
    h5py.h5d.create(root.id, name.encode(), h5py.h5t.IEEE_F64LE, space, properties)
