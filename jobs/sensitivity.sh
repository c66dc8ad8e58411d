#!/usr/bin/env bash
# How the band of figure 3 depends on what the paper does not state, at elements of 2 d.
#
#   bash jobs/sensitivity.sh [directory: results/sensitivity] [-pgran_... options for all]
#
# About ten minutes on two cores. Meshes are the matter of jobs/meshes.sh.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies sensitivity "$@"
