"""Flows on fixed meshes: their equations, references, time and walls.

Every test that starts no run runs unchanged on any number of ranks.
"""

import numpy as np
import pytest
from conftest import discretised, noise
from mpi4py import MPI

COMM = MPI.COMM_WORLD
#: A coarse mesh of each flow.
COARSE = {
    "planar_shear": {"height": 8, "gravity": 0.05, "element_size": 1, "grading": 1.5},
    "vertical_chute": {"width": 8, "gravity": 0.15, "element_size": 1},
    "annular_shear": {"inner_radius": 3, "outer_radius": 6, "element_size": 1},
    "inclined_plane": {"height": 8, "slope": 24, "element_size": 1, "grading": 2}}


def disturbed(form, size=0.02):
    """Unknowns (n_local,) near the reference flow, and the increment of an elastic step there."""
    grid, case = form.grid, form.case
    x = case.coordinates(grid.nodes.i, grid.nodes.j)
    corners = x[:, grid.nodes.index(2 * grid.corners.i, 2 * grid.corners.j)]
    velocity, fluidity, _ = case.reference(x)
    local = grid.join(velocity, fluidity, case.reference(corners)[2] + 0.5)
    increment = form.increment(x, form.no_stress() + 0.02, 0.1, 0.0)
    return local * (1.0 + size * noise(grid, 3)), increment


@pytest.mark.parametrize("wall", ["natural", "zero", "local"])
@pytest.mark.parametrize("case", COARSE)
def test_jacobian_with_walls_and_convection_is_the_derivative_of_the_residual(case, wall):
    form = discretised(case=case, wall_fluidity=wall, inertia=True, law="jop", mu_2=6,
                       **COARSE[case])
    grid = form.grid
    local, increment = disturbed(form)
    shift, change = 7.0, noise(grid, 11)
    matrix, given, product = form.create_matrix(), grid.create_vector(), grid.create_vector()
    form.jacobian(local, shift, increment, matrix)
    grid.from_local(change, given)
    matrix.mult(given, product)
    size = 1e-6
    ends = [form.residual(local + h * change, h * shift * change, increment)
            for h in (size, -size)]
    # Prescribed values do not change with the unknowns: their rows are those of the identity.
    difference = (ends[0] - ends[1]) / (2.0 * size)
    scale = COMM.allreduce(np.abs(difference).max(), MPI.MAX)
    assert scale > 1.0
    np.testing.assert_allclose(product.array_r, difference, atol=1e-6 * scale)
