"""Why a step failed, in words: PETSc's reason, the place of the largest residual, what to try."""

import numpy as np
from petsc4py import PETSc

from ..space.element import SHAPE

#: What reasons of SNES mean, and what may help; ``@@`` marks options of PETSc.
SNES_WORDS = {
    "DIVERGED_MAX_IT": ("Newton's method did not converge in {its} iterations",
                        "a larger @@snes_max_it or a smaller @step_max"),
    "DIVERGED_LINE_SEARCH": ("the line search failed", "@@snes_linesearch_type basic"),
    "DIVERGED_DTOL": ("Newton's method diverged", "a smaller @step_max"),
    "DIVERGED_LOCAL_MIN": ("the line search found a minimum that is no solution",
                           "@@snes_linesearch_type basic"),
    "DIVERGED_LINEAR_SOLVE": ("the linear solver failed", "@@options_file options/direct.opts")}
#: The same for KSP.
KSP_WORDS = {
    "DIVERGED_ITS": ("it did not converge in {its} iterations",
                     "a larger @@ksp_max_it, or @@options_file options/direct.opts"),
    "DIVERGED_MAX_IT": ("it did not converge in {its} iterations",
                        "a larger @@ksp_max_it, or @@options_file options/direct.opts"),
    "DIVERGED_NANORINF": ("a preconditioner gave a value that is not a number",
                          "@@options_file options/direct.opts"),
    "DIVERGED_PC_FAILED": ("the preconditioner failed", "@@options_file options/direct.opts"),
    "DIVERGED_PCSETUP_FAILED": ("the preconditioner failed", "@@options_file options/direct.opts")}
#: The same for INFOG(1) of MUMPS.
MUMPS_WORDS = {
    -9: ("MUMPS had too little workspace", "a larger @@mat_mumps_icntl_14"),
    -10: ("MUMPS found the matrix singular", "a smaller @step_max"),
    -19: ("MUMPS may not use the memory that it needs", "a larger @@mat_mumps_icntl_23"),
    -13: ("MUMPS could not allocate memory", "more memory or ranks, or @@options_file "
          "options/biaxial.opts")}
#: What the equations of a field say.
EQUATIONS = {"v1": "momentum along x1", "v2": "momentum along x2", "g": "fluidity",
             "P": "incompressibility"}


def name_of(reasons, number):
    """Return the name of a reason, as PETSc has it, from a class such as SNES.ConvergedReason."""
    names = [name for name, value in vars(reasons).items()
             if value == number and not name.startswith("_")]
    return max(names, key=len, default=str(number))


def described(snes, form, increment, local):
    """Return why a SNES failed and where, and what may help, two texts. Collective.

    ``local`` (n_local,) are the unknowns that were tried last in a step with this increment.
    """
    name = name_of(PETSc.SNES.ConvergedReason, snes.getConvergedReason())
    why, cure = SNES_WORDS.get(name, ("Newton's method failed", "a smaller @step_max"))
    why = f"{why.format(its=snes.getIterationNumber())} ({name})"
    if name == "DIVERGED_LINEAR_SOLVE":
        because, cure = _linear(snes.getKSP())
        why += f": {because}"
    size, text = _largest(snes, form, increment.x)
    if np.isinf(size):  # the name of this reason differs between versions of PETSc
        why, cure = f"the residual is not a number ({name})", "a smaller @step_max"
    place = _meaningless(form, increment, local) if np.isinf(size) else None
    limit = form.case.law.limit
    if place and place.startswith("mu") and np.isfinite(limit):
        cure = (f"a start and loads that need mu < {limit:.4g} everywhere, a smaller "
                "@step_max, or another @law")
        if getattr(form.case.parameters, "wall_fluidity", "") == "zero":
            cure += "; a wall with @wall_fluidity zero needs more mu than others"
    if place and place.startswith("pressure"):
        cure = "loads that leave the pressure positive, or a smaller @step_max"
    return "; ".join(filter(None, [why, place, text])), cure


def _linear(ksp):
    name = name_of(PETSc.KSP.ConvergedReason, ksp.getConvergedReason())
    why, cure = KSP_WORDS.get(name, ("it stopped", "@@options_file options/direct.opts"))
    why = f"{why.format(its=ksp.getIterationNumber())} ({name})"
    pc = ksp.getPC()
    if pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps":
        info = pc.getFactorMatrix().getMumpsInfog(1)
        if info < 0:
            because, cure = MUMPS_WORDS.get(info, ("MUMPS failed", cure))
            why += f", {because} (INFOG(1) = {info}, INFOG(2) = " \
                   f"{pc.getFactorMatrix().getMumpsInfog(2)})"
    return why, cure


def _place(form, x, number):
    """Return the field and the coordinates (2,) of a local unknown."""
    grid = form.grid
    if number < grid.n_flow:
        node, field = divmod(number, grid.dof)
        return grid.fields[field], x[:, node]
    corner = number - grid.n_flow
    i, j = grid.corners.i[corner], grid.corners.j[corner]
    return "P", x[:, grid.nodes.index(2 * i, 2 * j)]


def _worst(form, size, describe):
    """Return the largest ``size`` (n,) of all ranks and what ``describe(index)`` says. Collective.

    What is not a number counts as infinite. Without entries the size is zero.
    """
    size = np.where(np.isnan(size), np.inf, size)
    found = (0.0, None)
    if size.size:
        index = int(np.argmax(size))
        found = float(size[index]), describe(index)
    return max(form.grid.comm.tompi4py().allgather(found), key=lambda answer: answer[0])


def _at(x):
    return f"at x = ({x[0]:.4g}, {x[1]:.4g}) d"


def _largest(snes, form, x):
    """The size of the largest residual, infinite if one is not a number, and its place in words."""
    residual = np.abs(snes.getFunction()[0].array_r)

    def describe(index):
        field, place = _place(form, x, form.grid.owned[index])
        value = f"{residual[index]:.2e}" if np.isfinite(residual[index]) else "not a number"
        return f"the largest residual is {value}, of {EQUATIONS[field]} {_at(place)}"

    return _worst(form, residual, describe)


def _meaningless(form, increment, local):
    """What has no meaning in the unknowns that were tried last, and where; None where all have."""
    # Other elements are images of those of this or another rank, beyond the ends of the domain.
    owned = form.grid.elements.owned
    pressure, mu = (values[:, owned] for values in (form.pressure(local, increment),
                                                    form.stress_ratio(local, increment)))

    def place(index):
        q, e = np.unravel_index(index, mu.shape)
        return _at(SHAPE[q] @ increment.x[:, form.grid.element_nodes[:, owned[e]]].T)

    def low(index):
        return (f"pressure is negative, {pressure.ravel()[index]:.3g} {form.case.stress_unit}, "
                + place(index))

    def steep(index):
        limit = form.case.law.limit
        return f"mu reaches {mu.ravel()[index]:.4g} {place(index)}" + (
            f", and the law bears less than {limit:.4g}" if np.isfinite(limit) else "")

    size, text = _worst(form, -pressure.ravel(), low)
    return text if size > 0.0 else _worst(form, mu.ravel(), steep)[1]
