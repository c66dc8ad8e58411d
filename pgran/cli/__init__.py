"""Command line: start of PETSc, commands without PETSc, reports of errors, standard streams."""

from ..options import command_option
from .commands import HELP, JSON, VERSION, as_json, run_without_petsc
from .petsc import start
from .report import REPORTED_ERRORS, STOPPED, exit_code, report_unused
from .streams import Stream, guard_streams

answer = run_without_petsc  # the name in release 0.2

__all__ = [
    "HELP", "JSON", "REPORTED_ERRORS", "STOPPED", "Stream", "VERSION", "answer", "as_json",
    "command_option", "exit_code", "guard_streams", "report_unused", "run_without_petsc", "start"]
