"""Checks of the options of TS, SNES, KSP and DM with which a run could not end correctly."""

from importlib import import_module

from petsc4py import PETSc

from ..options import ParameterError


def matrix_type():
    """Return the value of ``-dm_mat_type``, aij or nest."""
    kind = PETSc.Options().getString("dm_mat_type", PETSc.Mat.Type.AIJ)
    _require("dm_mat_type", kind, kind in (PETSc.Mat.Type.AIJ, PETSc.Mat.Type.NEST), "aij or nest")
    return kind


def _require(name, value, good, allowed):
    if not good:
        value = value if isinstance(value, str) else f"{value:g}"
        raise ParameterError(name, value, f"must be {allowed}", prefix="")


def check_options(ts, time, has_fluidity, coarse_correction):
    """Raise `pgran.options.ParameterError` for options that do not suit a run from ``time``."""
    database = PETSc.Options()
    _require("ts_max_steps", ts.getMaxSteps(), ts.getMaxSteps() >= 1, "an integer >= 1")
    _require("ts_init_time", ts.getTime(), ts.getTime() == time,
             f"{time:g}, the time at which this run begins")
    for name in ("ts_dt", "ts_time_step"):  # the latter from PETSc 3.23 on
        if database.hasName(name):
            raise ParameterError(name, database.getString(name), "not allowed; use @step_first, "
                                 "@step_max and @step_error", prefix="")
    # PETSc 3.26 regards a negative number as no limit.
    limit = database.getInt("snes_max_it", ts.getSNES().getTolerances()[3])
    _require("snes_max_it", limit, limit >= 1, "an integer >= 1")
    for name in ("snes_error_if_not_converged", "ksp_error_if_not_converged",
                 "ts_error_if_step_fails"):
        _require(name, 1, not database.getBool(name, False),
                 "false: a failed step is repeated with a smaller size")
    if matrix_type() == PETSc.Mat.Type.NEST:
        solver = ts.getSNES().getKSP().getPC().getType()
        rules = [("pc_type", solver, PETSc.PC.Type.FIELDSPLIT)]
        if has_fluidity:  # without it no other split is possible
            rules.append(("pc_fieldsplit_0_fields",
                          database.getString("pc_fieldsplit_0_fields", "0"), "0,1"))
        for option, found, good in rules:
            if found != good:
                raise ParameterError("dm_mat_type", "nest", f"requires @@{option} {good}, not "
                                     f"{found}", prefix="")
        # The solver of a block uses the block itself, which is always current.
        lag = database.getInt("snes_lag_preconditioner", 1)
        _require("snes_lag_preconditioner", lag, lag == 1, "1 with @@dm_mat_type nest")
    elif coarse_correction:
        raise ParameterError("coarse_correction", "true", "requires @@dm_mat_type nest")
    factor = database.getReal("ts_adapt_scale_solve_failed", 0.25)
    _require("ts_adapt_scale_solve_failed", factor, 0.0 < factor < 1.0,
             "a number > 0 and < 1: a failed step is repeated with a smaller size")
    name = "fieldsplit_pressure_pc_python_type"
    if database.hasName(name):
        text = database.getString(name)
        module, _, kind = text.rpartition(".")
        try:
            found = hasattr(import_module(module), kind)
        except (ImportError, ValueError):
            found = False
        _require(name, text, found, "a class, such as pgran.space.schur.CahouetChabard (before "
                 "release 0.3 its name was BothEnds)")
