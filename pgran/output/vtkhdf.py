"""A result file is a VTKHDF file too: a temporal UnstructuredGrid of biquadratic quadrilaterals.

ParaView and pyvista then show Q2 fields as Q2. ``/VTKHDF`` holds the elements once. Points and
point data are virtual datasets: links to the fields of the snapshots, which may lie in files of
their own, padded with zeros where VTK wants three components or nine, without a second copy.
"""

import h5py
import numpy as np

from ..material.elasticity import COMPONENTS
from ..space.element import DIM
from .result import numbers, q2_elements
from .snapshots import REPEATED, ordered

#: The version of VTK's layout.
VERSION = 2, 0
#: VTK's number of a biquadratic quadrilateral.
BIQUADRATIC_QUAD = 28
#: Components of VTK's tensors that have those of a plane symmetric one: 11, 22 and 12.
TENSOR = (0,), (4,), (1, 3)
#: The groups of ``/VTKHDF`` that have the snapshots, and their repeated nodes, by numbers 0, 1, ...
NUMBERED = {"snapshots": "Snapshots", REPEATED: "Repeated"}
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
    groups = {name: file["snapshots"][name] for name in ordered(file["snapshots"])}
    if not groups:
        return
    ends = tuple(map(all, zip(*(open_ends(group, closed) for group in groups.values()))))
    for name, group in groups.items():
        if any(ends):
            repeat(group, file.require_group(f"{REPEATED}/{name}"), ends)
    first, *more = groups.values()
    write(file, [float(group.attrs["time"]) for group in groups.values()],
          first["coordinates"].shape[:2],
          {name: data.shape[2:] for name, data in first.items()
           if name != "coordinates" and all(name in group for group in more)}, closed, ends)


def write(file, times, shape, fields, closed=(False, False), ends=(False, False)):
    """Write ``/VTKHDF`` into an open result file without it; no snapshot is opened.

    Parameters
    ----------
    file : h5py.File
        Open for writing, with ``/snapshots`` and, if ``ends`` says so, ``/repeated``.
    times : list of float
        The times of its snapshots, 1/gdot0.
    shape : tuple of int
        (ny, nx) nodes.
    fields : dict
        {name: shape of its components}, of the fields that all snapshots have.
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    ends : tuple of bool
        Along which of x1 and x2 the first nodes are repeated.
    """
    count, more = len(times), numbers(shape, ends).size - shape[0] * shape[1]
    nodes = shape[0] * shape[1] + more
    root = file.create_group("VTKHDF")
    _elements(root, q2_elements(shape, closed, ends), nodes)
    for source in ("snapshots", REPEATED) if more else ("snapshots",):
        numbered = root.create_group(NUMBERED[source])
        for number, name in enumerate(ordered(file["snapshots"])):
            numbered[str(number)] = h5py.SoftLink(f"/{source}/{name}")
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = count
    steps["Values"] = times
    none = np.zeros(count, dtype="i8")
    steps["NumberOfParts"] = none + 1
    for name in OFFSETS:
        two = none if name in OFFSETS[:2] else none[:, None]  # one for each kind of cells
        steps[name] = np.arange(count, dtype="i8") * nodes if name == "PointOffsets" else two
    _virtual(root, "Points", "coordinates", shape, (DIM,), count, more)
    root.create_group("PointData")
    steps.create_group("PointDataOffsets")
    for name, components in fields.items():
        _virtual(root["PointData"], name, name, shape, components, count, more)
        steps["PointDataOffsets"][name] = steps["PointOffsets"]


def open_ends(group, closed):
    """Return whether the grid of a snapshot (h5py.Group) is periodic without being closed in space.

    Along x1 and x2, by the attribute ``period`` of its coordinates.
    """
    period = group["coordinates"].attrs.get("period", np.zeros((DIM, DIM)))
    return tuple(not wrap and bool(np.any(shift)) for wrap, shift in zip(closed, period))


def repeat(group, found, ends):
    """Write the fields of a snapshot at the repeated nodes.

    Parameters
    ----------
    group : h5py.Group
        The snapshot. Fields with an attribute ``period`` change by it.
    found : h5py.Group
        Where the fields (n, ...) go, in the order in which `pgran.output.result.numbers` counts
        the repeated nodes. Fields that it has are left as they are.
    ends : tuple of bool
        Along which of x1 and x2 the first nodes are repeated.
    """
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


def _elements(root, elements, nodes):
    """Write what does not change: the elements, and how many of everything there are."""
    count, size = elements.shape
    root.attrs["Version"] = np.array(VERSION, dtype="i8")
    kind = b"UnstructuredGrid"
    root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
    root["NumberOfPoints"], root["NumberOfCells"] = [nodes], [count]
    root["NumberOfConnectivityIds"] = [elements.size]
    for name, values in (("Connectivity", elements.ravel().astype("i8")),
                         ("Offsets", np.arange(count + 1, dtype="i8") * size),
                         ("Types", np.full(count, BIQUADRATIC_QUAD, dtype="u1"))):
        root.create_dataset(name, data=values, shuffle=True, compression="gzip")


def _virtual(root, name, field, shape, components, count, more):
    """Make a dataset that shows one after the other what the snapshots hold of a ``field``.

    The field is (*shape, *components) in one snapshot, and (more, *components) at its repeated
    nodes. One mapping serves any ``count`` of snapshots: HDF5 puts the number of each into the name
    of its source. Where a snapshot is missing, the dataset ends.
    """
    inner = shape[0] * shape[1]
    nodes = inner + more
    wide = {(): (), (DIM,): (3,), (COMPONENTS,): (9,)}.get(components, components)
    size, most = (count * nodes, *wide), (h5py.h5s.UNLIMITED, *wide)
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.VIRTUAL)
    properties.set_fill_value(np.zeros(1))

    def map_columns(source, grid, start, columns, values):
        rows = h5py.h5s.create_simple(size, most)
        ones = (1,) * len(columns)
        rows.select_hyperslab((start, *columns), (h5py.h5s.UNLIMITED, *ones), (nodes, *ones),
                              (int(np.prod(grid)), *(ones if values is None else values)))
        space = h5py.h5s.create_simple((*grid, *components))
        if values is None:  # one component of a tensor
            part = next(part for part, places in enumerate(TENSOR) if columns[0] in places)
            space.select_hyperslab((*(0 for _ in grid), part), (1,) * (len(grid) + 1),
                                   block=(*grid, 1))
        properties.set_virtual(
            rows, b".", f"/VTKHDF/{NUMBERED[source]}/%b/{field}".encode(), space)

    for source, grid, start in (("snapshots", shape, 0), (REPEATED, (more,), inner)):
        if source == REPEATED and not more:
            continue
        if components == (COMPONENTS,):
            for place in sorted(sum(TENSOR, ())):
                map_columns(source, grid, start, (place,), None)
        else:
            map_columns(source, grid, start, tuple(0 for _ in components), components)
    space = h5py.h5s.create_simple(size, most)
    h5py.h5d.create(root.id, name.encode(), h5py.h5t.IEEE_F64LE, space, properties)
