"""Options: their description, loading of components, the options of a run, and options files."""

from .definition import Option, command_option, help_text, markdown_table, plain, positive
from .errors import PREFIX, Interrupted, OptionError, ParameterError, SolutionError, not_among
from .files import combined_options, default_solver, parsed, read_file, shipped
from .loading import Component
from .parameters import BOTH, RENAMED, RUN, Parameters, markdown, read, table, written

__all__ = [
    "BOTH", "PREFIX", "RENAMED", "RUN", "Component", "Interrupted", "Option", "OptionError",
    "ParameterError", "Parameters", "SolutionError", "combined_options", "command_option",
    "default_solver", "help_text", "markdown", "markdown_table", "not_among", "parsed",
    "plain", "positive", "read", "read_file", "shipped", "table", "written"]
