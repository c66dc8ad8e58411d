#!/usr/bin/env bash
# One page of ratios that tell whether the solver has become slower: assembly and Newton iteration
# to compiled code, iterations, bytes an unknown, steps, Newton iterations a step.
#
#   bash jobs/bench/guard.sh
#
# About two minutes on two cores. What needs compiled code is a dash without dolfinx
# (apt install python3-dolfinx-real).
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench guard "$@"
