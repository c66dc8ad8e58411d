#!/usr/bin/env bash
# Outer iterations to 1e-6 while the specimen grows, on elements of 4 d, with options/biaxial.opts
# alone and with options/large.opts after it.
#
#   bash jobs/bench/large.sh [widths: "40 80 160"] [ranks: "1 2 4"]
#
# Steps of three sizes from homogeneous flow. Widths up to 160 take five minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m pgran.studies bench large "$@"
