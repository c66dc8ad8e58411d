#!/usr/bin/env bash
# Cost of a step against size and ranks, of options/biaxial.opts and of MUMPS.
#
#   bash jobs/bench/size.sh [element sizes: 2 1 0.5] [ranks: 1 2 3 4] [sizes of MUMPS: the same]
#
# One step from the state at 10 %. Prints seconds of a Newton iteration, of its Jacobian and of its
# linear solution, and the peak memory of the largest rank, with exponents fitted over the sizes.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
sizes=${1:-2 1 0.5}
mumps="-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps -snes_lag_preconditioner 1"
{
    for ranks in ${2:-1 2 3 4}; do
        for size in $sizes; do
            step "$ranks" multigrid -pgran_element_size "$size" -snapshot 4 -dt 3e-4
        done
    done
    for ranks in 1 2; do
        for size in ${3:-$sizes}; do
            step "$ranks" mumps -pgran_element_size "$size" -snapshot 4 -dt 3e-4 $mumps
        done
    done
} | tee $bench/size.jsonl | $python -c '
import json, sys

import numpy as np

print("{:10} {:>5} {:>6} {:>9} {:>7} {:>7} {:>8} {:>9} {:>8} {:>8}".format(
    "solver", "ranks", "size", "unknowns", "Newton", "linear", "step s", "Newton s", "Jac. s", "MB/rank"))
groups = {}
for line in sys.stdin:
    found = json.loads(line)
    newton, n = found["newton"], len(found["newton"])
    seconds, jacobian = (sum(row[key] for row in newton) / n for key in ("seconds", "jacobian"))
    print("{:10} {:5d} {:6g} {:9d} {:7d} {:7d} {:8.2f} {:9.3f} {:8.3f} {:8.0f}".format(
        found["name"], found["ranks"], found["element_size"], found["unknowns"], n,
        sum(row["iterations"] for row in newton), n * seconds, seconds, jacobian,
        found["memory"]), flush=True)
    groups.setdefault((found["name"], found["ranks"]), []).append(
        (found["unknowns"], seconds, found["memory"]))
for (name, ranks), rows in groups.items():
    if len(rows) > 2:
        N, seconds, memory = np.array(rows).T
        base = memory.min() - (memory[1] - memory[0]) * N[0] / (N[1] - N[0])
        time = np.polyfit(np.log(N), np.log(seconds), 1)[0]
        last = np.log(seconds[-1] / seconds[-2]) / np.log(N[-1] / N[-2])
        space = np.polyfit(np.log(N[1:]), np.log(memory[1:] - base), 1)[0]
        print(f"{name}, {ranks} ranks: time of a Newton iteration ~ N^{time:.2f} (last two sizes "
              f"{last:.2f}), memory beyond {base:.0f} MB ~ N^{space:.2f}")
'
