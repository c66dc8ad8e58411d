"""Flows on fixed meshes: their equations, references, time and walls.

Every test that starts no run runs unchanged on any number of ranks.
"""

import numpy as np
import pytest
from conftest import discretised, noise
from mpi4py import MPI

from pgran.output.results import write_once

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


def test_the_inertial_number_has_a_value_where_the_pressure_vanishes():
    form = discretised(case="inclined_plane", law="jop", mu_2=6, **COARSE["inclined_plane"])
    local, increment = disturbed(form, 0.0)
    pressure = form.grid.split(local)[2]
    pressure -= 0.5 + 1e-9  # negative by rounding at the free surface
    fields, owned = form.nodal_fields(local, increment), form.grid.nodes.owned
    I, P = fields["inertial_number"][owned], fields["pressure"][owned]
    assert COMM.allreduce(P.min(initial=1.0), MPI.MIN) < 0.0
    assert np.isfinite(I).all()
    inside = P > 0.1
    np.testing.assert_allclose(I[inside], (
        fields["fluidity"] * fields["stress_ratio"])[owned][inside] / form.material.inverse_time(
            P[inside]))


def test_a_field_that_is_not_a_number_is_written_but_told_with_its_place(tmp_path, capsys):
    form = discretised(element_size=20)
    nodes = form.grid.nodes
    field = np.where((nodes.i == 2) & (nodes.j == 1), np.nan, 1.0)
    fields = {"coordinates": form.case.coordinates(nodes.i, nodes.j), "speed": field}
    write_once(COMM.bcast(tmp_path) / "mode.h5", form, fields)
    told = COMM.bcast(capsys.readouterr().err)
    assert "snapshot 0000: speed is not a number at 1 nodes, the first at x = (20, 10) d" in told
