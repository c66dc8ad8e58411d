"""Finite volumes for the two scalar equations of a turning cell with gravity.

With codirectional stress, v = r w(r, z) e_t and hydrostatic P = top + H - z, steady flow obeys

    div(r^3 (P/g) grad w) = 0,      A^2 (1/r) div(r grad g) = F,      mu = r |grad w|/g

for Bingham's law, with a smooth floor and without flux of g.
"""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu


class Cell:
    """An annular cell, nr x nz volumes; the unknowns are w and g at their centres."""

    def __init__(self, parameters, nr, nz):
        p = self.p = parameters
        self.shape = nr, nz
        self.dr, self.dz = (p.outer_radius - p.inner_radius) / nr, p.height / nz
        self.faces = p.inner_radius + self.dr * np.arange(nr + 1)[:, None]
        self.r = 0.5 * (self.faces[1:] + self.faces[:-1])
        self.P = p.top_pressure + p.height - self.dz * (np.arange(nz) + 0.5)

    def source(self, rate, g):
        """Return F of steady or dynamic NGF."""
        p, s = self.p, np.sqrt(self.P) / self.p.inertial_number
        if p.model == "ngf_primitive":
            return p.mu_s * g - rate + p.b * rate * g / s
        above = rate / g - p.mu_s
        return np.abs(above) * (g - s * np.maximum(above, 0.0) / (p.b * rate / g))

    def residual(self, unknowns):
        w, g = unknowns.reshape(2, *self.shape)
        half, r = 0.5 * self.dr, self.r
        at_faces = np.concatenate([g[:1], 0.5 * (g[1:] + g[:-1]), g[-1:]])
        across = np.concatenate([
            (w[:1] - 1.0) / half, np.diff(w, axis=0) / self.dr, -w[-1:] / half])
        up = np.diff(w, axis=1) / self.dz
        viscosity = 0.5 * (self.P[1:] + self.P[:-1]) / (0.5 * (g[:, 1:] + g[:, :-1]))
        balance = self.divergence(self.faces**3 * self.P / at_faces * across, r**3 * viscosity * up)
        flux = np.pad(np.diff(g, axis=0) / self.dr, ((1, 1), (0, 0))) * self.faces
        diffusion = self.divergence(flux, r * np.diff(g, axis=1) / self.dz) / r
        ends = np.pad(up, ((0, 0), (1, 1)))
        rate = r * np.hypot(0.5 * (across[1:] + across[:-1]), 0.5 * (ends[:, 1:] + ends[:, :-1]))
        return np.array([balance / self.faces[0]**3,
                         self.source(rate, g) - self.p.A**2 * diffusion]).ravel()

    def divergence(self, across, up):
        return np.diff(across, axis=0) / self.dr + np.diff(
            np.pad(up, ((0, 0), (1, 1))), axis=1) / self.dz

    def jacobian(self, unknowns, residual):
        """Return the matrix of forward differences, nine colours per unknown."""
        n, (nr, nz) = unknowns.size // 2, self.shape
        i, j = np.divmod(np.arange(n), nz)
        rows, columns, values = [], [], []
        for first in (0, n):
            for colour in range(9):
                chosen = np.flatnonzero(i % 3 * 3 + j % 3 == colour)
                change = np.zeros(2 * n)
                change[first + chosen] = 1e-7 * np.maximum(np.abs(unknowns[first + chosen]), 1e-10)
                slope = self.residual(unknowns + change) - residual
                for di, dj in np.ndindex(3, 3):
                    a, b = i[chosen] + di - 1, j[chosen] + dj - 1
                    inside = (0 <= a) & (a < nr) & (0 <= b) & (b < nz)
                    column = first + chosen[inside]
                    for row in (0, n):
                        rows.append(row + (a * nz + b)[inside])
                        columns.append(column)
                        values.append(slope[rows[-1]] / change[column])
        return csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                          (2 * n, 2 * n))

    def solve(self):
        """Return w and g by Newton's method, from a Newtonian flow with mu = 0.9 mu_s."""
        ratio = (self.p.outer_radius / self.r)**2 + np.zeros(self.shape)
        scale = (self.p.outer_radius / self.p.inner_radius)**2 - 1.0
        unknowns = np.array([
            (ratio - 1.0) / scale, 2.0 * ratio / scale / (0.9 * self.p.mu_s)]).ravel()
        for _ in range(40):
            residual = self.residual(unknowns)
            size, step = np.linalg.norm(residual), 1.0
            if size < 1e-8:
                return unknowns.reshape(2, *self.shape)
            change = splu(self.jacobian(unknowns, residual)).solve(-residual)
            while step > 1e-4 and not np.linalg.norm(
                    self.residual(unknowns + step * change)) < size:
                step /= 2.0
            unknowns = unknowns + step * change
        raise AssertionError(f"the residual is {size:.1e}")

    def on_top(self, radii):
        """Return the velocity v_t (n,) on the top at radii (n,)."""
        w = self.solve()[0]
        top = 1.5 * w[:, -1] - 0.5 * w[:, -2]
        r = np.concatenate([self.faces[:1, 0], self.r[:, 0], self.faces[-1:, 0]])
        return radii * CubicSpline(r, [1.0, *top, 0.0])(radii)
