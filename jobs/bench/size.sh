#!/usr/bin/env bash
# Cost of a step against size and ranks, of options/biaxial.opts and of MUMPS.
#
#   bash jobs/bench/size.sh [element sizes: "2 1 0.5"] [ranks: "1 2 3 4"] [sizes of MUMPS: the same]
#
# One step from the state at 10 % each. An estimate: three minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench size "$@"
