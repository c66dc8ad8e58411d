#!/usr/bin/env bash
# Figure 7: LI at element sizes 2 d, d, d/2 and d/4, 1 % compression, with G = 200 |sigma_1|.
#
#   bash jobs/fig7.sh [element sizes: "2 1 0.5"]
#
# About eight minutes on two cores. MUMPS solves every system, so that halving the elements takes
# some six times as long.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies section4 fig7 "$@"
