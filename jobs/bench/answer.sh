#!/usr/bin/env bash
# Time to the answer: L = 40 d, I0 = 0.001 to 10 % compression on two ranks, with
# options/biaxial.opts, beside a run with tight tolerances of steps and solvers.
#
#   bash jobs/bench/answer.sh [element sizes: 2 1] [sizes of tight runs: 2 1]
#
# Element sizes 2 1 0.5 0.25 take half an hour, tight runs ten times as long as the others.
# Runs that are done are not repeated. Prints a table; nothing else should run meanwhile.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
sizes=${1:-2 1} tight=${2:-2 1}
for size in $sizes; do answer 2 "answer_$size" -pgran_element_size "$size"; done
for size in $tight; do
    answer 2 "tight_$size" -pgran_element_size "$size" -pgran_step_error 0.01 \
        -snes_atol 1e-7 -ksp_rtol 1e-4 -snes_lag_preconditioner 1
done
$python - $bench "$sizes" <<'EOF'
import sys
from pathlib import Path

import h5py

from pgran.measure import measure

bench, sizes = Path(sys.argv[1]), sys.argv[2].split()
targets = {2.0: 20, 1.0: 90, 0.5: 360, 0.25: 1800}


def history(file):
    return file["history/inertial_number_max"][-1]


print("L = 40 d, I0 = 0.001 to 10 % on 2 ranks; I max at the Gauss points, and its difference from a")
print("run with -pgran_step_error 0.01, -snes_atol 1e-7 and -ksp_rtol 1e-4; band at 10 %")
print(f"{'size':>5} {'target':>7} {'s':>8} {'MB':>6} {'steps':>6} {'Newton':>7} {'linear':>7} "
      f"{'I max':>10} {'to tight':>9} {'angle':>6} {'width':>6} {'tight s':>8}")
for size in sizes:
    path = bench / f"answer_{size}.h5"
    other = bench / f"tight_{size}.h5"
    row = measure(path)[-1]
    with h5py.File(path) as file:
        a = dict(file.attrs)
        I = history(file)
    off = spent = ""
    if other.exists():
        with h5py.File(other) as file:
            off = f"{100 * (I / history(file) - 1):+.2f} %"
            spent = f"{file.attrs['seconds']:.0f}"
    print(f"{size:>5} {targets.get(float(size), ''):>7} {a['seconds']:8.1f} {a['memory']:6.0f} "
          f"{a['steps']:6d} {a['newton_iterations']:7d} {a['linear_iterations']:7d} {I:10.4e} "
          f"{off:>9} {row['angle']:6.1f} {row['width']:6.1f} {spent:>8}")
EOF
