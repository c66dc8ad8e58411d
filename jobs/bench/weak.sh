#!/usr/bin/env bash
# Weak scaling: 4800 elements (64 000 unknowns) a rank, the specimen growing with the ranks.
#
#   bash jobs/bench/weak.sh [ranks: "1 2 4"]
#
# About twelve minutes on two cores, nine of them for four ranks.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench weak "$@"
