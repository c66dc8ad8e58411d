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

    Parameters
    ----------
    file : h5py.File
        Open for writing.
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    """
    groups = [group for _, group in sorted(file["snapshots"].items())]
    if not groups:
        file.pop("VTKHDF", None)
        return
    shape = groups[0]["coordinates"].shape[:2]
    root = file.require_group("VTKHDF")
    nodes = int(np.prod(shape))
    if "Types" not in root:
        _elements(root, shape, closed, nodes)
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
    _virtual(root, "Points", [group["coordinates"] for group in groups], nodes)
    root.create_group("PointData")
    steps.create_group("PointDataOffsets")
    for name in groups[0]:
        if name != "coordinates" and all(name in group for group in groups):
            _virtual(root["PointData"], name, [group[name] for group in groups], nodes)
            steps["PointDataOffsets"][name] = starts


def _elements(root, shape, closed, nodes):
    """Write what does not change: the elements, and how many of everything there are."""
    elements = q2_elements(shape, closed)
    count, size = elements.shape
    root.attrs["Version"] = np.array(VERSION, dtype="i8")
    kind = b"UnstructuredGrid"
    root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
    root["NumberOfPoints"], root["NumberOfCells"] = [nodes], [count]
    root["NumberOfConnectivityIds"] = [elements.size]
    root["Connectivity"] = elements.ravel().astype("i8")
    root["Offsets"] = np.arange(count + 1, dtype="i8") * size
    root["Types"] = np.full(count, BIQUADRATIC_QUAD, dtype="u1")


def _virtual(root, name, sources, nodes):
    """Make a dataset that shows one after the other what the ``sources`` (ny, nx, ...) hold."""
    components = sources[0].shape[2:]
    wide = {(): (), (DIM,): (3,), (COMPONENTS,): (9,)}.get(components, components)
    layout = h5py.VirtualLayout((len(sources) * nodes, *wide), dtype="f8")
    for number, source in enumerate(sources):
        rows = slice(number * nodes, (number + 1) * nodes)
        whole = h5py.VirtualSource(".", source.name, source.shape, dtype="f8")
        if not components:
            layout[rows] = whole
        elif components == (COMPONENTS,):
            for part, places in enumerate(TENSOR):
                for place in places:
                    layout[rows, place] = whole[:, :, part]
        else:
            layout[rows, :components[0]] = whole
    root.create_virtual_dataset(name, layout, fillvalue=0.0)
