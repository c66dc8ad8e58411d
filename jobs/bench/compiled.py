"""A Newton iteration and its assembly beside compiled code, in one run on the same ranks.

    mpiexec -n 2 python jobs/bench/compiled.py -options_file options/biaxial.opts \
        -pgran_element_size 0.5 -from results/biaxial.h5 -snapshot 1

The compiled code is the same weak form written in UFL, compiled by FFCx and assembled by
dolfinx 0.5 (Debian's python3-dolfinx-real), with a fresh MUMPS factorisation and one
solution each Newton iteration. Prints microseconds an element on this number of ranks,
seconds a Newton iteration, and their ratios.
"""

import sys
import time

import numpy as np
from mpi4py import MPI
from one_step import interpolated, one_step

from pgran.__main__ import start


def best(action, comm, repeats=5):
    """Return the least of the times that ``action`` takes on the slowest rank, in seconds."""
    times = []
    for _ in range(repeats):
        comm.barrier()
        begin = time.perf_counter()
        action()
        times.append(comm.allreduce(time.perf_counter() - begin, MPI.MAX))
    return min(times)


def compiled(settings, ranks):
    """Return seconds of compiled Jacobian, residual and of a fresh MUMPS solution."""
    import ufl
    from dolfinx import fem, mesh
    from petsc4py import PETSc

    from pgran.rheology import material_of

    material = material_of(settings)
    nx, ny = (round(size / settings.element_size) for size in (settings.width, settings.height))
    domain = mesh.create_rectangle(ranks, [[0, 0], [settings.width, settings.height]], [nx, ny],
                                   mesh.CellType.quadrilateral)
    cell = domain.ufl_cell()
    space = fem.FunctionSpace(domain, ufl.MixedElement(
        ufl.VectorElement("Q", cell, 2), ufl.FiniteElement("Q", cell, 2),
        ufl.FiniteElement("Q", cell, 1)))
    history = fem.FunctionSpace(domain, ufl.VectorElement(
        "Quadrature", cell, degree=5, dim=3, quad_scheme="default"))
    u, old = fem.Function(space), fem.Function(history)
    dx = ufl.Measure("dx", domain, metadata={"quadrature_degree": 5})
    (v, g, P), (w, h, q) = ufl.split(u), ufl.TestFunctions(space)
    theta = fem.Constant(domain, 0.5)
    mu_s, b = material.law.mu_s, material.law.b
    rate = ufl.sym(ufl.grad(v)) + theta / 2 * ufl.as_tensor([[old[0], old[2]], [old[2], old[1]]])
    total = g + theta * P
    mu = ufl.sqrt(2 * ufl.inner(rate, rate)) / total
    s = ufl.sqrt(P) / material.root_density
    excess = mu - mu_s
    source = abs(excess) * g - ufl.conditional(excess > 0, s * excess**2 / (b * mu), 0.0)
    residual = (ufl.inner(ufl.grad(w), 2 * P / total * rate) - P * ufl.div(w)
                + material.A**2 * ufl.inner(ufl.grad(h), ufl.grad(g)) + h * source
                - q * ufl.div(v)) * dx
    fast = {"cffi_extra_compile_args": ["-O3", "-march=native", "-ffast-math"]}
    form = fem.form(residual, jit_params=fast)
    tangent = fem.form(ufl.derivative(residual, u), jit_params=fast)
    u.sub(0).interpolate(lambda x: np.array([x[0] / 2 + 0.1 * np.sin(x[1]), -x[1] / 2]))
    u.sub(1).interpolate(lambda x: np.full(x.shape[1], material.fluidity))
    u.sub(2).interpolate(lambda x: np.full(x.shape[1], material.pressure))
    held = []
    for component, edge in ((1, 0.0), (1, settings.height), (0, None)):
        part = space.sub(0).sub(component)
        collapsed, _ = part.collapse()
        dofs = fem.locate_dofs_geometrical((part, collapsed), (
            lambda x: np.isclose(x[1], edge)) if edge is not None else (
            lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 0.0)))
        held.append(fem.dirichletbc(fem.Function(collapsed), dofs, part))
    A, f = fem.petsc.create_matrix(tangent), fem.petsc.create_vector(form)

    def jacobian():
        A.zeroEntries()
        fem.petsc.assemble_matrix(A, tangent, bcs=held)
        A.assemble()

    def forces():
        f.set(0.0)
        fem.petsc.assemble_vector(f, form)
        f.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    ksp = PETSc.KSP().create(ranks)
    ksp.setOptionsPrefix("compiled_")
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    x = f.duplicate()

    def solve():
        A.stateIncrease()
        ksp.setOperators(A)
        ksp.solve(f, x)

    jacobian(), forces(), solve()
    return best(jacobian, ranks), best(forces, ranks), best(solve, ranks, 3)


def ours(settings, comm, path, number):
    """Return seconds of pgran's Jacobian and residual at a state."""
    from pgran import weakform
    from pgran.weakform import Step

    form = weakform.discretise(settings, comm)
    state = interpolated(form, path, number)
    values = form.prescribed(state.time)
    step = Step(form, state.x, state.stress, 0.5, values, np.zeros_like(values))
    matrix, vector = form.create_matrix(), form.grid.create_vector()
    form.grid.from_local(state.local, vector)
    zero = np.zeros(form.grid.n_local)
    ranks = comm.tompi4py()
    return (best(lambda: form.jacobian(form.grid.to_local(vector), 0.0, step, matrix), ranks),
            best(lambda: form.residual(form.grid.to_local(vector), zero, step), ranks))


def action(settings, comm):
    from petsc4py import PETSc

    database, ranks = PETSc.Options(), comm.tompi4py()
    path, number = database.getString("from"), database.getInt("snapshot", -1)
    dt = database.getReal("dt", 1e-3)
    nx, ny = (round(size / settings.element_size) for size in (settings.width, settings.height))
    theirs = compiled(settings, ranks)
    mine = ours(settings, comm, path, number)
    rows = one_step(settings, comm, path, number, dt)["newton"]
    newton = sum(row["seconds"] for row in rows) / len(rows)
    if comm.rank:
        return
    each = 1e6 / (nx * ny)
    print(f"element size {settings.element_size:g} d, {nx * ny} elements, {comm.size} ranks")
    print(f"{'':34}{'compiled':>10}{'pgran':>10}{'ratio':>8}")
    lines = [("Jacobian, us an element", theirs[0] * each, mine[0] * each),
             ("residual, us an element", theirs[1] * each, mine[1] * each),
             ("Newton iteration, s", sum(theirs), newton)]
    for name, a, b in lines:
        print(f"{name:34}{a:10.3f}{b:10.3f}{b / a:8.2f}")
    print(f"{len(rows)} Newton iterations with {[row['iterations'] for row in rows]} linear ones; "
          f"MUMPS alone: {theirs[2]:.3f} s")


if __name__ == "__main__":
    sys.exit(start(sys.argv, action))
