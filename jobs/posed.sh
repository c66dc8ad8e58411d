#!/usr/bin/env bash
# Does figure 7 still depend on the mesh where the law is well-posed?
#
#   bash jobs/posed.sh [element sizes: "2 1 0.5"] [compression: 0.01] [directory: results/posed]
#
# About ten minutes on two cores, half of them for the law of Bingham on elements of d/2.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies posed "$@"
