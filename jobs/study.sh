#!/usr/bin/env bash
# Run or resume a study: runs of pgran, a measurement of each, and tables and figures.
#
#   bash jobs/study.sh NAME [arguments] [options of its runs]
#   bash jobs/study.sh                    list the studies
#   bash jobs/study.sh NAME -help         describe one
#   bash jobs/study.sh all                run all of them, for several hours
#
# Results go to results/, the tables and figures of the documentation to docs/generated and
# docs/figures. A run that is complete is not repeated.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
PGRAN_DOCS=docs exec "$python" -m studies "$@"
