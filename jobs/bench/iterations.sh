#!/usr/bin/env bash
# Outer iterations of options/biaxial.opts to 1e-6 on the right-hand sides that Newton gives, over
# mesh, ranks and the stage of localisation.
#
#   bash jobs/bench/iterations.sh [element sizes: "2 1 0.5"] [ranks: "1 2 3 4"]
#
# One step from each of three states (0.3, 1.8 and 5 %). An estimate: five minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench iterations "$@"
