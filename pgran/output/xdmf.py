"""XDMF: a time series of the snapshots of a result, NAME.xdmf, for ParaView and pyvista.

Vectors get a third component of zero. Tensors have their components 11, 22 and 12.
"""

import os
from contextlib import suppress
from xml.etree.ElementTree import Element, SubElement, tostring
from xml.sax.saxutils import escape

from ..space.element import DIM
from .connectivity import cells
from .files import private
from .snapshots import GROUP

#: Begin and end of the file.
BEGIN = '''<?xml version="1.0"?>
<Xdmf Version="2.0">
<Domain>
<Grid Name="pgran" GridType="Collection" CollectionType="Temporal">
'''
END = "</Grid>\n</Domain>\n</Xdmf>\n"


def add(path, shape, snapshots, fields, closed=(False, False)):
    """Add the last snapshot to NAME.xdmf, at a cost independent of the number of snapshots.

    A file that lacks earlier snapshots is written again. ``shape`` = (ny, nx) nodes. ``snapshots``
    are tuples of the name of the group, the time, and the name of the snapshot file. ``fields`` =
    {name: shape of its components} without the coordinates.
    """
    def grids(chosen):
        return "".join(_grid(path, shape, *snapshot, fields, closed) for snapshot in chosen) + END

    xdmf, text = path.with_suffix(".xdmf"), grids(snapshots[-1:]).encode()
    with suppress(FileNotFoundError), open(xdmf, "r+b", buffering=0) as file:
        end = file.seek(-len(END), os.SEEK_END)
        if len(snapshots) > 1 and file.read() == END.encode():
            file.seek(end)
            if file.write(text) == len(text):
                return
    part = private(xdmf)
    part.write_text(BEGIN + grids(snapshots))
    part.replace(xdmf)


def rename(path, new):
    """Rename the XDMF file of a result that was renamed from ``path`` to ``new``."""
    xdmf = path.with_suffix(".xdmf")
    if xdmf.exists():
        new.with_suffix(".xdmf").write_text(
            xdmf.read_text().replace(f">{escape(path.name)}:/", f">{escape(new.name)}:/"))


def _grid(path, shape, name, time, target, fields, closed):
    count, nodes = len(cells(shape, closed)), shape[0] * shape[1]
    grid = Element("Grid", Name=name, GridType="Uniform")
    SubElement(grid, "Time", Value=f"{time:.16g}")
    topology = SubElement(grid, "Topology", TopologyType="Quadrilateral",
                          NumberOfElements=str(count))
    _array(topology, f"{path.name}:/cells", (count, 4), "Int")
    geometry = SubElement(grid, "Geometry", GeometryType="XY")
    _array(geometry, f"{target}:/{GROUP}/coordinates", (nodes, DIM))
    for field, components in fields.items():
        attribute = SubElement(grid, "Attribute", Name=field, Center="Node",
                               AttributeType="Vector" if components else "Scalar")
        dataset = f"{target}:/{GROUP}/{field}"
        if tuple(components) == (DIM,):
            _padded(attribute, dataset, shape)
        else:
            _array(attribute, dataset, (nodes, *components))
    return tostring(grid, encoding="unicode") + "\n"


def _item(parent, shape, text=None, **attributes):
    item = SubElement(parent, "DataItem", Dimensions=" ".join(map(str, shape)), **attributes)
    item.text = text
    return item


def _array(parent, dataset, shape, kind="Float"):
    """Add a dataset, FILE:/PATH. VTK does not follow external links from another file."""
    _item(parent, shape, dataset, NumberType=kind, Precision="8", Format="HDF")


def _padded(parent, dataset, shape):
    """Add a field of two components with a third component of zero."""
    nodes = shape[0] * shape[1]
    join = _item(parent, (nodes, 3), ItemType="Function", Function="JOIN($0, $1, 0*$0)")
    for component in range(DIM):
        slab = _item(join, (nodes, 1), ItemType="HyperSlab")
        _item(slab, (3, 3), f"0 0 {component} 1 1 1 {shape[0]} {shape[1]} 1", NumberType="Int",
              Format="XML")
        _array(slab, dataset, (*shape, DIM))
