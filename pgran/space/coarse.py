"""A coarse grid for velocity, fluidity and pressure together, around any other preconditioner.

Long waves that grow make the whole system indefinite, the Schur complement of the pressure
included, and a specimen that is many wavelengths wide has many of them. With
``-pgran_coarse_correction`` they are solved for on the coarsest grid that resolves them, by the
Galerkin operator of all three fields, before the preconditioner M that the options choose::

    z = Q r,      y = z + M (r - A z),      Q = P (P^T A P)^-1 P^T

P is the interpolation of the elements: quadratic at the nodes, linear at the corners. Options with
the prefix ``coarse_`` say how the coarse system is solved.
"""

from functools import reduce

from petsc4py import PETSc

from . import multigrid


def correct(ksp, dm, form):
    """Put a `CoarseCorrection` around the PC of a KSP, which has its options. Collective.

    Returns the `CoarseCorrection`.
    """
    pc = PETSc.PC().create(comm=form.grid.comm)
    pc.setType(PETSc.PC.Type.PYTHON)
    correction = CoarseCorrection(ksp.getPC(), dm, form)
    pc.setPythonContext(correction)
    ksp.setPC(pc)
    return correction


class CoarseCorrection:
    """The PC of this module, of type python. Collective.

    Parameters
    ----------
    inner : PETSc.PC
        The preconditioner M.
    dm : PETSc.DM
        That of the system, for M.
    form : pgran.space.weakform.WeakForm
    """

    def __init__(self, inner, dm, form):
        self.inner = inner
        inner.setDM(dm)
        self._blocks = None
        names = ["velocity", "fluidity"] if form.grid.has_fluidity else ["velocity"]
        self._up = [_interpolation(level, multigrid.resolving(form)) for level in (
            multigrid.node_level(form, names), multigrid.corner_level(form))]
        self._vectors = [up.createVecs() for up in self._up]
        self._coarse = PETSc.KSP().create(comm=form.grid.comm)
        self._coarse.setOptionsPrefix("coarse_")
        self._coarse.setType(PETSc.KSP.Type.PREONLY)
        self._coarse.getPC().setType(PETSc.PC.Type.LU)
        self._coarse.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        self._coarse.setFromOptions()

    def setUp(self, pc):
        """Make the coarse operator, and M."""
        matrix, other = pc.getOperators()
        first = self._blocks is None
        if first:
            self._blocks, self._halves, self._matrix = {}, {}, PETSc.Mat()
            self._rest, self._more = matrix.createVecs()
        parts = range(len(self._up))
        for a in parts:
            for b in parts:
                half = matrix.getNestSubMatrix(a, b).matMult(
                    self._up[b], result=self._halves.get((a, b)))
                self._blocks[a, b] = self._up[a].transposeMatMult(
                    half, result=self._blocks.get((a, b)))
                self._halves[a, b] = half
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
        """Put the correction and what M makes of the rest of ``x`` into ``y``."""
        matrix, _ = pc.getOperators()
        self._correction(x, self._more)
        matrix.mult(self._more, self._rest)
        self._rest.aypx(-1.0, x)
        self.inner.apply(self._rest, y)
        y.axpy(1.0, self._more)

    def _correction(self, x, y):
        given, found = x.getArray(readonly=1), y.getArray()
        for up, below, above, part, there in self._parts():
            above.setArray(given[part])
            up.multTranspose(above, below)
            self._right.getArray()[there] = below.getArray(readonly=1)
        self._coarse.solve(self._right, self._solution)
        for up, below, above, part, there in self._parts():
            below.setArray(self._solution.getArray(readonly=1)[there])
            up.mult(below, above)
            found[part] = above.getArray(readonly=1)

    def _parts(self):
        """Interpolation, vectors, and places of the nodes, and of the corners, on this rank."""
        fine = coarse = 0
        for up, (below, above) in zip(self._up, self._vectors):
            sizes = above.getLocalSize(), below.getLocalSize()
            yield up, below, above, slice(fine, fine + sizes[0]), slice(coarse, coarse + sizes[1])
            fine, coarse = fine + sizes[0], coarse + sizes[1]


def _interpolation(level, times):
    """The matrix from the grid that is ``times`` coarser to a level. Collective."""
    steps = []
    for _ in range(times):
        coarser = level.coarser()
        steps.append(coarser.interpolation(level))
        level = coarser
    return reduce(lambda up, more: up.matMult(more), steps)
