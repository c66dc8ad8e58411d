#!/usr/bin/env bash
# The height at which a layer on a slope stops, three ways, and layers in time (docs/flows.md).
#
#   bash jobs/stopping.sh [directory: results/stopping] [-pgran_... options for all]
#
# About three minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies stopping "$@"
