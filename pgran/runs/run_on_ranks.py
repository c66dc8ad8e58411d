"""A run in separate processes, unless it is complete: run_on_ranks NAME.h5 FILE.opts [options]

PGRAN_RANKS (2) is the number of ranks. PGRAN_LAUNCH replaces ``mpiexec -n PGRAN_RANKS``, for
example by ``srun`` on a cluster, and PGRAN_PYTHON replaces the present Python.
"""

import os
import shlex
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py

from .. import cases
from ..cli import HELP, STOPPED, exit_code, guard_streams
from ..options import PREFIX, Interrupted, OptionError, ParameterError, SolutionError, written
from ..options.files import combined_options, default_solver, parsed
from ..output.checkpoint import checkpoints_of
from ..output.result import Result
from ..signals import SIGNALS, preserved

#: Default number of ranks.
RANKS = int(os.environ.get("PGRAN_RANKS", 2))
#: Options that do not change a result. The files of restart and mode_file are compared by age.
IGNORED = ("output", "progress", "restart", "mode_file", "checkpoint_steps", "checkpoint_minutes",
           "picture_every")
#: Seconds that a process has to end itself and its ranks.
GRACE = 10.0
#: Variables of Open MPI that users set and that do not describe a running job.
NETWORK = ("OMPI_MCA_pml", "OMPI_MCA_btl", "OMPI_MCA_mtl", "PMIX_MCA_psec",
           "OMPI_MCA_hwloc_base_binding_policy", "OMPI_MCA_mpi_yield_when_idle")


def command(ranks, *arguments):
    """Return the command (a list) and the environment (a dictionary) of `python`."""
    line = [os.environ.get("PGRAN_PYTHON", sys.executable), *map(str, arguments)]
    launcher = shlex.split(os.environ.get("PGRAN_LAUNCH", ""))
    environment = dict(os.environ)
    if not launcher:  # variables of an MPI that already runs would confuse another one
        environment = {key: value for key, value in environment.items() if key in NETWORK
                       or not key.startswith(("OMPI_", "PMIX_", "PRTE_"))}
    if ranks:
        count = [] if launcher and ranks == RANKS else ["-n", str(ranks)]
        line = [*(launcher or ["mpiexec"]), *count, *line]
    else:
        environment["OMPI_MCA_ess_singleton_isolated"] = "1"  # one rank needs no daemon of Open MPI
    package = str(Path(__file__).resolve().parents[2])
    environment.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                       OMPI_MCA_rmaps_base_oversubscribe="1", OMP_NUM_THREADS="1",
                       PYTHONPATH=os.pathsep.join(
                           filter(None, [package, environment.get("PYTHONPATH")])))
    return line, environment


def python(ranks, *arguments, check=True, timeout=None, **more):
    """Run ``python arguments`` on ranks (0: without mpiexec); return the finished process.

    `subprocess.run` describes the other arguments and the errors. Signals that stop a run are
    forwarded to the ranks.
    """
    line, environment = command(ranks, *arguments)
    signals = []

    def forward(number, frame):  # mpiexec forwards SIGUSR1, but ends its ranks on others
        signals.append(number)
        process.send_signal(signal.SIGUSR1)

    with subprocess.Popen(line, env=environment, **more) as process, preserved() as can_set:
        for number in SIGNALS if can_set else ():
            signal.signal(number, forward)
        try:
            output, errors = process.communicate(timeout=timeout)
        except BaseException:
            process.terminate()  # mpiexec ends its ranks; they would continue if it were killed
            try:
                process.wait(GRACE)
            except subprocess.TimeoutExpired:
                process.kill()
            raise
    # A signal before Python has started ends the ranks with the exit code of mpiexec.
    code = STOPPED if signals and process.returncode else process.returncode
    if check and code:
        raise subprocess.CalledProcessError(code, line, output, errors)
    return subprocess.CompletedProcess(line, code, output, errors)


def for_processes(process, action):
    """Call ``action(number)`` for all processes of the session that a process has started."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                if os.getsid(int(entry.name)) == process.pid:
                    action(int(entry.name))


def kill(process):
    """Send SIGKILL to all processes of the session that a process has started."""
    for_processes(process, lambda number: os.kill(number, signal.SIGKILL))


def requested_parameters(options_file, *options):
    """Return the `pgran.options.Parameters` of an options file and of options that override it."""
    texts = combined_options(options_file, *options)
    parameters = cases.read({**default_solver(texts)[1], **texts})
    cases.create(parameters)
    return parameters


def holds(path, parameters, ignored=IGNORED):
    """Return whether a result file can be read and has the same options, except ``ignored``."""
    try:
        with h5py.File(path, "r") as file:
            stored = cases.read(written(file.attrs["options"]), stored=True)
    except (OSError, KeyError, OptionError, ParameterError):
        return False
    return all(getattr(stored, option.name, None) == getattr(parameters, option.name)
               for option in parameters.options if option.name not in ignored)


def attributes(path, options_file, options=()):
    """Return the root attributes of a result file if it was made with these options, else {}.

    All resolved options except `IGNORED` and all options of PETSc must be equal. The file must be
    newer than the options file (or None), the files of user-defined classes, and the result or mode
    that the run starts from.
    """
    parameters = requested_parameters(options_file, *options)
    if not holds(path, parameters):
        return {}
    parts = (getattr(parameters, kind.name).rpartition(":")[0] for kind in cases.KINDS)
    sources = [name for name in (options_file, parameters.restart, parameters.mode_file, *parts)
               if name and os.path.isfile(name)]
    if os.path.getmtime(path) < max(map(os.path.getmtime, sources), default=0.0):
        return {}
    with h5py.File(path, "r") as file:
        found = dict(file.attrs)
    if "solver_options" not in found:
        return found
    stored = {line[1:].partition(" ")[::2] for line in found["solver_options"].splitlines()}
    texts = combined_options(options_file, *options)
    # Release 0.2 stored only the options that were given.
    same = any(stored == {item for item in requested.items() if not item[0].startswith(PREFIX)}
               for requested in (texts, {**default_solver(texts)[1], **texts}))
    return found if same else {}


def done(path, options_file, options=()):
    """Return whether a result file is complete and has these options; see `attributes`."""
    return bool(attributes(path, options_file, options).get("complete", False))


def pending(path, options_file, *options):
    """Return the options (a list of words) that start or resume a run, or None if it is `done`.

    Raises `pgran.options.OptionError` if ``options`` name another result file.
    """
    output = parsed(options).get(f"{PREFIX}output", str(path))
    if output != str(path):
        raise OptionError(f"-{PREFIX}output {output}: the result file of this run is {path}; "
                          "omit the option")
    found = attributes(path, options_file, options)
    if found.get("complete"):
        return None
    restart = ("-pgran_restart", str(path)) if found and checkpoints_of(path) else ()
    return [*map(str, options), "-pgran_output", str(path), *restart]


def run(path, options_file, *options, ranks=None, needed=True):
    """Run pgran unless the run is `done`; return the `pgran.output.result.Result`.

    A run that was stopped or killed resumes from its last checkpoint. See `attributes` for the
    options and `pgran.runs.sweep.run` for the errors. ``ranks`` is `RANKS` by default; 0 runs
    without mpiexec. A failure of a run that is not ``needed`` returns None.
    """
    words = pending(path, options_file, *options)
    if words is None:
        print(f"pgran: {path} is complete", file=sys.stderr)
        return Result(path)
    file = ("-options_file", options_file) if options_file else ()
    code = python(RANKS if ranks is None else ranks, "-m", "pgran", *file, *words,
                  check=False).returncode
    if code == STOPPED:
        raise Interrupted(f"{path}: the run was stopped; the same command resumes it")
    if code and needed:
        raise SolutionError(f"{path}: the run ended with exit code {code}")
    return None if code else Result(path)


def main(arguments):
    """Run the command line ``arguments``; return the exit code."""
    guard_streams()
    if len(arguments) < 2 or set(arguments) & set(HELP):
        print(__doc__)
        return int(len(arguments) < 2)
    return exit_code("pgran.runs.run_on_ranks", run, *arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
