#!/usr/bin/env bash
# Ratios that show whether the solver has become slower: assembly and Newton iteration relative to
# compiled code, iterations, bytes per unknown, steps. About two minutes on two cores.
#
#   bash jobs/bench/guard.sh
#
# Ratios to compiled code need dolfinx (apt install python3-dolfinx-real) and are a dash without it.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench guard "$@"
