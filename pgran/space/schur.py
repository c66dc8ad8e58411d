"""Approximation of the pressure Schur complement.

With a viscosity eta and the storage rho = phi rho_s/dt of the velocity, its inverse is close to the
sum of its limits without inertia and without viscosity (Cahouet & Chabard 1988)::

    -(M^-1 + L^-1),      M = (q, P/eta),      L = B D^-1 B^T

B is the divergence of the free velocities, and D their lumped mass matrix times rho. So L is a
Laplacian with zero pressure where the velocity is free, and no flux where it is held. It is absent
without inertia. Options choose this preconditioner, and the solver of each part::

    -pc_fieldsplit_schur_precondition user
    -fieldsplit_pressure_pc_type python
    -fieldsplit_pressure_pc_python_type pgran.space.schur.CahouetChabard
    -fieldsplit_pressure_viscous_pc_type sor
    -fieldsplit_pressure_inertial_pc_type gamg

Any other PC uses M only.
"""

from petsc4py import PETSc

from ..versions import set_schur_matrix

#: The name under which PETSc stores -L with -M.
INERTIAL = "pgran_inertial"


def configure(ksp, form):
    """Return the `SchurPreconditioner` that options request, or None. Collective."""
    pc = ksp.getPC()
    prefix = pc.getOptionsPrefix() or ""
    kind = PETSc.Options().getString(f"{prefix}pc_fieldsplit_schur_precondition", "")
    if pc.getType() != PETSc.PC.Type.FIELDSPLIT or kind != "user":
        return None
    schur = SchurPreconditioner(form)
    set_schur_matrix(pc, schur.viscous)
    return schur


class SchurPreconditioner:
    """The matrix ``viscous``, -M, which PETSc stores with the last -L. Collective."""

    def __init__(self, form):
        self._form, self.viscous = form, form.create_pressure_mass()
        self._sets = form.grid.part_sets()

    def fill(self, local, shift, increment, jacobian):
        """Fill them for unknowns (n_local,) and their ``jacobian`` with a ``shift``, gdot0."""
        self._form.pressure_mass(local, increment, self.viscous)
        if self._form.storage["velocity"]:
            storage = self._form.lumped_storage(shift, increment)
            self.viscous.compose(INERTIAL, self._laplacian(storage, jacobian))

    def _laplacian(self, storage, jacobian):
        """-L, whose rows of prescribed pressures are rows of the identity."""
        if jacobian.getType() == PETSc.Mat.Type.NEST:
            divergence, pressures = (jacobian.getNestSubMatrix(1, part) for part in range(2))
        else:
            divergence, pressures = (jacobian.createSubMatrix(self._sets[1], columns)
                                     for columns in self._sets)
        gradient = divergence.transpose(PETSc.Mat())
        scale = gradient.createVecLeft()
        scale.setArray(storage**-0.5)
        gradient.diagonalScale(scale)
        laplacian = gradient.transposeMatMult(gradient)
        laplacian.scale(-1.0)
        laplacian.axpy(1.0, pressures)
        return laplacian


class CahouetChabard:
    """-(M^-1 + L^-1) as a PC of type python. The parts have separate options. Collective."""

    def setFromOptions(self, pc):
        """Create both parts."""
        self._viscous, self._inertial = (PETSc.PC().create(comm=pc.comm) for _ in range(2))
        for name, part in ("viscous", self._viscous), ("inertial", self._inertial):
            part.setOptionsPrefix(f"{pc.getOptionsPrefix()}{name}_")
            part.setFromOptions()

    def setUp(self, pc):
        """Set the matrix of each part."""
        _, mass = pc.getOperators()
        self._viscous.setOperators(mass)
        self._laplacian = mass.query(INERTIAL)
        if self._laplacian:
            self._inertial.setOperators(self._laplacian)
            self._other = mass.createVecLeft()

    def apply(self, pc, x, y):
        """Put the sum of both parts applied to ``x`` into ``y``."""
        self._viscous.apply(x, y)
        if self._laplacian:
            self._inertial.apply(x, self._other)
            y.axpy(1.0, self._other)
