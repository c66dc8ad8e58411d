#!/usr/bin/env bash
# The spectra by SLEPc beside the theory: the plane of wave vectors of figures 1(a) and 1(b), both
# laws over the inertial number, and the finite specimen over its size, I0 and mesh.
#
#   bash jobs/spectra.sh [directory: results]
#
# An estimate: a quarter of an hour on two cores, most of it for the specimens of 320 d.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies spectra "$@"
