"""Q2 and Q1 shape functions, quadrature and mapped elements in two or three dimensions.

Nodes and Gauss points of an element are counted with x1 fastest, for example a = 3 j + i, and its
corners likewise. Fields at Gauss points are arrays (points, n): point first, element last, so that
one matrix product with a table evaluates all elements.
"""

from functools import cached_property, lru_cache, reduce
from operator import add
from typing import NamedTuple

import numpy as np

GAUSS_1D = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
WEIGHTS_1D = np.array([5.0, 8.0, 5.0]) / 9.0
#: The axis across each side and its reference coordinate there. The side opposite to number f is
#: number f ^ 1.
SIDES = {"left": (0, -1), "right": (0, 1), "bottom": (1, -1), "top": (1, 1), "back": (2, -1),
         "front": (2, 1)}


def sum_arrays(arrays):
    """Return the sum of arrays; unlike `sum` it adds no zero."""
    return reduce(add, arrays)


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


def _tensor(*factors):
    """The tensor product of functions of x1, x2, ..., (points, functions), with x1 fastest."""
    return reduce(lambda inner, outer: np.kron(outer, inner), factors)


class Rule(NamedTuple):
    """Shape functions at points of an element, and quadrature weights."""

    shape: np.ndarray  #: Q2 functions, (points, nodes).
    slope: np.ndarray  #: Their reference derivatives, (directions, points, nodes).
    corner_shape: np.ndarray  #: Q1 functions, (points, corners).
    weights: np.ndarray  #: (points,).
    from_gauss: np.ndarray = None  #: Interpolation from the Gauss points, (points, Gauss points).


class Element:
    """The tables of the element with ``dim`` dimensions.

    Attributes
    ----------
    nodes, points, corners : int
        Numbers of Q2 nodes, Gauss points and corners.
    offsets, corner_offsets : ndarray, (dim, nodes) and (dim, corners)
        Position of the nodes and corners in the element along each axis.
    sides : dict
        {side: (axis, end)} as in `SIDES`.
    side_nodes : dict
        The nodes of each side, {side: (nodes,)}.
    shape, slope, corner_shape, weights : ndarray
        The `Rule` of the Gauss points.
    """

    def __init__(self, dim):
        self.dim, self.nodes, self.points, self.corners = dim, 3**dim, 3**dim, 2**dim
        self.offsets, self.corner_offsets = (
            np.indices((size,) * dim).reshape(dim, -1)[::-1] for size in (3, 2))
        self.sides = {side: (axis, end) for side, (axis, end) in SIDES.items() if axis < dim}
        self.side_nodes = {side: np.flatnonzero(self.offsets[axis] == 1 + end)
                           for side, (axis, end) in self.sides.items()}
        #: Values at the Q2 nodes of the polynomial through the Gauss points, (nodes, points).
        self.gauss_to_nodes = np.linalg.inv(_tensor(*[quadratic(GAUSS_1D)[0]] * dim))
        self.volume = self.rule([GAUSS_1D] * dim, [WEIGHTS_1D] * dim)
        self.shape, self.slope, self.corner_shape, self.weights, _ = self.volume
        #: Q1 functions at the Q2 nodes, (nodes, corners).
        self.corner_at_nodes = _tensor(*[linear([-1.0, 0.0, 1.0])] * dim)
        #: The rules of the Gauss points of the sides.
        self.side_rules = {side: self._across(axis, [float(end)], [1.0])
                           for side, (axis, end) in self.sides.items()}

    def rule(self, points, weights):
        """Return the `Rule` of points (n,) and weights (n,) along each axis."""
        functions, along = [quadratic(x) for x in points], range(self.dim)
        shape = _tensor(*(values for values, _ in functions))
        slope = [_tensor(*(functions[k][k == r] for k in along)) for r in along]
        return Rule(shape, np.array(slope), _tensor(*map(linear, points)),
                    _tensor(*(part[None] for part in weights)).ravel(),
                    shape @ self.gauss_to_nodes)

    def _across(self, axis, points, weights):
        """The `Rule` with ``points`` (n,) across ``axis``, and Gauss points along the others."""
        positions, factors = [GAUSS_1D] * self.dim, [WEIGHTS_1D] * self.dim
        positions[axis], factors[axis] = points, np.asarray(weights)
        return self.rule(positions, factors)

    @cached_property
    def surface_rules(self):
        """The rules of the fluidity source in the first layers of elements below each free surface.

        In the layer that touches it the source is singular: three Gauss points in the root s of the
        distance 2 s^2 are exact for powers -1 to 4 of s. Behind it three Gauss points leave an
        error that falls with the sixth power of the distance, and six points do not.
        """
        s, six, found = (1.0 + GAUSS_1D) / 2.0, np.polynomial.legendre.leggauss(6), {}
        for side, (axis, end) in self.sides.items():
            root = self._across(axis, end * (1.0 - 2.0 * s**2), 2.0 * s * WEIGHTS_1D)
            found[side] = [root] + 3 * [self._across(axis, *six)]
        return found

    @cached_property
    def _all_slopes(self):
        """Reference derivatives at Gauss points and corners."""
        corners = self.rule([np.array([-1.0, 1.0])] * self.dim, [np.ones(2)] * self.dim)
        return np.concatenate([self.slope, corners.slope], axis=1)

    def least_determinant(self, x):
        """Return the minimum (n,) of the determinant over Gauss points and corners, d^dim."""
        return _cofactors(_jacobian(self._all_slopes, x))[1].min(axis=0)


#: The `Element` of a number of dimensions.
element = lru_cache(Element)


@lru_cache
def table(dim, left, right):
    """Return the products of two sets of functions, (pairs of functions, factors).

    An entry of an element matrix is a sum over Gauss points and directions of a factor of the
    element times a product of functions. With this table, all entries of all elements are one
    matrix product with the factors. ``left`` and ``right`` are value, slope, corner, or slot: the
    derivatives followed by the value.
    """
    e = element(dim)
    sets = {"value": e.shape[None], "slope": e.slope, "corner": e.corner_shape[None],
            "slot": np.concatenate([e.slope, e.shape[None]])}
    product = np.einsum("rqa,sqb->abrsq", sets[left], sets[right])
    return product.reshape(product.shape[0] * product.shape[1], -1)


def _jacobian(slope, x):
    """The derivatives [i][r] = d x_i/d xi_r (points, n) of a map of nodes ``x`` (dim, nodes, n)."""
    return [[along @ part for along in slope] for part in x]


def _cofactors(jacobian):
    """The cofactors [i][r] = det d xi_r/d x_i of a Jacobian, and its determinant."""
    if len(jacobian) == 2:
        (x_1, x_2), (y_1, y_2) = jacobian
        found = np.array([[y_2, -y_1], [-x_2, x_1]])
    else:
        x, y, z = (np.array(row) for row in jacobian)
        found = np.array([np.cross(a, b, axis=0) for a, b in ((y, z), (z, x), (x, y))])
    return found, sum(a * b for a, b in zip(jacobian[0], found[0]))


class Geometry:
    """The map of elements with nodes ``x`` (dim, nodes, n), d, at the points of a `Rule`.

    ``inverse`` (dim, dim, points, n) is d xi_r/d x_k, 1/d, with r second, and ``weight`` (points,
    n) is the quadrature weight times the determinant, d^dim. If axisymmetric, the weight contains
    the radius x_1 as well, and ``over_r`` (points, n) is its inverse. All are NaN in inverted
    elements, which a solver treats as a failed evaluation.
    """

    over_r = None

    def __init__(self, x, rule=None, axisymmetric=False):
        self.rule = rule = rule or element(len(x)).volume
        found, det = _cofactors(_jacobian(rule.slope, x))
        det[~(det > 0.0)] = np.nan
        self.inverse = found / det
        self.weight = rule.weights[:, None] * det
        if axisymmetric:
            r = rule.shape @ x[0]
            self.over_r = 1.0 / r
            self.weight *= r

    def __getitem__(self, batch):
        """Return the geometry of a slice or of the numbers of elements."""
        part = Geometry.__new__(Geometry)
        part.rule, part.inverse = self.rule, self.inverse[..., batch]
        part.weight = self.weight[:, batch]
        part.over_r = None if self.over_r is None else self.over_r[:, batch]
        return part

    def gradient(self, nodal):
        """Return the gradient (dim, points, n) of a Q2 field ``nodal`` (nodes, n)."""
        return sum_arrays(self.inverse[:, r] * (slope @ nodal)
                     for r, slope in enumerate(self.rule.slope))

    def pull_back(self, flux):
        """Return weight * sum_k (d xi_r/d x_k) flux_k of ``flux``, both (dim, points, n)."""
        return self.weight * sum_arrays(inverse * part for inverse, part in zip(self.inverse, flux))

    def area(self, side):
        """Return the outward normals times area (dim, points, n) at the points of a side's rule."""
        axis, end = SIDES[side]
        return end * self.weight * self.inverse[:, axis]
