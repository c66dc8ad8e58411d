#!/usr/bin/env bash
# Run or resume a study: bash jobs/study.sh NAME [arguments] [options of its runs]
# Without a name it lists the studies. NAME -help explains one, and "all" runs them in order.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies "$@"
