"""Q2 and Q1 shape functions, quadrature and mapped quadrilaterals.

Nodes and Gauss points of an element are counted with x1 fastest: a = 3 j + i for Q2 nodes and Gauss
points, a = 2 j + i for corners. Fields at Gauss points are arrays (`POINTS`, n): point first,
element last, so that one matrix product with a table evaluates all elements.
"""

from typing import NamedTuple

import numpy as np

#: Dimensions of space.
DIM = 2
#: Q2 nodes, Gauss points and corners of an element.
NODES, POINTS, CORNERS = 3**DIM, 3**DIM, 2**DIM

GAUSS_1D = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
WEIGHTS_1D = np.array([5.0, 8.0, 5.0]) / 9.0
#: Q2 nodes of each side, in the order that keeps the element on the left.
SIDE_NODES = {"bottom": (0, 1, 2), "right": (2, 5, 8), "top": (8, 7, 6), "left": (6, 3, 0)}


def quadratic(x):
    """Return the three quadratic Lagrange functions at ``x`` (n,) and their slopes, (n, 3) each."""
    x = np.asarray(x)[:, None]
    values = np.hstack([x * (x - 1.0) / 2.0, 1.0 - x**2, x * (x + 1.0) / 2.0])
    slopes = np.hstack([x - 0.5, -2.0 * x, x + 0.5])
    return values, slopes


def linear(x):
    """Return the two linear Lagrange functions at ``x`` (n,), (n, 2)."""
    x = np.asarray(x)[:, None]
    return np.hstack([1.0 - x, 1.0 + x]) / 2.0


def _tensor(second, first):
    """Tensor product of functions of x2 and of x1, with x1 fastest in points and nodes."""
    return np.einsum("qb,pa->qpba", second, first).reshape(
        len(second) * len(first), second.shape[1] * first.shape[1])


class Rule(NamedTuple):
    """Shape functions at points of an element, and quadrature weights."""

    shape: np.ndarray  #: Q2 functions, (points, nodes).
    slope: np.ndarray  #: Their reference derivatives, (directions, points, nodes).
    corner_shape: np.ndarray  #: Q1 functions, (points, corners).
    weights: np.ndarray  #: (points,).

    @property
    def from_gauss(self):
        """Interpolation from the Gauss points, (points, Gauss points)."""
        return self.shape @ GAUSS_TO_NODES


def _rule(first, second, weights):
    """The `Rule` of the points ``first`` along x1 and ``second`` along x2."""
    (n_1, d_1), (n_2, d_2) = quadratic(first), quadratic(second)
    return Rule(_tensor(n_2, n_1), np.array([_tensor(n_2, d_1), _tensor(d_2, n_1)]),
                _tensor(linear(second), linear(first)), np.outer(*weights[::-1]).ravel())


#: The Gauss points of the volume.
VOLUME = _rule(GAUSS_1D, GAUSS_1D, (WEIGHTS_1D, WEIGHTS_1D))
SHAPE, SHAPE_SLOPE, CORNER_SHAPE, WEIGHTS = VOLUME
#: Q1 shape functions at the Q2 nodes, (nodes, corners).
CORNER_AT_NODES = _tensor(linear([-1.0, 0.0, 1.0]), linear([-1.0, 0.0, 1.0]))
#: Reference derivatives of the Q2 functions at Gauss points and corners.
_ALL_SLOPES = np.concatenate([SHAPE_SLOPE, _rule([-1.0, 1.0], [-1.0, 1.0], np.ones((2, 2))).slope],
                             axis=1)
#: Values at the Q2 nodes of the biquadratic through the Gauss points, (nodes, points).
GAUSS_TO_NODES = np.linalg.inv(SHAPE)
#: Shape functions and slopes of a side at its three Gauss points, (3 points, 3 nodes).
SIDE_SHAPE, SIDE_SLOPE = quadratic(GAUSS_1D)


def _across(axis, points, weights):
    """The `Rule` with ``points`` (n,) across ``axis``, and Gauss points along the other one."""
    positions, factors = [GAUSS_1D, GAUSS_1D], [WEIGHTS_1D, WEIGHTS_1D]
    positions[axis], factors[axis] = points, weights
    return _rule(*positions, factors)


#: The reference direction across each side, and its value there.
ENDS = {"bottom": (1, -1.0), "top": (1, 1.0), "left": (0, -1.0), "right": (0, 1.0)}
#: The Gauss points of each side.
SIDES = {side: _across(axis, [end], [1.0]) for side, (axis, end) in ENDS.items()}


def _root_rule(side):
    """The `Rule` for functions of the root of the distance, 2 s^2, to a side.

    Three Gauss points in s are exact for powers -1 to 4 of the root.
    """
    (axis, end), s = ENDS[side], (1.0 + GAUSS_1D) / 2.0
    return _across(axis, end * (1.0 - 2.0 * s**2), 2.0 * s * WEIGHTS_1D)


#: The rules of the fluidity source in the first layers of elements below a free surface. In the
#: layer that touches it the source is singular. Behind it three Gauss points leave an error that
#: falls with the sixth power of the distance, and six points do not.
SURFACES = {side: [_root_rule(side)] + 3 * [
    _across(axis, *np.polynomial.legendre.leggauss(6))] for side, (axis, _) in ENDS.items()}


def _map(slope, x):
    """The derivatives [[d x1/d xi_1, d x1/d xi_2], ...] and the determinant of the map."""
    (x_1, x_2), (y_1, y_2) = ([slope[r] @ x[i] for r in range(DIM)] for i in range(DIM))
    return ((x_1, x_2), (y_1, y_2)), x_1 * y_2 - x_2 * y_1


class Geometry:
    """The map of quadrilaterals with nodes ``x`` (2, nodes, n), d, at the points of a `Rule`.

    ``inverse`` (2, 2, points, n) is d xi_r/d x_i, 1/d, with r second, and ``weight`` (points, n)
    is the quadrature weight times the determinant, d^2. Both are NaN in inverted elements, which a
    solver treats as a failed evaluation.
    """

    def __init__(self, x, rule=VOLUME):
        self.rule = rule
        ((x_1, x_2), (y_1, y_2)), det = _map(rule.slope, x)
        det[~(det > 0.0)] = np.nan
        self.inverse = np.array([[y_2, -y_1], [-x_2, x_1]]) / det
        self.weight = rule.weights[:, None] * det

    def __getitem__(self, batch):
        """Return the geometry of a slice of the elements."""
        part = Geometry.__new__(Geometry)
        part.rule = self.rule
        part.inverse, part.weight = self.inverse[..., batch], self.weight[:, batch]
        return part

    def gradient(self, nodal):
        """Return the gradient (2, points, n) of a Q2 field ``nodal`` (nodes, n)."""
        slope = self.rule.slope.reshape(-1, NODES) @ nodal
        slope = slope.reshape(DIM, len(self.rule.shape), -1)
        return self.inverse[:, 0] * slope[0] + self.inverse[:, 1] * slope[1]

    def pull_back(self, flux):
        """Return weight * sum_i (d xi_r/d x_i) flux_i of ``flux``, both (2, points, n)."""
        return self.weight * (self.inverse[0] * flux[0] + self.inverse[1] * flux[1])


def least_determinant(x):
    """Return the minimum (n,) of the determinant over Gauss points and corners, d^2."""
    return _map(_ALL_SLOPES, x)[1].min(axis=0)


def side_force(x, traction):
    """Return the nodal forces (2, 3, n) of a traction on the sides of n elements, stress times d.

    ``x`` (2, 3, n) are the nodes of the sides, d, in the order of `SIDE_NODES`, and
    ``traction(x, area)`` the force (2, 3, n) on pieces of the sides at points (2, 3, n), whose
    outward normals times length are ``area`` (2, 3, n).
    """
    tangent = np.einsum("qa,ian->iqn", SIDE_SLOPE, x)
    force = traction(np.einsum("qa,ian->iqn", SIDE_SHAPE, x),
                     np.array([tangent[1], -tangent[0]]))
    return np.einsum("q,qa,iqn->ian", WEIGHTS_1D, SIDE_SHAPE, force)


def _table(left, right, pattern):
    """Products of shape functions: a row per pair of nodes, a column per factor."""
    product = np.einsum(pattern, left, right)
    return np.ascontiguousarray(product.reshape(product.shape[0] * product.shape[1], -1))


# An entry of an element matrix is a sum over Gauss points q and directions r, s of a factor of the
# element times a product of shape functions. With tables of these products, all entries of all
# elements are matrix products (pairs, factors) @ (factors, elements).
SLOPE_SLOPE = _table(SHAPE_SLOPE, SHAPE_SLOPE, "rqa,sqb->abrsq")
SLOPE_VALUE = _table(SHAPE_SLOPE, SHAPE, "rqa,qb->abrq")
VALUE_SLOPE = _table(SHAPE, SHAPE_SLOPE, "qa,sqb->absq")
VALUE_VALUE = _table(SHAPE, SHAPE, "qa,qb->abq")
SLOPE_CORNER = _table(SHAPE_SLOPE, CORNER_SHAPE, "rqa,qb->abrq")
CORNER_SLOPE = _table(CORNER_SHAPE, SHAPE_SLOPE, "qa,sqb->absq")
VALUE_CORNER = _table(SHAPE, CORNER_SHAPE, "qa,qb->abq")
CORNER_CORNER = _table(CORNER_SHAPE, CORNER_SHAPE, "qa,qb->abq")
