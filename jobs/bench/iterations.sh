#!/usr/bin/env bash
# Outer iterations of options/biaxial.opts to 1e-6 on the right-hand sides that Newton gives, over
# mesh, ranks and the stage of localisation.
#
#   bash jobs/bench/iterations.sh [element sizes: 2 1 0.5] [ranks: 1 2 3 4]
#
# One step from each of three states (0.3, 1.8 and 5 %), every preconditioner fresh.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
for size in ${1:-2 1 0.5}; do
    for ranks in ${2:-1 2 3 4}; do
        for state in 0 1 3; do
            step "$ranks" $state -pgran_element_size "$size" -snapshot $state -dt 2e-4 \
                -ksp_rtol 1e-6 -snes_lag_preconditioner 1
        done
    done
done | tee $bench/iterations.jsonl | $python -c '
import json, sys

print("iterations to 1e-6, mean (most) over the Newton iterations of a step")
print("{:>5} {:>9} {:>6} {:>12} {:>12} {:>12}".format(
    "size", "unknowns", "ranks", "before", "during", "after"))
rows, every = {}, []
for line in sys.stdin:
    found = json.loads(line)
    counts = [row["iterations"] for row in found["newton"]]
    every.append(sum(counts) / len(counts))
    key = found["element_size"], found["unknowns"], found["ranks"]
    rows.setdefault(key, []).append(f"{every[-1]:.1f} ({max(counts)})")
    if len(rows[key]) == 3:
        print("{:5g} {:9d} {:6d} {:>12} {:>12} {:>12}".format(*key, *rows[key]), flush=True)
print(f"means from {min(every):.1f} to {max(every):.1f}: ratio {max(every) / min(every):.2f}")
'
