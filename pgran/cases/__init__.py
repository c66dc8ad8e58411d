"""Cases: domain, boundary conditions, start and imperfection; a new case is one new file.

A case is a class named ``Case`` in a module of this package, named as in
``-pgran_case``; what it leaves out comes from `BaseCase`.
"""

import importlib

import numpy as np


class BaseCase:
    """A homogeneous material in free space; the seam between a problem and the solver.

    Attributes: ``shape`` = (nx, ny) elements; ``periodic`` = two bools;
    ``base_gradient`` (2, 2), a velocity gradient that is added to that of the
    nodal velocity, gdot0; ``side_stresses`` = {side: normal stress}, |sigma_1|,
    which follows the deformed normal; ``plate``, the side whose mean normal
    stress is recorded, or None; ``body_force(x)`` returns b (2, ...) of (2.2) at points
    ``x`` (2, ...), |sigma_1|/d, and ``fluidity_source(x)`` a source (...) of the fluidity
    equation, for verification; both may be None, which costs nothing.

    Functions of global indices take integer arrays of one shape: ``i, j`` of Q2
    nodes (two an element), of corners or of elements. Times are in 1/gdot0.
    """

    periodic = False, False
    base_gradient = np.zeros((2, 2))
    side_stresses = {}
    plate = None
    body_force = fluidity_source = None

    def __init__(self, settings, material):
        self.settings, self.material = settings, material
        if any(settings.body_force) and self.body_force is None:
            self.body_force = lambda x: np.reshape(settings.body_force, (2,) + (1,) * (x.ndim - 1))

    def coordinates(self, i, j):
        """Return the initial coordinates (2, n) of nodes, d."""
        raise NotImplementedError

    def prescribed(self, time, i, j):
        """Return prescribed nodal velocities (2, n), not a number where free."""
        return np.full((2, i.size), np.nan)

    def prescribed_fluidity(self, time, i, j):
        """Return prescribed nodal fluidities (n,), not a number where free."""
        return np.full(i.size, np.nan)

    def prescribed_pressure(self, time, i, j):
        """Return prescribed corner pressures (n,), not a number where free."""
        return np.full(i.size, np.nan)

    def start(self, x):
        """Return the velocity (2, n) from which the run starts, at nodes ``x`` (2, n)."""
        return np.zeros_like(x)

    def start_pressure(self):
        """Return the pressure before loading, |sigma_1|."""
        return 1.0

    def yield_factor(self, i, j):
        """Return mu_s over its nominal value, (n,), for elements."""
        return np.ones(i.size)

    def compression(self, time):
        """Return 1 - h/H of homogeneous compression at |D2| = 1/2, by which runs are counted."""
        return 1.0 - np.exp(-0.5 * time)

    def time_at(self, compression):
        """Return the time at which `compression` is reached; its inverse."""
        return -2.0 * np.log(1.0 - compression)


def create(settings, material):
    """Return the case that ``-pgran_case`` names."""
    module = importlib.import_module(f"{__name__}.{settings.case}")
    return module.Case(settings, material)
