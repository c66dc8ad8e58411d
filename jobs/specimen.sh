#!/usr/bin/env bash
# Why the specimen localises: theory of the moving specimen beside nonlinear runs.
#
#   bash jobs/specimen.sh [directory: results/specimen]
#
# About a quarter of an hour on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies specimen "$@"
