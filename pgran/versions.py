"""What differs between the generations of PETSc: 3.18 (Debian 12) to 3.26 (PyPI).

All else is the same code on both. PETSc is imported when a function is called, because commands
start it with their own arguments.
"""

import ctypes

#: What every command starts PETSc with: 3.26 lists options that nothing has read on standard output
#: when it ends with an error, 3.18 does not; pgran reports them itself.
FIRST = "-options_left", "0"


def callback_error(error):
    """Return what PETSc or a Python callback has raised, from what Python saw after it.

    petsc4py 3.26 wraps what a callback raises in PETSc.Error, and 3.18 lets it through. slepc4py
    3.26 wraps what SLEPc raises in SystemError.
    """
    from petsc4py import PETSc

    if isinstance(error, SystemError) and isinstance(error.__cause__, PETSc.Error):
        error = error.__cause__
    while isinstance(error, PETSc.Error) and error.__cause__:  # a callback within a callback
        error = error.__cause__
    return error


def set_schur_matrix(pc, matrix):
    """Let PCFIELDSPLIT precondition the Schur complement by a matrix."""
    from petsc4py import PETSc

    kinds = getattr(PETSc.PC, "FieldSplitSchurPreType", None) or PETSc.PC.SchurPreType
    pc.setFieldSplitSchurPreType(kinds.USER, matrix)


def was_read(name):
    """Return whether PETSc has read an option; petsc4py 3.18 cannot tell, so the library is asked.

    A C bool of one byte (3.26) and an enumeration of four (3.18) both fill an integer of zeros.
    """
    from petsc4py import PETSc

    used = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)
