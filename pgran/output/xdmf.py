"""XDMF: a time series of the snapshots of a result, NAME.xdmf, for ParaView and pyvista.

Vectors get a third component of zero. Tensors have their components 11, 22 and 12.
"""

import os
from contextlib import suppress
from xml.sax.saxutils import escape

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
    parts = [f'<Grid Name="{name}" GridType="Uniform"><Time Value="{time:.16g}" />'
             f'<Topology TopologyType="Quadrilateral" NumberOfElements="{count}">',
             _array(f"{path.name}:/cells", (count, 4), "Int"),
             '</Topology><Geometry GeometryType="XY">',
             _array(f"{target}:/{GROUP}/coordinates", (nodes, 2)), "</Geometry>"]
    for field, components in fields.items():
        dataset = f"{target}:/{GROUP}/{field}"
        kind = "Matrix" if sum(components) > 3 else "Vector" if components else "Scalar"
        parts += [f'<Attribute Name="{field}" Center="Node" AttributeType="{kind}">',
                  _padded(dataset, shape) if tuple(components) == (2,) else
                  _array(dataset, (nodes, *components)), "</Attribute>"]
    return "".join(parts) + "</Grid>\n"


def _item(shape, attributes, content):
    return f'<DataItem Dimensions="{" ".join(map(str, shape))}" {attributes}>{content}</DataItem>'


def _array(dataset, shape, kind="Float"):
    """Return a dataset, FILE:/PATH. VTK does not follow external links from another file."""
    return _item(shape, f'NumberType="{kind}" Precision="8" Format="HDF"', escape(dataset))


def _padded(dataset, shape):
    """Return a field of two components with a third component of zero."""
    nodes, array = shape[0] * shape[1], _array(dataset, (*shape, 2))
    slabs = [_item((nodes, 1), 'ItemType="HyperSlab"', _item(
        (3, 3), 'NumberType="Int" Format="XML"',
        f"0 0 {component} 1 1 1 {shape[0]} {shape[1]} 1") + array) for component in range(2)]
    return _item((nodes, 3), 'ItemType="Function" Function="JOIN($0, $1, 0*$0)"', "".join(slabs))
