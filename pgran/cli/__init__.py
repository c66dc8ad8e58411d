"""Command line: start of PETSc, commands without PETSc, reports of errors, standard streams."""

from .commands import HELP, JSON, VERSION, as_json, run_without_petsc
from .petsc import start
from .report import REPORTED_ERRORS, STOPPED, exit_code, report_unused
from .streams import guard_streams

__all__ = ["HELP", "JSON", "REPORTED_ERRORS", "STOPPED", "VERSION", "as_json", "exit_code",
           "guard_streams", "report_unused", "run_without_petsc", "start"]
