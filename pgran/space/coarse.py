"""A coarse grid for velocity, fluidity and pressure together, combined with any preconditioner.

Long waves that grow make the entire system indefinite, including the pressure Schur complement.
With ``-pgran_coarse_correction`` they are resolved by the Galerkin operator of all three fields on
the coarsest grid that represents them, before the preconditioner M chosen by the options::

    z = Q r,      y = z + M (r - A z),      Q = P (P^T A P)^-1 P^T

P interpolates like the elements: quadratically at the nodes, linearly at the corners. Options with
the prefix ``coarse_`` choose the solver of the coarse system.
"""

from itertools import product

from petsc4py import PETSc

from . import multigrid


def correct(ksp, dm, form):
    """Put a `CoarseCorrection` around the PC of a KSP, and return it. Collective."""
    pc = PETSc.PC().create(comm=form.grid.comm)
    pc.setType(PETSc.PC.Type.PYTHON)
    correction = CoarseCorrection(ksp.getPC(), dm, form)
    pc.setPythonContext(correction)
    ksp.setPC(pc)
    return correction


class CoarseCorrection:
    """The PC of this module, of type python, around a PC ``inner`` with a DM. Collective."""

    def __init__(self, inner, dm, form):
        self.inner = inner
        inner.setDM(dm)
        self._nest = None
        levels = (multigrid.flow_level(form),
                  multigrid.corner_level(form))
        self._up = [_interpolation(level, multigrid.resolving(form)) for level in levels]
        nodes, corners = self._up
        self.interpolation = PETSc.Mat().createNest(
            [[nodes, None], [None, corners]], comm=form.grid.comm)
        self.interpolation.convert(PETSc.Mat.Type.AIJ)
        self._coarse = PETSc.KSP().create(comm=form.grid.comm)
        self._coarse.setOptionsPrefix("coarse_")
        self._coarse.setType(PETSc.KSP.Type.PREONLY)
        self._coarse.getPC().setType(PETSc.PC.Type.LU)
        self._coarse.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        self._coarse.setFromOptions()

    def setUp(self, pc):
        """Compute the coarse operator and set up M."""
        matrix, other = pc.getOperators()
        first, parts = not self._nest, range(len(self._up))
        if first:
            self._blocks, self._halves, self._matrix = {}, {}, PETSc.Mat()
            self._rest, self._fine = matrix.createVecs()
        for a, b in product(parts, parts):
            half = self._halves[a, b] = matrix.getNestSubMatrix(a, b).matMult(
                self._up[b], result=self._halves.get((a, b)))
            self._blocks[a, b] = self._up[a].transposeMatMult(
                half, result=self._blocks.get((a, b)))
        if first:
            self._nest = PETSc.Mat().createNest(
                [[self._blocks[a, b] for b in parts] for a in parts], comm=matrix.comm)
        self._nest.assemble()
        self._nest.convert(PETSc.Mat.Type.AIJ, self._matrix)
        if first:
            self._coarse.setOperators(self._matrix)
            self._right, self._solution = self._matrix.createVecs()
        self._coarse.setUp()
        self.inner.setOperators(matrix, other)
        self.inner.setUp()

    def apply(self, pc, x, y):
        """Put the preconditioned ``x`` into ``y``."""
        matrix, _ = pc.getOperators()
        self.interpolation.multTranspose(x, self._right)
        self._coarse.solve(self._right, self._solution)
        self.interpolation.mult(self._solution, self._fine)
        matrix.mult(self._fine, self._rest)
        self._rest.aypx(-1.0, x)
        self.inner.apply(self._rest, y)
        y.axpy(1.0, self._fine)


def _interpolation(level, times):
    """The interpolation to a level from the grid after ``times`` >= 1 coarsenings."""
    up = None
    for _ in range(times):
        fine, level = level, level.coarser()
        more = level.interpolation(fine)
        up = up.matMult(more) if up else more
    return up
