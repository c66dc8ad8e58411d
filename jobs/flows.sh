#!/usr/bin/env bash
# Steady flows beside their one-dimensional references, and their pictures (docs/flows.md).
#
#   bash jobs/flows.sh [directory: results/flows] [-pgran_... options for all]
#
# About ten minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies flows "$@"
