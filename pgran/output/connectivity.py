"""Node numbers of cells and Q2 elements on a grid of (ny, nx) nodes, numpy only.

``closed`` directions (bool for x1 and x2) form a ring. Other periodic directions can have their
first nodes ``repeated`` at the end of the period.
"""

import numpy as np

#: Offsets (x2, x1) of the nodes of a cell, and of VTK's biquadratic quadrilateral.
CELL = (0, 0), (0, 1), (1, 1), (1, 0)
QUADRATIC = (0, 0), (0, 2), (2, 2), (2, 0), (0, 1), (1, 2), (2, 1), (1, 0), (1, 1)


def cells(shape, closed=(False, False)):
    """Return the nodes (n, 4) of the cells between ``shape`` = (ny, nx) nodes, counterclockwise."""
    return _elements(numbers(shape, (False, False)), closed, 1, CELL)


def q2_elements(shape, closed=(False, False), repeated=(False, False)):
    """Return the nodes (n, 9) of the Q2 elements on ``shape`` = (ny, nx) nodes, in VTK's order.

    Elements beyond the last nodes are left out unless the direction is ``closed`` or ``repeated``.
    """
    return _elements(numbers(shape, repeated), closed, 2, QUADRATIC)


def _elements(node, closed, size, offsets):
    n2, n1 = ((n if wrap else n - 1) // size for n, wrap in zip(node.shape, closed[::-1]))
    j, i = (size * index.ravel() for index in np.indices((n2, n1)))
    ny, nx = node.shape
    return np.stack([node[(j + up) % ny, (i + along) % nx] for up, along in offsets], axis=1)


def numbers(shape, repeated):
    """Return the numbers of nodes, (ny, nx) and larger by one row or column of repeated nodes.

    The repeated nodes have the last numbers, row by row.
    """
    ny, nx = shape
    found = np.full((ny + int(repeated[1]), nx + int(repeated[0])), -1)
    found[:ny, :nx] = np.arange(ny * nx).reshape(shape)
    found[found < 0] = np.arange(ny * nx, found.size)
    return found
