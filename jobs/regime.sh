#!/usr/bin/env bash
# Localised or homogeneous: the state at 10 % compression over I0 and L, as a map.
#
#   bash jobs/regime.sh [directory: results/regime]
#
# About ten minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies regime "$@"
