"""Run or resume a study: study.sh NAME [arguments] [options of its runs]

Arguments come first; everything from the first option on is passed to the runs. ``NAME -help``
describes a study and its arguments, and ``all`` runs every study. Runs with the same options are
reused. The exit code is 0 after success, 1 after an error, and 75 after a signal; the same command
then resumes the study.
"""

import importlib
import inspect
import subprocess
import sys

from pgran import __version__
from pgran.cli import HELP, REPORTED_ERRORS, STOPPED, VERSION, guard_streams
from pgran.options import Interrupted

STUDIES = ("section4", "meshes", "sensitivity", "growth", "specimen", "primitive", "regime",
           "spectra", "flows", "flow_spectra", "stopping", "bench", "kill")


def load(name):
    """Return the module of a study."""
    if name not in STUDIES:
        raise ValueError(f"unknown study {name}; expected one of: {', '.join(STUDIES)}, all")
    return importlib.import_module(f"{__package__}.{name}")


def call(name, arguments):
    """Call a study with the texts of its command line. Raises ValueError for wrong arguments."""
    study = load(name)
    if any(argument in HELP for argument in arguments):
        print(study.__doc__)
        return
    first = next((n for n, text in enumerate(arguments) if text.startswith("-")), len(arguments))
    more = {"options": tuple(arguments[first:])} if arguments[first:] else {}
    try:
        inspect.signature(study.main).bind(*arguments[:first], **more)
    except TypeError as problem:
        raise ValueError(f"{problem}; see {name} -help") from None
    study.main(*arguments[:first], **more)


def main(arguments):
    """Run the study that ``arguments`` name; return the exit code."""
    guard_streams()
    name, *rest = arguments or HELP[:1]
    if name in VERSION:
        print(f"pgran {__version__}")
        return 0
    if name in HELP:
        lines = (f"  {study:12} {load(study).__doc__.splitlines()[0]}" for study in STUDIES)
        print(__doc__, *lines, sep="\n")
        return 0 if arguments else 1
    try:
        if name == "all":
            for study in STUDIES:
                for more in getattr(load(study), "ALL", ((),)):
                    print(f"\n{' '.join((study, *more))}", flush=True)
                    call(study, [*more, *rest])
        else:
            call(name, rest)
        return 0
    except Interrupted as error:
        print(f"pgran study: {error}", file=sys.stderr)
        return STOPPED
    except REPORTED_ERRORS as error:
        message = error.as_option()
    except (ValueError, OSError, subprocess.SubprocessError) as error:
        message = str(error)
    print(f"pgran study: error: {message}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
