#!/usr/bin/env bash
# From the linear spectrum to the nonlinear solver: an eigenvector grows at its eigenvalue.
#
#   bash jobs/growth.sh [directory: results/growth]
#
# About five minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies growth "$@"
