"""Start a study: python -m studies NAME [arguments] [options of its runs]

Arguments come first; everything from the first option on is passed to the runs. ``NAME -help``
says what a study asks and which arguments it takes. Runs that were done with the same options are
not repeated. A good study ends with exit code 0, a failed one with the reason and 1, and one that a
signal has stopped with 75: the same command goes on.
"""

import importlib
import inspect
import subprocess
import sys

from pgran import __version__
from pgran.cli import HELP, REPORTED_ERRORS, STOPPED, VERSION, guard_streams
from pgran.options import Interrupted

STUDIES = ("section4", "meshes", "posed", "sensitivity", "verify", "growth", "specimen",
           "primitive", "regime", "spectra", "flows", "flow_spectra", "stopping", "bench", "kill")


def load(name):
    """Return the module of a study."""
    return importlib.import_module(f"{__package__}.{name}")


def main(arguments):
    """Start the study that ``arguments`` name; return the exit code."""
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
        if name not in STUDIES:
            raise ValueError(f"{name}: no such study; allowed is {' | '.join(STUDIES)}")
        study = load(name)
        if any(argument in HELP for argument in rest):
            print(study.__doc__)
            return 0
        first = next((n for n, text in enumerate(rest) if text.startswith("-")), len(rest))
        more = {"options": tuple(rest[first:])} if rest[first:] else {}
        try:
            call = inspect.signature(study.main).bind(*rest[:first], **more)
        except TypeError as problem:
            raise ValueError(f"{problem}; {name} -help says what is allowed") from None
        study.main(*call.args, **call.kwargs)
        return 0
    except Interrupted as error:
        print(f"studies: {error}", file=sys.stderr)
        return STOPPED
    except REPORTED_ERRORS as error:
        message = error.as_option()
    except (ValueError, OSError, subprocess.SubprocessError) as error:
        message = str(error)
    print(f"studies: error: {message}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
