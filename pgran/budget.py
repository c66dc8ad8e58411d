"""Hours and memory of a run: pgran-budget -options_file options/biaxial.opts -ranks 32 [options]

    python -m pgran.budget -options_file options/biaxial.opts -pgran_element_size 0.25 -ranks 16
    python -m pgran.budget -options_file options/li.opts -pgran_element_size 0.5

The estimate is that of docs/performance.md: what a Newton iteration and an unknown took in the runs
at hand, times how many there will be. It holds within a factor of two for the specimen, with the
solvers of options/biaxial.opts and of options/direct.opts or options/li.opts. For other cases give
the number of Newton iterations. The last line is what to ask a batch system for: twice as much, in
whole hours and GB.
"""

import sys
from typing import NamedTuple

from . import cases
from .cli import HEADS, HELP, JSON, VERSION, answer, as_json, is_option, own, read_file
from .options import PREFIX, OptionError
from .output import pace

ROWS = (
    own("options_file", "str", "file of options; the command line and further files win over it"),
    own("ranks", "int", "ranks of the run, a core for each", 2, low=1),
    own("newton", "int", "Newton iterations of the run; those of a specimen unless given", low=1),
    JSON)
#: Core seconds that multigrid takes for a Newton iteration and an unknown.
MULTIGRID = 2.8e-6
#: Core seconds of MUMPS for a Newton iteration with a million unknowns, and its growth.
DIRECT, GROWTH = 20.0, 1.25
#: The time of MUMPS falls with the ranks to this power.
SPEEDUP = 0.7
#: Bytes of an unknown: multigrid, and MUMPS with a million unknowns; and of a rank by itself.
BYTES, DIRECT_BYTES, RANK = 2.3e3, 5.6e3, 115e6
#: Newton iterations to 10 % compression, how they grow with it, and those of the local model.
NEWTON, POWER, LOCAL_NEWTON = 240, 0.45, 260


class Budget(NamedTuple):
    """What a run will take: seconds, and bytes of all ranks together."""

    unknowns: int
    newton: float
    seconds: float
    memory: float


def budget(case, ranks, multigrid, newton=None):
    """Return the `Budget` of a case.

    Raises `OptionError` where the number of Newton iterations is needed and missing.
    """
    count, local = case.unknowns, not case.material.model.has_fluidity
    if newton is None:
        if case.counted_by == "time":
            raise OptionError(f"-newton: how many Newton iterations a run of "
                              f"{case.parameters.case} takes is not known; give a number")
        share = case.count(case.targets[-1]) / 0.1
        # A local model yields sharply: its iterations belong to yielding, whatever the end is.
        newton = LOCAL_NEWTON if local else NEWTON * share**POWER
    if multigrid:
        return Budget(count, newton, MULTIGRID * count * newton / ranks,
                      BYTES * count + RANK * ranks)
    large = count / 1e6
    return Budget(count, newton, DIRECT * large**GROWTH * newton / ranks**SPEEDUP,
                  DIRECT_BYTES * count + RANK * ranks)


def run(parameters, asked, solver):
    """Print the estimate."""
    found = budget(cases.create(parameters), asked.ranks, solver == "fieldsplit", asked.newton)
    if asked.json:
        print(as_json(found._asdict()))
        return
    hours = found.seconds / 3600.0
    print(f"{found.unknowns} unknowns, {asked.ranks} ranks, "
          f"{'multigrid' if solver == 'fieldsplit' else 'MUMPS'}: some {found.newton:.0f} Newton "
          f"iterations, {pace.words(found.seconds)}, {found.memory / 1e9:.1f} GB\n"
          f"# Budget: {asked.ranks} ranks, {int(2.0 * hours) + 1} hours, "
          f"{int(2.0 * found.memory / 1e9) + 1} GB\n# Output: {parameters.output}")


def main(arguments):
    """Estimate what the command line ``arguments`` asks for; return the exit code."""
    texts, mine, words = {}, [], list(arguments)
    try:
        while words:
            word = words.pop(0)
            name = word.lstrip("-")
            value = words.pop(0) if name == "options_file" and words else None
            if name == "options_file":
                texts.update(read_file(value or ""))
            elif word not in (*HELP, *VERSION) and name.split("_")[0] in HEADS:
                texts[name] = words.pop(0) if words and not is_option(words[0]) else ""
            else:
                mine.append(word)
    except OptionError as problem:
        print(f"pgran.budget: error: {problem}", file=sys.stderr)
        return 1
    given = [word for name, text in texts.items() if name.startswith(PREFIX)
             for word in (f"-{name}", text)]
    return answer([*given, *mine], "budget", lambda parameters, asked: run(
        parameters, asked, texts.get("pc_type")), __doc__, ROWS, runs=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
