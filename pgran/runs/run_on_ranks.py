"""One run of pgran, unless it is done: run_on_ranks NAME.h5 FILE.opts [options]

All studies start their runs here. PGRAN_RANKS (2) is the number of ranks of a run. PGRAN_LAUNCH
takes the place of ``mpiexec -n PGRAN_RANKS``, for example ``srun`` on a cluster, and PGRAN_PYTHON
that of the Python which runs the study.
"""

import os
import shlex
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py

from .. import cases
from ..cli import HELP, REPORTED_ERRORS, STOPPED, combined_options, guard_streams, parsed
from ..options import PREFIX, Interrupted, OptionError, ParameterError, SolutionError, written
from ..output.checkpoint import checkpoints_of
from ..output.result import Result
from ..signals import SIGNALS

#: Ranks of a run unless a study says otherwise.
RANKS = int(os.environ.get("PGRAN_RANKS", 2))
#: Rows that do not change a result. The files of restart and seed are compared by their age.
IGNORED = ("output", "progress", "restart", "mode_file", "checkpoint_steps", "checkpoint_minutes",
           "picture_every")
#: Seconds that a process has to end itself and its ranks.
GRACE = 10.0
#: What a user may choose for Open MPI: networks, how processes prove who they are, to which cores
#: ranks are bound, and whether ranks that wait for a message give their core away.
NETWORK = ("OMPI_MCA_pml", "OMPI_MCA_btl", "OMPI_MCA_mtl", "PMIX_MCA_psec",
           "OMPI_MCA_hwloc_base_binding_policy", "OMPI_MCA_mpi_yield_when_idle")
#: Options of runs that only show errors.
QUIET = "-pgran_progress", "quiet"


def command(ranks, *arguments):
    """Return the command (a list) and the environment (a dictionary) with which `python` starts."""
    line = [os.environ.get("PGRAN_PYTHON", sys.executable), *map(str, arguments)]
    launcher = shlex.split(os.environ.get("PGRAN_LAUNCH", ""))
    environment = dict(os.environ)
    if not launcher:
        # What an MPI that runs already has left behind would confuse another one.
        environment = {key: value for key, value in environment.items() if key in NETWORK
                       or not key.startswith(("OMPI_", "PMIX_", "PRTE_"))}
    if ranks:
        count = [] if launcher and ranks == RANKS else ["-n", str(ranks)]
        line = [*(launcher or ["mpiexec"]), *count, *line]
    else:
        environment["OMPI_MCA_ess_singleton_isolated"] = "1"  # one rank needs no daemon of Open MPI
    home = str(Path(__file__).resolve().parents[2])
    environment.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                       OMPI_MCA_rmaps_base_oversubscribe="1", OMP_NUM_THREADS="1",
                       PYTHONPATH=os.pathsep.join(
                           filter(None, [home, environment.get("PYTHONPATH")])))
    return line, environment


def python(ranks, *arguments, check=True, timeout=None, **more):
    """Run ``python arguments`` on ranks, with this package; return the finished process.

    Parameters
    ----------
    ranks : int
        0 runs without mpiexec. PGRAN_LAUNCH knows PGRAN_RANKS itself; it is told other numbers.
    *arguments : object
        Their texts are passed on.
    check : bool
        Whether another exit code than 0 is an error.
    timeout : float, optional
        Seconds after which the process is ended with all its ranks.
    **more
        Passed to `subprocess.Popen`.

    Raises
    ------
    subprocess.CalledProcessError, subprocess.TimeoutExpired
    """
    line, environment = command(ranks, *arguments)
    with subprocess.Popen(line, env=environment, **more) as process, _passed_on(process) as passed:
        try:
            output, errors = process.communicate(timeout=timeout)
        except BaseException:
            process.terminate()  # mpiexec then ends its ranks; if it were killed they would go on
            try:
                process.wait(GRACE)
            except subprocess.TimeoutExpired:
                process.kill()
            raise
    # A signal that comes before Python has started ends the ranks with the code of mpiexec.
    code = STOPPED if passed and process.returncode else process.returncode
    finished = subprocess.CompletedProcess(line, code, output, errors)
    if check:
        finished.check_returncode()
    return finished


@contextmanager
def _passed_on(process):
    """Let a signal that asks a run to stop reach its ranks; the list holds those that came.

    mpiexec hands SIGUSR1 to its ranks, but turns SIGTERM and SIGINT into their end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield []  # only the main thread may have signals
        return
    passed = []

    def pass_on(number, frame):
        passed.append(number)
        process.send_signal(signal.SIGUSR1)

    before = {number: signal.signal(number, pass_on) for number in SIGNALS}
    try:
        yield passed
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def for_processes(process, action):
    """Do ``action(number)`` for a process and all that it has started, such as its ranks.

    Processes that have just ended are passed over.

    Parameters
    ----------
    process : subprocess.Popen
        Started with ``start_new_session=True``. The processes of its session are its own.
    action : callable
    """
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                if os.getsid(int(entry.name)) == process.pid:
                    action(int(entry.name))


def kill(process):
    """Send SIGKILL to a process and to all that it has started; it is as for `for_processes`."""
    for_processes(process, lambda number: os.kill(number, signal.SIGKILL))


def asked(options_file, *options):
    """Return the `pgran.options.Parameters` of an options file and of options that win over it.

    Raises `pgran.options.OptionError` or `pgran.options.ParameterError` where they do not fit
    together.
    """
    parameters = cases.read(combined_options(options_file, *options))
    cases.create(parameters)
    return parameters


def holds(path, parameters, ignored=IGNORED):
    """Return whether the options stored in a result file are ``parameters``.

    Rows with the names ``ignored`` are not compared. A file that cannot be read holds nothing.
    """
    try:
        with h5py.File(path, "r") as file:
            theirs = cases.read(written(file.attrs["options"]), stored=True)
    except (OSError, KeyError, OptionError, ParameterError):
        return False
    return all(getattr(theirs, row.name, None) == getattr(parameters, row.name)
               for row in parameters.options if row.name not in ignored)


def attributes(path, options_file, options=()):
    """Return the root attributes of a result that was begun with these options, or None.

    All resolved options are compared but `IGNORED`, and so are the options of PETSc, such as
    -snes_atol, if the file stores them. The file must also be newer than the options file, than a
    file that holds the case, law or model, and than the result or mode that the run starts from.

    Parameters
    ----------
    path : str or Path
        The result file.
    options_file : str or Path or None
    options : sequence
        Further options as on the command line, which win over the file.
    """
    parameters = asked(options_file, *options)
    if not holds(path, parameters):
        return None
    parts = (getattr(parameters, kind.name).rpartition(":")[0] for kind in cases.KINDS)
    sources = [name for name in (options_file, parameters.restart, parameters.mode_file, *parts)
               if name and os.path.isfile(name)]
    if os.path.getmtime(path) < max(map(os.path.getmtime, sources), default=0.0):
        return None
    solver = {name: text for name, text in combined_options(options_file, *options).items()
              if not name.startswith(PREFIX)}
    with h5py.File(path, "r") as file:
        found = dict(file.attrs)
    theirs = found.get("solver_options")
    return found if theirs is None or parsed(theirs.split()) == solver else None


def done(path, options_file, options=()):
    """Return whether a result file is that of a whole run with the options that are asked for.

    The parameters are those of `attributes`.
    """
    return bool((attributes(path, options_file, options) or {}).get("complete", False))


def pending(path, options_file, *options):
    """Return the options (a list of words) with which a run to ``path`` begins or goes on.

    None if it is `done`. A run that was stopped or killed goes on from its last checkpoint. The
    parameters are those of `done`. Raises `pgran.options.OptionError` if ``options`` name another
    result file.
    """
    elsewhere = parsed(options).get(f"{PREFIX}output", str(path))
    if elsewhere != str(path):
        raise OptionError(f"-{PREFIX}output {elsewhere}: the result file of this run is {path}; "
                          "leave the option out")
    if done(path, options_file, options):
        return None
    begun = attributes(path, options_file, options) is not None and checkpoints_of(path)
    again = ("-pgran_restart", path) if begun else ()
    return [*map(str, options), "-pgran_output", str(path), *map(str, again)]


def run(path, options_file, *options, ranks=None, needed=True):
    """Run pgran to ``path`` unless that is `done`; return the `pgran.output.result.Result`.

    A run that was stopped or killed goes on from its last checkpoint.

    Parameters
    ----------
    path, options_file, *options
        As for `done`.
    ranks : int, optional
        `RANKS` unless given; 0 runs without mpiexec.
    needed : bool
        Whether a failure is an error; otherwise None is returned.

    Raises
    ------
    SolutionError
        If the run fails. Its own message is on the terminal.
    """
    words = pending(path, options_file, *options)
    if words is None:
        print(f"pgran: {path} is in place", file=sys.stderr)
        return Result(path)
    file = ("-options_file", options_file) if options_file else ()
    failed = python(RANKS if ranks is None else ranks, "-m", "pgran", *file, *words,
                    check=False).returncode
    if failed == STOPPED:
        raise Interrupted(f"{path}: the run was stopped; the same command goes on")
    if failed and not needed:
        return None
    if failed:
        raise SolutionError(f"{path}: the run ended with exit code {failed}")
    return Result(path)


def main(arguments):
    """Make the run of the command line ``arguments``, unless it is done; return the exit code."""
    guard_streams()
    if len(arguments) < 2 or set(arguments) & set(HELP):
        print(__doc__)
        return int(len(arguments) < 2)
    try:
        run(*arguments)
        return 0
    except Interrupted as error:
        print(f"pgran.runs.run_on_ranks: {error}", file=sys.stderr)
        return STOPPED
    except REPORTED_ERRORS as error:
        message = error.as_option()
    except (ValueError, OSError, subprocess.SubprocessError) as error:
        message = str(error)
    print(f"pgran.runs.run_on_ranks: error: {message}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
