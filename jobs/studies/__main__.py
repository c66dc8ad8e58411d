"""Run or resume a study: python -m studies NAME [arguments] [options of its runs]

Everything after the first option is passed to the runs. ``NAME -help`` explains a study, and
``all`` runs every study in order. Completed runs with the same options are reused. The exit code
is 0 on success, 1 on failure, and 75 after a signal: the same command then resumes the study.

Tables are written to results/ as CSV and to docs/generated as Markdown, and figures to
docs/figures. PGRAN_DOCS names a directory that replaces docs.
"""

import importlib
import inspect
import sys

from pgran import __version__
from pgran.cli import HELP, STOPPED, VERSION, exit_code, guard_streams

#: Names of the studies, and the module of each.
STUDIES = {"section4": "section4", "meshes": "section4", "posed": "section4",
           "sensitivity": "reference", "verify": "reference", "regime": "reference",
           "spectra": "spectra", "growth": "growth", "specimen": "specimen",
           "primitive": "primitive", "flows": "flows", "flow_spectra": "flow_spectra",
           "stopping": "stopping", "bench": "bench", "kill": "kill"}


def load(name):
    """Return the function of a study."""
    if name not in STUDIES:
        raise ValueError(f"unknown study {name}; expected one of: all, {', '.join(STUDIES)}")
    return getattr(importlib.import_module(f"{__package__}.{STUDIES[name]}"), name)


def call(name, words):
    """Run a study with the arguments of a command line."""
    study = load(name)
    if any(word in HELP for word in words):
        print(inspect.getdoc(study))
        return
    count = next((n for n, word in enumerate(words) if word.startswith("-")), len(words))
    options = {"options": tuple(words[count:])} if words[count:] else {}
    try:
        arguments = inspect.signature(study).bind(*words[:count], **options)
    except TypeError as error:
        raise ValueError(f"{error}; see {name} -help") from None
    study(*arguments.args, **arguments.kwargs)


def main(words):
    """Run the studies that the command line ``words`` names; return the exit code."""
    guard_streams()
    name, *rest = words or HELP[:1]
    if name in VERSION:
        print(f"pgran {__version__}")
        return 0
    if name in HELP:
        lines = (f"  {study:12} {load(study).__doc__.splitlines()[0]}" for study in STUDIES)
        print(__doc__, *lines, sep="\n")
        return 0
    codes = []
    for study in STUDIES if name == "all" else [name]:
        codes.append(exit_code("studies", call, study, rest))
        if codes[-1] == STOPPED:
            return STOPPED
    return max(codes)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
