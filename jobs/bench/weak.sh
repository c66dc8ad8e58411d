#!/usr/bin/env bash
# Weak scaling: 4800 elements (64 000 unknowns) a rank, the specimen growing with the ranks.
#
#   bash jobs/bench/weak.sh [ranks: 1 2 4]
#
# Thirty steps from rest through yielding, linear systems to 1e-6. Where there are fewer cores than
# ranks the iterations say more than the seconds.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
declare -A shape=([1]="40 120" [2]="40 240" [4]="80 240" [8]="80 480" [16]="160 480" [64]="320 960"
                  [256]="640 1920")
for ranks in ${1:-1 2 4}; do
    read -r width height <<< "${shape[$ranks]}"
    answer "$ranks" "weak_$ranks" -pgran_width "$width" -pgran_height "$height" \
        -pgran_element_size 1 -ts_max_steps 30 -ksp_rtol 1e-6 -snes_lag_preconditioner 1
done
$python - $bench ${1:-1 2 4} <<'EOF'
import sys

import h5py

print(f"{'ranks':>5} {'L x H':>12} {'Newton':>7} {'linear/Newton':>14} {'s/Newton':>9} {'MB/rank':>8}")
for ranks in sys.argv[2:]:
    with h5py.File(f"{sys.argv[1]}/weak_{ranks}.h5") as file:
        a = file.attrs
        size = dict(line[1:].split(" ", 1) for line in a["options"].splitlines())
        print(f"{ranks:>5} {size['pgran_width'] + ' x ' + size['pgran_height']:>12} "
              f"{a['newton_iterations']:7d} {a['linear_iterations'] / a['newton_iterations']:14.1f} "
              f"{a['seconds'] / a['newton_iterations']:9.3f} {a['memory'] / a['ranks']:8.0f}")
EOF
