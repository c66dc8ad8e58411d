"""Coarser grids, preconditioners, and iterations independent of the mesh.

All tests without runs pass on any number of ranks.
"""

import json

import numpy as np
import pytest
from conftest import ROOT, discretised, pgran, refused, run_ranks
from mpi4py import MPI
from petsc4py import PETSc

from pgran.output.result import Result
from pgran.solve.state import rest
from pgran.space.coarse import CoarseCorrection
from pgran.space.galerkin import GalerkinMatrix, first_batches
from pgran.space.grid import indices
from pgran.space.multigrid import corner_level, node_level
from pgran.space.schur import INERTIAL, SchurPreconditioner


def interpolated(coarse, fine, values):
    """Values (n_owned,) of a coarse level, interpolated to ``fine``."""
    vector, found = coarse.vector(), fine.vector()
    vector.setArray(values)
    coarse.interpolation(fine).mult(vector, found)
    return found.array.copy()


@pytest.mark.parametrize("names", [["velocity", "fluidity"], ["fluidity"], ["pressure"]])
@pytest.mark.parametrize("options", [
    {"width": 6, "height": 12, "element_size": 0.5}, {"width": 9, "height": 7, "element_size": 1},
    {"case": "periodic", "cell_elements": 9}])
def test_interpolation_is_exact_for_free_unknowns_and_keeps_prescribed_ones(options, names):
    form = discretised(**options, inertia="true")
    fine = corner_level(form) if names == ["pressure"] else node_level(form, names)
    comm, curved = fine.comm.tompi4py(), fine.degree - 1  # Q2 interpolates quadratics exactly
    while fine.coarsenings:
        coarse, exact = fine.coarser(), []
        assert coarse.shape == tuple(-(-n // 2) for n in fine.shape)
        for level in fine, coarse:
            x, y = (at[index] / at[-1] for at, index in zip(level.at, indices(level.ranges)))
            values = (np.ones_like(x) if any(fine.periodic)
                      else 1.0 + x + 2.0 * y - x * y + curved * x**2 * y**2)
            values = values[:, None] + np.arange(level.dof)
            exact.append(np.where(level.held, 0.0, values.ravel()))
        # Where 1 is not reproduced, a prescribed unknown contributes zero.
        free = np.abs(interpolated(coarse, fine, np.where(coarse.held, 0.0, 1.0)) - 1.0) < 1e-12
        found = interpolated(coarse, fine, exact[1])
        assert not found[fine.held].any()
        if min(fine.shape) > 4 or not comm.allreduce(int(fine.held.sum())):
            np.testing.assert_allclose(found[free], exact[0][free], rtol=1e-12)
            assert comm.allreduce(int(free.sum())) > 0.5 * comm.allreduce(free.size)
        kept = np.repeat(np.logical_and(*(np.isin(index, nodes) for index, nodes in zip(
            indices(fine.ranges), coarse.kept))), fine.dof)
        np.testing.assert_array_equal(interpolated(coarse, fine, np.where(coarse.held, 1.0, 0.0)),
                                      np.where(fine.held & kept, 1.0, 0.0))
        fine = coarse


def test_interpolation_wraps_around_a_periodic_cell():
    """A tent at the first coarse node reaches fine nodes on both sides, across the wrap."""
    form = discretised(case="periodic", cell_elements=8, inertia="true")
    fine = node_level(form, ["velocity", "fluidity"])
    coarse = fine.coarser()
    i, j = indices(coarse.ranges)
    found = interpolated(coarse, fine, np.repeat(np.where((i == 0) & (j == 0), 1.0, 0.0), 3))
    # Corner functions of elements of four fine spacings; a period has 16 fine nodes.
    across = np.zeros(16)
    across[:4] = across[[0, -1, -2, -3]] = 1.0, 0.375, 0.0, -0.125
    i, j = indices(fine.ranges)
    expected = np.repeat(across[i] * across[j], 3)
    np.testing.assert_allclose(found, expected, atol=1e-15)
    assert fine.comm.tompi4py().allreduce(np.count_nonzero(found[np.repeat(i > 8, 3)])) > 10


@pytest.mark.parametrize("options", [
    {"width": 8, "height": 24, "element_size": 1}, {"width": 7, "height": 9, "element_size": 1},
    {"width": 8, "height": 24, "element_size": 1, "model": "li"},
    {"case": "periodic", "cell_elements": 6},
    {"case": "annular_shear", "inner_radius": 5, "outer_radius": 8, "element_size": 1}],
    ids=["specimen", "odd numbers", "no fluidity", "periodic", "ring"])
def test_the_galerkin_operator_is_the_product_of_matrices(options):
    form = discretised(**options)
    state, matrix = rest(form), form.create_matrix("nest")
    fine = node_level(form, ["velocity", "fluidity"][:form.grid.dof - 1])
    coarse = fine.coarser()
    nodes, ups, batches, chain = [fine, coarse, coarse.coarser()], [], first_batches(form), []
    for finer, joined in zip(nodes, nodes[1:]):
        part = GalerkinMatrix(finer, joined, batches, blocked=joined is coarse)
        chain.append((part, part.create()))
        ups.append(joined.interpolation(finer))
        batches = [part.elements()]
    chain[0][0].coarser = chain[1]
    increment = form.increment(state.x, state.stress, 0.5, 0.0)
    for size in (1.0, 1.1):  # the second one replaces the first
        form.jacobian(size * state.local, 1e3, increment, matrix, more=chain[:1])
        product = matrix.getNestSubMatrix(0, 0)
        for up, (_, operator) in zip(ups, chain):
            product = product.ptap(up)
            difference = operator.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
            difference.axpy(-1.0, product, structure=PETSc.Mat.Structure.DIFFERENT)
            maximum = PETSc.NormType.INFINITY
            assert difference.norm(maximum) < 1e-14 * product.norm(maximum)


def test_coarse_correction_solves_its_coarse_space_exactly():
    form = discretised(width=8, height=24, element_size=1)
    state, matrix = rest(form), form.create_matrix("nest")
    form.jacobian(state.local, 1e3, form.increment(state.x, state.stress, 0.5, 0.0), matrix)
    inner, outer = (PETSc.PC().create(comm=form.grid.comm) for _ in range(2))
    inner.setType("none")
    correction = CoarseCorrection(inner, PETSc.DMShell().create(comm=form.grid.comm), form)
    outer.setType("python")
    outer.setPythonContext(correction)
    outer.setOperators(matrix)
    outer.setUp()
    coarse, wanted = correction.interpolation.createVecs()
    right, found = matrix.createVecs()
    coarse.setRandom()
    correction.interpolation.mult(coarse, wanted)
    matrix.mult(wanted, right)
    outer.apply(right, found)
    found.axpy(-1.0, wanted)
    assert found.norm() < 1e-9 * wanted.norm()


def study(ranks, name, states, snapshot, size, *options):
    """The result of a study of the steps from a snapshot."""
    return json.loads(run_ranks(
        ranks, "-m", f"studies.{name}", "-options_file", ROOT / "options" / "biaxial.opts",
        "-from", states, "-snapshot", snapshot, "-pgran_element_size", size, "-ksp_rtol", 1e-6,
        *options).stdout)


@pytest.mark.nightly
def test_coarse_correction_reduces_the_iterations_of_a_large_specimen(tmp_path):
    """At L = 160 d, 25 instead of 40."""
    shape, path = ("-pgran_width", 160, "-pgran_height", 480), tmp_path / "states.h5"
    pgran(0, "biaxial.opts", path, *shape, "-pgran_element_size", 16, "-pgran_compression", 0.001,
          "-pgran_snapshots", 0.001)
    found = {}
    for file, ranks in (("biaxial", 2), ("large", 1), ("large", 2)):
        found[file, ranks], = study(
            ranks, "systems", path, 0, 4, "-options_file", ROOT / "options" / f"{file}.opts",
            *shape, "-dt", "3e-4", "-ksp_max_it", 100)
    assert found["large", 1] == found["large", 2] <= 27 < 35 < found["biaxial", 2], found


@pytest.mark.parametrize("options, depth", [
    *(({"width": width, "height": 3 * width, "element_size": 4}, depth)
      for width, depth in ((80, 1), (160, 2), (640, 4))),
    ({"case": "inclined_plane", "law": "jop", "grading": 2, "element_size": 0.25}, 2)])
def test_the_coarsest_grid_follows_the_mean_element_size_and_has_a_maximum_size(options, depth):
    assert node_level(discretised(**options), ["velocity", "fluidity"]).depth == depth


@pytest.mark.parametrize("options, message", [
    (("-pgran_element_size", 8, "-fieldsplit_0_pc_mg_levels", 6),
     "-pc_mg_levels: too many levels; a grid of one element cannot be coarsened"),
    (("-pgran_coarse_correction", "true", "-dm_mat_type", "aij"),
     "-pgran_coarse_correction true: requires -dm_mat_type nest")])
def test_unusable_options_of_multigrid_are_refused(tmp_path, options, message):
    done = pgran(2, "biaxial.opts", tmp_path / "x.h5", *options, limit=60, check=False)
    refused(done, message)


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """Snapshots before yielding, and before, during and after localisation."""
    path = tmp_path_factory.mktemp("states") / "states.h5"
    pgran(2, "biaxial.opts", path, "-pgran_compression", 0.03,
          "-pgran_snapshots", "0.0001,0.003,0.018,0.03")
    return path


@pytest.mark.parametrize("snapshot", [pytest.param(2, marks=pytest.mark.nightly), 3])
def test_iterations_do_not_grow_with_the_mesh_or_the_ranks(states, snapshot):
    found = {}
    for size, ranks in ((2, 1), (2, 3), (1, 2)):
        rows = study(ranks, "one_step", states, snapshot, size, "-dt", 2e-4)["newton"]
        found[size, ranks] = [row["iterations"] for row in rows]
    assert found[2, 1] == found[2, 3]
    maxima = [max(counts) for counts in found.values()]
    assert max(maxima) <= 28 and max(maxima) <= 1.15 * min(maxima), found  # 21 to 27 measured


@pytest.mark.parametrize("size, ranks", [(2, 3), pytest.param(1, 2, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("snapshot, steps", [(0, "1e-8,1e-6,1e-4"), (2, "1e-8,1e-6,1e-4,1e-3")])
def test_iterations_do_not_grow_with_inertia_at_any_step(states, snapshot, steps, size, ranks):
    counts = study(ranks, "systems", states, snapshot, size, "-pgran_inertia", "true",
                   "-dt", steps, "-ksp_max_it", 60)
    assert max(counts) <= 31, counts  # 13 to 29 measured


@pytest.mark.parametrize("case, more", [
    ("biaxial", {"width": 6, "height": 12, "element_size": 1}), ("periodic", {"cell_elements": 6})])
def test_the_inertial_laplacian_has_no_flux_at_walls_and_zero_pressure_at_free_faces(case, more):
    """The Laplacian of a constant is zero except at free faces and at a prescribed pressure."""
    form = discretised(case=case, inertia="true", **more)
    state, schur = rest(form), SchurPreconditioner(form)
    jacobian = form.create_matrix("nest" if case == "biaxial" else "aij")
    increment = form.increment(state.x, state.stress, 0.5, 0.0)
    form.jacobian(state.local, 1e3, increment, jacobian)
    schur.fill(state.local, 1e3, increment, jacobian)
    laplacian = schur.viscous.query(INERTIAL)
    one, found = laplacian.createVecs()
    one.set(1.0)
    laplacian.mult(one, found)
    corners, comm = form.grid.corners, form.grid.comm.tompi4py()
    i, j = corners.index[:, corners.owned]
    if case == "biaxial":
        near, face = (i < 2) | (i > 4), (i == 0) | (i == 6)
        assert (found.array[face] < 0.0).all()
    else:
        near = ((i < 3) | (i > 3)) & ((j < 3) | (j > 3))
        np.testing.assert_array_equal(found.array[(i == 0) & (j == 0)], 1.0)
    largest = comm.allreduce(np.abs(found.array).max(initial=0.0), MPI.MAX)
    assert np.abs(found.array[~near]).max(initial=0.0) < 1e-12 * largest
    assert comm.allreduce(int((~near).sum())) > 10


@pytest.mark.parametrize("flow", ["vertical_chute", "inclined_plane"])
def test_iterations_do_not_grow_in_flows_on_fixed_meshes(tmp_path, flow):
    """The mesh of the inclined plane is graded; the chute has a coarse correction."""
    more = ("-pgran_coarse_correction", "true", "-dm_mat_type", "nest")
    for size, ranks in ((1, 1), (0.5, 2)):
        path = tmp_path / f"{size}.h5"
        pgran(ranks, f"{flow}.opts", path, "-options_file",
              ROOT / "options" / "solver_mg_fixed.opts", "-pgran_element_size", size,
              *(more if flow == "vertical_chute" else ()))
        history = Result(path).history
        iterations = history["linear_iterations"] / history["newton_iterations"]
        assert iterations.max() <= 15.0, (size, ranks, iterations)
