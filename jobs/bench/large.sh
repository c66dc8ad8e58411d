#!/usr/bin/env bash
# Outer iterations of options/biaxial.opts to 1e-6 while the specimen grows, on elements of 4 d.
#
#   bash jobs/bench/large.sh [widths: "40 80 160"] [ranks: "1 2 4"]
#
# Nine steps from rest. An estimate: four minutes on two cores; a width of 320 takes as long again.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m pgran.studies bench large "$@"
