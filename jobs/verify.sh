#!/usr/bin/env bash
# How far the answer of the main job depends on what the paper does not state: stiffer elasticity,
# half the element size, smaller steps, a larger inertial number.
#
#   bash jobs/verify.sh [directory: results/verify]
#
# About 3 minutes on two cores. It fails where the answer moves beyond its limits.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies verify "$@"
