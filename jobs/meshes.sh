#!/usr/bin/env bash
# Mesh independence for a weak square of fixed size, 2 d.
#
#   bash jobs/meshes.sh [element sizes for NGF: "2 1 0.5"] [for LI: "2 1 0.5"]
#
# About fifteen minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies meshes "$@"
