#!/usr/bin/env bash
# Figure 7: LI at element sizes 2 d, d, d/2 and d/4, 1 % compression, with G = 200 |sigma_1|.
#
#   bash jobs/fig7.sh [element sizes: 2 1 0.5]
#
# About eight minutes on two cores. MUMPS solves every system, so that halving the elements takes
# some six times as long.
source "$(dirname "${BASH_SOURCE[0]}")/section4.sh"
for size in ${1:-2 1 0.5}; do
    run "$results/li_L40_I0.001_h$size.h5" options/li.opts -pgran_element_size "$size"
done
$python -m pgran.figures fig7 -results "$results"
