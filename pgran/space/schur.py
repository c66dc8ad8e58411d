"""What stands for the Schur complement of velocity and fluidity against pressure.

With a viscosity eta and the storage rho = phi rho_s/dt of the velocity, the inverse of this
complement is close to the sum of what it is without inertia and without viscosity (Cahouet &
Chabard 1988)::

    -(M^-1 + L^-1),      M = (q, P/eta),      L = B D^-1 B^T

B is the divergence of the free velocities, and D their lumped mass matrix times rho. So L is a
Laplacian that knows the boundaries: the pressure is zero where the velocity is free, and has no
flux where it is held. Options choose this preconditioner, and how each part is solved::

    -pc_fieldsplit_schur_precondition user
    -fieldsplit_pressure_pc_type python
    -fieldsplit_pressure_pc_python_type pgran.space.schur.CahouetChabard
    -fieldsplit_pressure_viscous_pc_type sor
    -fieldsplit_pressure_inertial_pc_type gamg

Without inertia there is no L. Any other PC in place of this one sees M and not L.
"""

import numpy as np
from petsc4py import PETSc

#: The name under which PETSc keeps -L with -M.
INERTIAL = "pgran_inertial"


class SchurPreconditioner:
    """The matrices -M and -L of a form. Making and filling them is collective.

    Parameters
    ----------
    form : pgran.space.weakform.WeakForm

    Attributes
    ----------
    viscous : PETSc.Mat
        -M, which PETSc lets know the -L that was filled last.
    """

    def __init__(self, form):
        self._form, self.viscous = form, form.create_pressure_mass()
        grid, sets = form.grid, form.grid.field_sets()
        self._velocity, self._pressure = sets["velocity"], sets["pressure"]
        # The same in a Jacobian of blocks: numbers within the block of the nodes, or the corners.
        self._inner = []
        for part, field in zip(grid.part_sets(), (self._velocity, self._pressure)):
            above = grid.comm.tompi4py().scan(part.getLocalSize()) - part.getLocalSize()
            numbers = above + np.searchsorted(part.indices, field.indices)
            self._inner.append(
                PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=grid.comm))

    def fill(self, local, shift, increment, jacobian):
        """Fill them for the unknowns ``local`` (n_local,) and the ``jacobian`` there.

        ``shift`` is that of `WeakForm.jacobian`, gdot0.
        """
        self._form.pressure_mass(local, increment, self.viscous)
        storage = self._form.lumped_storage(shift, increment)
        if storage is not None:
            self.viscous.compose(INERTIAL, self._laplacian(storage, jacobian))

    def _laplacian(self, storage, jacobian):
        """-L, with the rows of prescribed pressures from the Jacobian: those of the identity."""
        divergence, pressure = self._parts(jacobian)
        gradient = divergence.transpose()
        scale = gradient.createVecLeft()
        scale.setArray(storage**-0.5)
        gradient.diagonalScale(scale)
        laplacian = gradient.transposeMatMult(gradient)
        laplacian.scale(-1.0)
        laplacian.axpy(1.0, pressure)
        return laplacian

    def _parts(self, jacobian):
        """The rows of the pressures in the Jacobian: columns of velocities, and of pressures."""
        if jacobian.getType() == PETSc.Mat.Type.NEST:
            velocity, pressure = self._inner
            return (jacobian.getNestSubMatrix(1, 0).createSubMatrix(pressure, velocity),
                    jacobian.getNestSubMatrix(1, 1))
        return (jacobian.createSubMatrix(self._pressure, columns)
                for columns in (self._velocity, self._pressure))


class CahouetChabard:
    """-(M^-1 + L^-1) as a PC of type python, whose parts have options of their own. Collective."""

    def setFromOptions(self, pc):
        """Make the PC of both parts."""
        self._viscous, self._inertial = (PETSc.PC().create(comm=pc.comm) for _ in range(2))
        for name, part in ("viscous", self._viscous), ("inertial", self._inertial):
            part.setOptionsPrefix(f"{pc.getOptionsPrefix()}{name}_")
            part.setFromOptions()

    def setUp(self, pc):
        """Give each part its matrix."""
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
