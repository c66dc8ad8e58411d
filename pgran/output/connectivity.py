"""Node numbers of cells and Q2 elements on a grid of (ny, nx) nodes, numpy only.

A direction is ``closed`` if its last nodes are neighbours of its first nodes in space, as around a
ring. A periodic direction that is not closed can have its first nodes ``repeated`` at the end of
the period. Both are tuples of bool, for x1 and x2.
"""

import numpy as np

#: Order of the nodes of VTK's biquadratic quadrilateral, as indices of the nodes of an element.
VTK_NODES = 0, 2, 8, 6, 1, 5, 7, 3, 4


def cells(shape, closed=(False, False)):
    """Return the nodes (n, 4) of the cells between ``shape`` = (ny, nx) nodes, counterclockwise."""
    ny, nx = shape
    n1, n2 = (n if wrap else n - 1 for n, wrap in zip((nx, ny), closed))
    j, i = (index.ravel() for index in np.mgrid[:n2, :n1])
    right, up = (i + 1) % nx, (j + 1) % ny
    return np.stack([j * nx + i, j * nx + right, up * nx + right, up * nx + i], axis=1)


def q2_elements(shape, closed=(False, False), repeated=(False, False)):
    """Return the nodes (n, 9) of the Q2 elements on ``shape`` = (ny, nx) nodes, in VTK's order.

    Elements beyond the last nodes are left out unless the direction is ``closed`` or ``repeated``.
    """
    node = numbers(shape, repeated)
    ny, nx = node.shape
    n1, n2 = (n // 2 if wrap else (n - 1) // 2 for n, wrap in zip((nx, ny), closed))
    j, i = (2 * index.ravel() for index in np.mgrid[:n2, :n1])
    nodes = np.stack([node[(j + up) % ny, (i + along) % nx]
                      for up in range(3) for along in range(3)], axis=1)
    return nodes[:, VTK_NODES]


def numbers(shape, repeated):
    """Return the numbers (ny, nx) of nodes, one row or column larger where nodes are repeated.

    The repeated nodes have the last numbers, row by row.
    """
    ny, nx = shape
    found = np.full((ny + int(repeated[1]), nx + int(repeated[0])), -1)
    found[:ny, :nx] = np.arange(ny * nx).reshape(shape)
    found[found < 0] = np.arange(ny * nx, found.size)
    return found
