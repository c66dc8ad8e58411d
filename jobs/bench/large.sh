#!/usr/bin/env bash
# Outer iterations to 1e-6 while the specimen grows, on elements of 4 d, with options/biaxial.opts
# alone and with options/large.opts after it, and the iterations of a run with the latter.
#
#   bash jobs/bench/large.sh [widths: "40 80 160"] [ranks: "1 2 4"]
#
# Steps are those of the run after yielding. Widths up to 160 take three minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench large "$@"
