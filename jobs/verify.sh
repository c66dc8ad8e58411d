#!/usr/bin/env bash
# How far the answer of the main job depends on what the paper does not state: stiffer elasticity,
# half the element size, half the step limits, a larger inertial number. About 3 minutes on two
# cores; runs that are done are not repeated. Usage: bash jobs/verify.sh [directory]
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
results=${1:-results/verify}

job() {
    local name=$1
    shift
    run "$results/$name.h5" options/biaxial.opts "$@"
}

job base
job stiff -pgran_shear_modulus 10000
job half_steps -pgran_step_max 0.001 -pgran_step_error 0.05
job inertial -pgran_inertial_number 0.03
job fine -pgran_element_size 1

$python - "$results" <<'EOF'
import sys

import h5py
import numpy as np
from pgran.measure import measure

names = "base", "stiff", "half_steps", "fine", "inertial"
paths = {name: f"{sys.argv[1]}/{name}.h5" for name in names}
rows = {name: measure(path)[-1] for name, path in paths.items()}
fields = {name: h5py.File(path)["snapshots/0001/inertial_number"][...]
          for name, path in paths.items()}
base, largest = fields["base"], rows["base"]["inertial_number_max"]
print("at 10 % compression; the difference from the base is that of I at the same material points,")
print("largest over the specimen, over the largest I of the base")
print(f"{'run':12} {'I max':>10} {'to base':>9} {'difference':>11} {'angle':>6} {'width':>6}")
changes = {}
for name in names[:4]:
    row, step = rows[name], (len(fields[name]) - 1) // (len(base) - 1)
    changes[name] = difference = 100 * np.abs(fields[name][::step, ::step] - base).max() / largest
    print(f"{name:12} {row['inertial_number_max']:10.4e} "
          f"{100 * (row['inertial_number_max'] / largest - 1):+8.2f}% {difference:10.2f}% "
          f"{row['angle']:6.1f} {row['width']:6.1f}")
row = rows["inertial"]
limits = {"stiff": 3.0, "half_steps": 2.0, "fine": 10.0}  # percent of the largest I
wrong = [name for name, limit in limits.items() if changes[name] > limit]
if not 0.98 * 0.03 < row["inertial_number_min"] <= row["inertial_number_max"] < 1.02 * 0.03:
    wrong.append("inertial")
print(f"inertial: I / 0.03 from {row['inertial_number_min'] / 0.03:.4f} "
      f"to {row['inertial_number_max'] / 0.03:.4f}")
sys.exit(f"beyond the limits: {wrong}" if wrong else 0)
EOF
