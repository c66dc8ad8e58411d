#!/usr/bin/env bash
# Figure 5: I0 = 0.001, 0.007 and 0.03 at 10 % compression. Usage: bash jobs/fig5.sh
# Elements of d/2 as in the paper; about 5 minutes on two cores, the run of figure 3 being there.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies section4 fig5 "$@"
