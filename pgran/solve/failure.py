"""Why a step failed, in words: PETSc's reason, the place of the largest residual, what to try."""

import numpy as np
from petsc4py import PETSc

#: What reasons of SNES mean, and what may help; ``@@`` marks options of PETSc.
SNES_WORDS = {
    "DIVERGED_FNORM_NAN": ("the residual is not a number", "a smaller @step_max"),
    "DIVERGED_FUNCTION_DOMAIN": ("the residual is not a number", "a smaller @step_max"),
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


def described(snes, form, x):
    """Return why a SNES failed and where, and what may help, two texts. Collective.

    ``x`` (2, n_nodes) is the mesh of the step that failed, d.
    """
    name = name_of(PETSc.SNES.ConvergedReason, snes.getConvergedReason())
    why, cure = SNES_WORDS.get(name, ("Newton's method failed", "a smaller @step_max"))
    why = f"{why.format(its=snes.getIterationNumber())} ({name})"
    if name == "DIVERGED_LINEAR_SOLVE":
        because, cure = _linear(snes.getKSP())
        why += f": {because}"
    places = [place for place in (_bad_unknown(snes, form, x), _largest(snes, form, x)) if place]
    return "; ".join([why, *places]), cure


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


def _largest(snes, form, x):
    """Where the residual is largest or not a number."""
    residual = np.abs(snes.getFunction()[0].array_r)
    size = np.where(np.isnan(residual), np.inf, residual)
    found = None
    if size.size:
        worst = int(np.argmax(size))
        field, at = _place(form, x, form.grid.owned[worst])
        found = float(size[worst]), field, at.tolist()
    size, field, at = max((answer for answer in form.grid.comm.tompi4py().allgather(found)
                           if answer), key=lambda answer: answer[0])
    value = f"{size:.2e}" if np.isfinite(size) else "not a number"
    return (f"the largest residual is {value}, of {EQUATIONS[field]} at x = ({at[0]:.4g}, "
            f"{at[1]:.4g}) d")


def _bad_unknown(snes, form, x):
    """What unknown of the last iterate has no meaning, and where; None where all have."""
    grid = form.grid
    values = snes.getSolution().array_r
    pressure = np.zeros(values.size, dtype=bool)
    pressure[grid.nodes.owned.size * grid.dof:] = True
    found = None
    for bad, words in ((~np.isfinite(values), "{} is not a number"),
                       (pressure & (values < 0.0), "the pressure is negative, {:.3g} {}")):
        if found is None and bad.any():
            worst = int(np.flatnonzero(bad)[np.argmin(np.nan_to_num(values[bad]))])
            field, at = _place(form, x, grid.owned[worst])
            text = words.format(field) if "{}" == words[:2] else words.format(
                values[worst], form.case.stress_unit)
            found = f"{text}, at x = ({at[0]:.4g}, {at[1]:.4g}) d"
    return next((text for text in grid.comm.tompi4py().allgather(found) if text), None)
