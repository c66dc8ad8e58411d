"""Command line: start of PETSc, commands without PETSc, reports of errors, standard streams."""

from ..options import combined_options, command_option, parsed
from .commands import HELP, JSON, VERSION, as_json, run_without_petsc
from .petsc import (
    check_names,
    choose_solver,
    database,
    decimal_points,
    given_texts,
    petsc_runs,
    refuse_at_start,
    solver_options,
    start,
    steady,
)
from .report import (
    REPORTED_ERRORS,
    STOPPED,
    all_ranks_arrive,
    end_unless_shared,
    exit_code,
    petsc_message,
    report_error,
    report_unused,
)
from .streams import Stream, guard_streams

answer = run_without_petsc  # the name in release 0.2

__all__ = [
    "HELP", "JSON", "REPORTED_ERRORS", "STOPPED", "Stream", "VERSION", "all_ranks_arrive", "answer",
    "as_json", "check_names", "choose_solver", "combined_options", "command_option", "database",
    "decimal_points", "end_unless_shared", "exit_code", "given_texts", "guard_streams", "parsed",
    "petsc_message", "petsc_runs", "refuse_at_start", "report_error", "report_unused",
    "run_without_petsc", "solver_options", "start", "steady"]
