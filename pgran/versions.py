"""Differences between the versions of PETSc from 3.18 (Debian 12) to 3.26 (PyPI).

Functions import PETSc when they are called, because commands start it with their arguments.
"""

import ctypes

#: Arguments of PETSc in all commands. PETSc 3.26 lists unused options on standard output when it
#: ends with an error, 3.18 does not; pgran reports them itself.
FIRST = "-options_left", "0"


def callback_error(error):
    """Return the original error of PETSc or of a Python callback.

    petsc4py 3.26 wraps errors of callbacks in PETSc.Error, and slepc4py errors in SystemError.
    """
    from petsc4py import PETSc

    if isinstance(error, SystemError) and isinstance(error.__cause__, PETSc.Error):
        error = error.__cause__
    while isinstance(error, PETSc.Error) and error.__cause__:  # a callback within a callback
        error = error.__cause__
    return error


def set_schur_matrix(pc, matrix):
    """Set the matrix from which PCFIELDSPLIT preconditions the Schur complement."""
    from petsc4py import PETSc

    kinds = getattr(PETSc.PC, "FieldSplitSchurPreType", None) or PETSc.PC.SchurPreType
    pc.setFieldSplitSchurPreType(kinds.USER, matrix)


def was_read(name):
    """Return whether PETSc has read an option; petsc4py 3.18 lacks this function."""
    from petsc4py import PETSc

    used = ctypes.c_int(0)  # C has a bool of one byte (3.26) or an enumeration of four (3.18)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)
