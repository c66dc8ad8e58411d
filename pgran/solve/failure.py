"""Messages for failed steps: PETSc's reason, the location of the largest residual and a remedy."""

import numpy as np
from petsc4py import PETSc

_SMALLER, _DIRECT = "a smaller @step_max", "@@options_file options/direct.opts"
_BASIC = "@@snes_linesearch_type basic"
_ITERATIONS = "it did not converge in {its} iterations", f"a larger @@ksp_max_it, or {_DIRECT}"
_PC = "the preconditioner failed", _DIRECT
#: Meaning and remedy of reasons of SNES; ``@@`` marks options of PETSc.
SNES_WORDS = {
    "DIVERGED_MAX_IT": ("Newton's method did not converge in {its} iterations",
                        f"a larger @@snes_max_it or {_SMALLER}"),
    "DIVERGED_LINE_SEARCH": ("the line search failed", _BASIC),
    "DIVERGED_DTOL": ("Newton's method diverged", _SMALLER),
    "DIVERGED_LOCAL_MIN": ("the line search found a minimum that is not a solution", _BASIC),
    "DIVERGED_LINEAR_SOLVE": ("the linear solver failed", _DIRECT)}
#: The same for KSP.
KSP_WORDS = {
    "DIVERGED_ITS": _ITERATIONS, "DIVERGED_MAX_IT": _ITERATIONS,
    "DIVERGED_NANORINF": ("a preconditioner returned NaN", _DIRECT),
    "DIVERGED_PC_FAILED": _PC, "DIVERGED_PCSETUP_FAILED": _PC}
#: The same for INFOG(1) of MUMPS.
MUMPS_WORDS = {
    -9: ("MUMPS had too little workspace", "a larger @@mat_mumps_icntl_14"),
    -10: ("MUMPS found the matrix singular", _SMALLER),
    -19: ("MUMPS may not use the memory that it needs", "a larger @@mat_mumps_icntl_23"),
    -13: ("MUMPS could not allocate memory",
          "more memory or ranks, or @@options_file options/biaxial.opts")}
#: Names of the equations, by field.
EQUATIONS = {**{f"v{c}": f"momentum along x{c}" for c in (1, 2, 3)}, "g": "fluidity",
             "P": "incompressibility"}


def name_of(reasons, number):
    """Return PETSc's name of a reason from a class such as SNES.ConvergedReason."""
    names = [name for name, value in vars(reasons).items()
             if value == number and not name.startswith("_")]
    return max(names, key=len, default=str(number))


def describe(snes, form, increment, local):
    """Return why and where a SNES failed, and a remedy, as two texts. Collective.

    ``local`` (n_local,) are the last unknowns that Newton's method has tried.
    """
    name = name_of(PETSc.SNES.ConvergedReason, snes.getConvergedReason())
    why, remedy = SNES_WORDS.get(name, ("Newton's method failed", _SMALLER))
    why, place = f"{why.format(its=snes.getIterationNumber())} ({name})", None
    if name == "DIVERGED_LINEAR_SOLVE":
        because, remedy = _linear(snes.getKSP())
        why += f": {because}"
    size, text = _largest_residual(snes, form, increment.x)
    if np.isinf(size):  # the name of this reason differs between versions of PETSc
        why = f"the residual is NaN ({name})"
        place, remedy = _undefined(form, increment, local)
    return "; ".join(filter(None, [why, place, text])), remedy


def _linear(ksp):
    name = name_of(PETSc.KSP.ConvergedReason, ksp.getConvergedReason())
    why, remedy = KSP_WORDS.get(name, ("it stopped", _DIRECT))
    why = f"{why.format(its=ksp.getIterationNumber())} ({name})"
    pc = ksp.getPC()
    if pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps":
        first, second = (pc.getFactorMatrix().getMumpsInfog(n) for n in (1, 2))
        if first < 0:
            because, remedy = MUMPS_WORDS.get(first, ("MUMPS failed", remedy))
            why += f", {because} (INFOG(1) = {first}, INFOG(2) = {second})"
    return why, remedy


def _largest(form, sizes, describe_entry):
    """Return the largest size on all ranks, inf for NaN, and the description of its entry."""
    sizes, found = np.where(np.isnan(sizes), np.inf, sizes), (0.0, None)
    if sizes.size:
        index = int(np.argmax(sizes))
        found = float(sizes[index]), describe_entry(index)
    return max(form.grid.comm.tompi4py().allgather(found), key=lambda entry: entry[0])


def place(x):
    """Return the coordinates ``x``, d, as text."""
    return f"at x = ({', '.join(f'{part:.4g}' for part in x)}) d"


def _largest_residual(snes, form, x):
    residual, grid = np.abs(snes.getFunction()[0].array_r), form.grid

    def describe_entry(index):
        node, field = divmod(grid.owned[index], grid.dof)
        name = grid.fields[field]
        if grid.owned[index] >= grid.n_flow:
            corner, name = grid.owned[index] - grid.n_flow, "P"
            node = grid.corner_nodes()[corner]
        value = f"{residual[index]:.2e}" if np.isfinite(residual[index]) else "NaN"
        return f"the largest residual is {value}, in {EQUATIONS[name]} {place(x[:, node])}"

    return _largest(form, residual, describe_entry)


def _undefined(form, increment, local):
    """Return where the unknowns leave the range of the law, and a remedy, as two texts."""
    # Ghost elements beyond the ends of the domain are images of owned elements.
    owned = form.grid.elements.owned
    pressure, mu = form.collect(
        local, increment, lambda p: np.array([p.P, p.response.stress_ratio]))[..., owned]

    def point(index):
        q, e = np.unravel_index(index, mu.shape)
        return place(form.element.shape[q] @ increment.x[:, form.grid.element_nodes[:, owned[e]]].T)

    size, text = _largest(form, -pressure.ravel(), lambda index: (
        f"pressure is negative, {pressure.ravel()[index]:.3g} {form.case.stress_unit}, "
        f"{point(index)}"))
    if size > 0.0:
        return text, f"loads that leave the pressure positive, or {_SMALLER}"
    limit, remedy = form.case.law.limit, _SMALLER
    _, text = _largest(form, mu.ravel(), lambda index: (
        f"mu reaches {mu.ravel()[index]:.4g} {point(index)}"))
    if np.isfinite(limit):
        text += f", and the law bears less than {limit:.4g}"
        remedy = (f"a start and loads that need mu < {limit:.4g} everywhere, a smaller "
                  "@step_max, or another @law")
        if getattr(form.case.parameters, "wall_fluidity", "") == "zero":
            remedy += "; a wall with @wall_fluidity zero needs a larger mu than other walls"
    return text, remedy
