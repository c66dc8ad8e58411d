#!/usr/bin/env bash
# Outer iterations of options/biaxial.opts to 1e-6 with inertia, and without, over the size of the
# step, mesh and ranks, before yielding and in flow.
#
#   bash jobs/bench/inertia.sh [element sizes: "4 2 1"] [ranks: "1 2"]
#
# The first system of seven steps from each of two states. About five minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench inertia "$@"
