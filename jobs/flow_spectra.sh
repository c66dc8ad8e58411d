#!/usr/bin/env bash
# Spectra about steady flows, and the same rates in the nonlinear solver (docs/flows.md).
#
#   bash jobs/flow_spectra.sh [directory: results/flow_spectra] [-pgran_... options for all]
#
# About three minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies flow_spectra "$@"
