"""A result file is a VTKHDF file too: a temporal UnstructuredGrid of biquadratic quadrilaterals.

ParaView and pyvista then show Q2 fields as Q2. ``/VTKHDF`` holds the elements once. Points and
point data are virtual datasets: links to the fields of the snapshots, which may lie in files of
their own, padded with zeros where VTK wants three components or nine, without a second copy.
"""

import h5py
import numpy as np

from ..material.elasticity import COMPONENTS
from ..space.element import DIM
from .result import q2_elements
from .snapshots import ordered

#: The version of VTK's layout.
VERSION = 2, 0
#: VTK's number of a biquadratic quadrilateral.
BIQUADRATIC_QUAD = 28
#: Components of VTK's tensors that have those of a plane symmetric one: 11, 22 and 12.
TENSOR = (0,), (4,), (1, 3)
#: The group of ``/VTKHDF`` that has the snapshots by their numbers 0, 1, 2, ...
NUMBERED = "Snapshots"
#: What VTK calls the rows of its table of steps.
OFFSETS = "PartOffsets", "PointOffsets", "CellOffsets", "ConnectivityIdOffsets"


def link(file, closed=(False, False)):
    """Let an open result file have all its snapshots as VTKHDF.

    Parameters
    ----------
    file : h5py.File
        Open for writing.
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    """
    groups = [file["snapshots"][name] for name in ordered(file["snapshots"])]
    if groups:
        shape = groups[0]["coordinates"].shape[:2]
        write(file, [float(group.attrs["time"]) for group in groups], shape,
              {name: data.shape[2:] for name, data in groups[0].items()
               if name != "coordinates" and all(name in group for group in groups)}, closed)


def write(file, times, shape, fields, closed=(False, False)):
    """Write ``/VTKHDF`` into an open result file without it; no snapshot is opened.

    Parameters
    ----------
    file : h5py.File
        Open for writing, with ``/snapshots``.
    times : list of float
        The times of its snapshots, 1/gdot0.
    shape : tuple of int
        (ny, nx) nodes.
    fields : dict
        {name: shape of its components}, of the fields that all snapshots have.
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    """
    count, nodes = len(times), int(np.prod(shape))
    root = file.create_group("VTKHDF")
    _elements(root, shape, closed, nodes)
    numbered = root.create_group(NUMBERED)
    for number, name in enumerate(ordered(file["snapshots"])):
        numbered[str(number)] = h5py.SoftLink(f"/snapshots/{name}")
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = count
    steps["Values"] = times
    none = np.zeros(count, dtype="i8")
    steps["NumberOfParts"] = none + 1
    for name in OFFSETS:
        two = none if name in OFFSETS[:2] else none[:, None]  # one for each kind of cells
        steps[name] = np.arange(count, dtype="i8") * nodes if name == "PointOffsets" else two
    _virtual(root, "Points", "coordinates", (*shape, DIM), count)
    root.create_group("PointData")
    steps.create_group("PointDataOffsets")
    for name, components in fields.items():
        _virtual(root["PointData"], name, name, (*shape, *components), count)
        steps["PointDataOffsets"][name] = steps["PointOffsets"]


def _elements(root, shape, closed, nodes):
    """Write what does not change: the elements, and how many of everything there are."""
    elements = q2_elements(shape, closed)
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


def _virtual(root, name, field, shape, count):
    """Make a dataset that shows one after the other what the snapshots hold of a ``field``.

    ``shape`` is that of the field in one snapshot, (ny, nx, ...). One mapping serves any ``count``
    of snapshots: HDF5 puts the number of each into the name of its source. Where a snapshot is
    missing, the dataset ends.
    """
    nodes, components = shape[0] * shape[1], shape[2:]
    wide = {(): (), (DIM,): (3,), (COMPONENTS,): (9,)}.get(components, components)
    size, most = (count * nodes, *wide), (h5py.h5s.UNLIMITED, *wide)
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.VIRTUAL)
    properties.set_fill_value(np.zeros(1))

    def map_columns(first, widths, source):
        rows = h5py.h5s.create_simple(size, most)
        rows.select_hyperslab((0, *first), (h5py.h5s.UNLIMITED, *(1 for _ in first)),
                              (nodes, *(1 for _ in first)), (nodes, *widths))
        properties.set_virtual(rows, b".", f"/VTKHDF/{NUMBERED}/%b/{field}".encode(), source)

    if components == (COMPONENTS,):
        for part, places in enumerate(TENSOR):
            for place in places:
                one = h5py.h5s.create_simple(shape)
                one.select_hyperslab((0, 0, part), (1, 1, 1), block=(*shape[:2], 1))
                map_columns((place,), (1,), one)
    else:
        map_columns(tuple(0 for _ in components), components, h5py.h5s.create_simple(shape))
    space = h5py.h5s.create_simple(size, most)
    h5py.h5d.create(root.id, name.encode(), h5py.h5t.IEEE_F64LE, space, properties)
