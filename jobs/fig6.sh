#!/usr/bin/env bash
# Figure 6: NGF at element sizes 2 d, d, d/2 and d/4, 10 % compression.
#
#   bash jobs/fig6.sh [element sizes: "2 1 0.5"]
#
# A minute on two cores, the run of figure 3 being there; d/4 takes half an hour more.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies section4 fig6 "$@"
