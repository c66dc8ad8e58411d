#!/usr/bin/env bash
# Outer iterations to 1e-6 of options/flows_mg.opts in the flows on fixed meshes, over mesh and
# ranks: on the way to the steady flow, and in ten steps in time without and with inertia.
#
#   bash jobs/bench/flows.sh [element sizes: "1 0.5 0.25"] [ranks: "1 2"]
#
# An estimate: twenty minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench flows "$@"
