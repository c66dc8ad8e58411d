r"""Assembly and Newton iteration of pgran, and of compiled code, in one process on the same ranks.

    mpiexec -n 2 python -m studies.compiled -options_file options/biaxial.opts \
        -pgran_element_size 0.5 -from results/biaxial.h5 -snapshot 1 [-dt 1e-3]

The compiled code is the same weak form in UFL, compiled by FFCx and assembled by dolfinx 0.5
(Debian's python3-dolfinx-real), with a MUMPS factorisation and one solution per Newton iteration.
Rank 0 prints one line of JSON: seconds of the Jacobian, the residual and a Newton iteration of
both, [compiled, pgran], the seconds of MUMPS, and the number of elements.
"""

import sys
import time

import numpy as np

from .one_step import one_step
from .transfer import interpolated, main


def best(action, ranks, repeats=5):
    """Return the minimum over repeats of the seconds of ``action`` on the slowest rank."""
    times = []
    for _ in range(repeats):
        ranks.barrier()
        begin = time.perf_counter()
        action()
        times.append(max(ranks.allgather(time.perf_counter() - begin)))
    return min(times)


def compiled(case, ranks):
    """Return the seconds of Jacobian, residual and MUMPS solution of the compiled code."""
    import ufl
    from dolfinx import fem, mesh
    from petsc4py import PETSc

    material, (nx, ny) = case.material, case.shape
    width, height = case.parameters.width, case.parameters.height
    domain = mesh.create_rectangle(ranks, [[0, 0], [width, height]], [nx, ny],
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
    s = ufl.sqrt(P) / material.inertial_time
    excess = mu - mu_s
    source = abs(excess) * g - ufl.conditional(excess > 0, s * excess**2 / (b * mu), 0.0)
    residual = (ufl.inner(ufl.grad(w), 2 * P / total * rate) - P * ufl.div(w)
                + material.model.A**2 * ufl.inner(ufl.grad(h), ufl.grad(g)) + h * source
                - q * ufl.div(v)) * dx
    fast = {"cffi_extra_compile_args": ["-O3", "-march=native", "-ffast-math"]}
    form = fem.form(residual, jit_params=fast)
    tangent = fem.form(ufl.derivative(residual, u), jit_params=fast)
    u.sub(0).interpolate(lambda x: np.array([x[0] / 2 + 0.1 * np.sin(x[1]), -x[1] / 2]))
    u.sub(1).interpolate(lambda x: np.full(x.shape[1], case.fluidity))
    u.sub(2).interpolate(lambda x: np.full(x.shape[1], case.pressure))
    constraints = []
    for component, edge in ((1, 0.0), (1, height), (0, None)):
        part = space.sub(0).sub(component)
        collapsed, _ = part.collapse()
        dofs = fem.locate_dofs_geometrical((part, collapsed), (
            lambda x, edge=edge: np.isclose(x[1], edge)) if edge is not None else (
            lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 0.0)))
        constraints.append(fem.dirichletbc(fem.Function(collapsed), dofs, part))
    A, f = fem.petsc.create_matrix(tangent), fem.petsc.create_vector(form)

    def jacobian():
        A.zeroEntries()
        fem.petsc.assemble_matrix(A, tangent, bcs=constraints)
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


def compare(parameters, comm, path, number, dt):
    """Measure both codes; return the costs, a dictionary. Collective."""
    from pgran.solve.driver import matrix_type
    from pgran.space.weakform import discretise

    form = discretise(parameters, comm)
    state = interpolated(form, path, number)
    increment = form.increment(state.x, state.stress, 0.5, state.time)
    matrix, vector = form.create_matrix(matrix_type()), form.grid.create_vector()
    form.grid.from_local(state.local, vector)
    zero = np.zeros(form.grid.n_local)
    ranks = comm.tompi4py()
    jacobian = best(lambda: form.jacobian(form.grid.to_local(vector), 0.0, increment, matrix),
                    ranks)
    residual = best(lambda: form.residual(form.grid.to_local(vector), zero, increment), ranks)
    times = compiled(form.case, ranks)
    rows = one_step(parameters, comm, path, number, dt)["newton"]
    newton = sum(row["seconds"] for row in rows) / len(rows)
    return {"jacobian": [times[0], jacobian], "residual": [times[1], residual],
            "newton": [sum(times), newton], "mumps": times[2],
            "elements": int(np.prod(form.case.shape))}


if __name__ == "__main__":
    sys.exit(main(compare, __doc__))
