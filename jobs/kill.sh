#!/usr/bin/env bash
# Kill a run at 20 random moments, each time going on with another number of ranks, and let a quota,
# its folder and its disk fail it: the result must be that of a run which was left alone.
#
#   bash jobs/kill.sh [moments: 20] [directory: results/kill]
#
# About 4 minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies kill "$@"
