#!/usr/bin/env bash
# The local model by iteration: outer iterations of solvers that are not direct, before yielding and
# in flow, and the eigenvalues of the preconditioned Schur complement, which tell why none suffices.
#
#   bash jobs/bench/li.sh [element sizes: "4 2"]
#
# Some three minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench li "$@"
