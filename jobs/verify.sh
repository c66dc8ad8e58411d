#!/usr/bin/env bash
# How far the answer of the main job depends on what the paper does not state: stiffer elasticity,
# half the element size, half the step limits, a larger inertial number. About 15 minutes on two
# cores; runs that are done are not repeated. Usage: bash jobs/verify.sh [directory]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bash jobs/local.sh setup
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMP_NUM_THREADS=1
results=${1:-results/verify}

job() {
    local name=$1
    shift
    [[ -f $results/$name.done ]] && return
    echo "== $name: $*"
    mpiexec -n "${PGRAN_RANKS:-2}" .venv/bin/python -m pgran -options_file options/biaxial.opts \
        -pgran_output "$results/$name.h5" "$@"
    touch "$results/$name.done"
}

job base
job stiff -pgran_shear_modulus 10000
job half_steps -pgran_step_max 0.001 -pgran_step_change 0.05
job inertial -pgran_inertial_number 0.03
job fine -pgran_element_size 1

.venv/bin/python - "$results" <<'EOF'
import sys
from pgran.measure import measure

rows = {name: measure(f"{sys.argv[1]}/{name}.h5")[-1]
        for name in ("base", "stiff", "half_steps", "fine", "inertial")}
print(f"{'run':12} {'I max':>10} {'to base':>9} {'angle':>7} {'width':>7}")
for name, row in rows.items():
    change = 100 * (row["inertial_number_max"] / rows["base"]["inertial_number_max"] - 1)
    band = f"{row['angle']:7.1f} {row['width']:7.1f}" if row["localised"] else ""
    print(f"{name:12} {row['inertial_number_max']:10.4e} {change:+8.2f}% {band}")
spread = rows["inertial"]
print(f"inertial: I / 0.03 from {spread['inertial_number_min'] / 0.03:.4f} "
      f"to {spread['inertial_number_max'] / 0.03:.4f}")
EOF
