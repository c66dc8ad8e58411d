"""Strain operators of the plane, of rotational symmetry and of space; numpy only.

For the velocities v_c and the coordinates x_k, the components of the strain rate are

    D_m = sum_ck E[m, c, k] d v_c/d x_k + sum_c H[m, c] v_c/r

in Mandel notation: off-diagonal components are multiplied by sqrt 2, so that a:b = sum_m a_m b_m.
The spin w of a pair of directions i < j is (d v_j/d x_i - d v_i/d x_j)/2, which turns i towards j.
With rotational symmetry it is relative to the basis e_r, e_z, e_t, which turns with the material.
"""

import numpy as np

ROOT = np.sqrt(2.0)
#: Fields that are symmetric tensors.
TENSORS = "deviator", "stress_tensor", "strain_rate_tensor", "strain_tensor"


class Kinematics:
    """The strain operator of a flow.

    Parameters
    ----------
    name : str
    directions : str
        One letter per direction of the tensors, coordinates first.
    dim : int
        Number of coordinates.
    components : sequence of (int, int)
        Directions of the components of symmetric tensors, diagonal ones first.
    velocities : int
        Number of velocity components.
    axisymmetric : bool
        Whether the coordinates are r and z; integrals then have the weight r.

    Attributes
    ----------
    axes : tuple of str
        Names of the coordinates in mathematical notation.
    labels : tuple of str
        Names of the components.
    diagonal : ndarray, (m,)
        1 for diagonal components and 0 for others, which is also the trace operator.
    normal : list of int
        The diagonal components.
    pairs : list of (int, int)
        Directions of the off-diagonal components.
    terms : list of dict
        For each velocity, {m: (k, E[m, c, k], H[m, c])}. No component has two derivatives of one
        velocity.
    slots : int
        Number of the derivatives along reference directions, plus one for v/r.
    volume_unit : str
        Unit of volume, in the plane per unit depth.
    circumference : float
        The factor of integrals, which have the weight r: 2 pi with rotational symmetry, or 1.
    turning : tuple of (int, int, int, float)
        The terms (c, a, b, sign) of the acceleration a_c = sign v_a v_b/r of the turning basis.
    """

    def __init__(self, name, directions, dim, components, velocities, axisymmetric=False):
        self.name, self.directions, self.dim = name, directions, dim
        self.components, self.velocities = tuple(components), velocities
        self.axisymmetric, self.slots = axisymmetric, dim + axisymmetric
        self.circumference = 2.0 * np.pi if axisymmetric else 1.0
        self.volume_unit = "d^3" if axisymmetric or dim == 3 else "d^2"
        self.axes = tuple(name if name.isalpha() else f"x_{name}" for name in directions[:dim])
        self.labels = tuple(directions[i] + directions[j] for i, j in components)
        self.diagonal = np.array([float(i == j) for i, j in components])
        self.turning = ((0, 2, 2, -1.0), (2, 0, 2, 1.0)) if axisymmetric and velocities == 3 else ()
        self.normal = [m for m, (i, j) in enumerate(components) if i == j]
        self.pairs = [(i, j) for i, j in components if i != j]
        self._factor = np.where(self.diagonal > 0.0, 1.0, ROOT)
        self.terms = [{m: self._term(c, i, j) for m, (i, j) in enumerate(components)
                       if any(self._term(c, i, j)[1:])} for c in range(velocities)]

    def _term(self, c, i, j):
        """The derivative and the coefficients of velocity ``c`` in the component (i, j)."""
        if i == j:
            return c, float(c == i < self.dim), float(self.axisymmetric and c == 0 and i == 2)
        other = {i: j, j: i}.get(c, self.dim)
        hoop = self.axisymmetric and c == 2 and {i, j} == {0, 2}
        return other, (other < self.dim) / ROOT, -hoop / ROOT

    def __len__(self):
        return len(self.components)

    def sizes(self):
        """Return the shapes of the components of fields that have any, {name: (int,)}."""
        vectors = {"coordinates": self.dim, "velocity": self.velocities}
        return {name: (n,) for name, n in {**vectors, **dict.fromkeys(TENSORS, len(self))}.items()}

    def operators(self, inverse, over_r=None):
        """Return the operators S of the velocities c, a list of {m: (factor, array)}.

        S[c][m] is the product of the factor and the array (slots, points, n). D_m is the sum over c
        and slots of S[c][m] times the derivatives along the reference directions and, in the last
        slot, the value of v_c. ``inverse`` (dim, dim, points, n) is d xi_s/d x_k, and ``over_r``
        (points, n) is 1/r.
        """
        if not self.axisymmetric:
            return [{m: (slope, inverse[k]) for m, (k, slope, _) in terms.items()}
                    for terms in self.terms]
        return [{m: (1.0, np.concatenate([slope * inverse[k % self.dim], hoop * over_r[None]]))
                 for m, (k, slope, hoop) in terms.items()} for terms in self.terms]

    def strain_rate(self, gradients, over_r=None):
        """Return D (m, ...) of ``gradients[c][k]`` and, with rotational symmetry, v_c/r."""
        found = [None] * len(self)
        for c, terms in enumerate(self.terms):
            for m, (k, slope, hoop) in terms.items():
                parts = [slope * gradients[c][k]] if slope else []
                parts += [hoop * over_r[c]] if hoop else []
                for part in parts:
                    found[m] = part if found[m] is None else found[m] + part
        return np.array(found)

    def spin(self, gradients, over_r=None):
        """Return the spin w (pairs, ...) of the arguments of `strain_rate`."""
        found = np.zeros((len(self.pairs), *np.shape(gradients[0][0])))
        for spin, (i, j) in zip(found, self.pairs):
            for sign, c, k in (0.5, j, i), (-0.5, i, j):
                if c < self.velocities and k < self.dim:
                    spin += sign * gradients[c][k]
            if self.axisymmetric and (i, j) == (0, 2) and self.velocities == 3:
                spin -= 0.5 * over_r[2]
        return found

    def deformation_gradient(self, gradients, over_r=None):
        """Return F (d, d, ...) of d x_c/d X_k (dim, dim, ...) and, with symmetry, x_c/R."""
        d, shape = len(self.directions), np.shape(gradients)[2:]
        F = np.zeros((d, d, *shape))
        F[range(d), range(d)] = 1.0
        F[:self.dim, :self.dim] = gradients
        if self.axisymmetric:
            F[2, 2] = over_r[0]
        return F

    def tensor(self, mandel):
        """Return tensor components (m, ...) of Mandel components."""
        return mandel / self._shaped(mandel)

    def mandel(self, tensor):
        """Return Mandel components (m, ...) of tensor components."""
        return tensor * self._shaped(tensor)

    def _shaped(self, values):
        return self._factor.reshape((-1,) + (1,) * (np.ndim(values) - 1))

    def matrix(self, mandel):
        """Return symmetric matrices (d, d, ...) of Mandel components (m, ...)."""
        found = np.zeros((len(self.directions),) * 2 + mandel.shape[1:])
        for (i, j), values in zip(self.components, self.tensor(mandel)):
            found[i, j] = found[j, i] = values
        return found

    def of_matrix(self, matrix):
        """Return the Mandel components (m, ...) of symmetric matrices (d, d, ...)."""
        return self.mandel(np.array([matrix[i, j] for i, j in self.components]))

    def rotate(self, stress, angles):
        """Return Mandel components (m, ...) rotated by angles (pairs, ...), rad.

        The rotation matrix is exp(K), with the skew matrix K of the angles (Rodrigues).
        """
        size, d = np.sqrt((angles**2).sum(axis=0)), len(self.directions)
        K = np.zeros((d, d, *size.shape))
        for (i, j), angle in zip(self.pairs, angles):
            K[j, i], K[i, j] = angle, -angle
        R = (np.eye(d).reshape((d, d) + (1,) * size.ndim) + np.sinc(size / np.pi) * K
             + 0.5 * np.sinc(0.5 * size / np.pi)**2 * np.einsum("ik...,kj...->ij...", K, K))
        half = np.einsum("ik...,kl...->il...", R, self.matrix(stress))
        return self.of_matrix(np.einsum("il...,jl...->ij...", half, R))


_PLANE, _SPACE = ((0, 0), (1, 1)), ((0, 0), (1, 1), (2, 2))
_SHEARS = (0, 1), (0, 2), (1, 2)
PLANE = Kinematics("plane", "12", 2, (*_PLANE, (0, 1)), 2)
#: Velocity v3(x1, x2) as well.
OUT_OF_PLANE = Kinematics("out_of_plane", "123", 2, (*_PLANE, *_SHEARS), 3)
#: Directions r, z and t, without rotation.
AXISYMMETRIC = Kinematics("axisymmetric", "rzt", 2, (*_SPACE, (0, 1)), 2, True)
#: The same with rotation about the axis.
SWIRL = Kinematics("swirl", "rzt", 2, (*_SPACE, *_SHEARS), 3, True)
SOLID = Kinematics("solid", "123", 3, (*_SPACE, *_SHEARS), 3)
