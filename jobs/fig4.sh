#!/usr/bin/env bash
# Figure 4: L = 20, 40 and 60 d at 10 % compression. Usage: bash jobs/fig4.sh
# Elements of d/2 as in the paper; about 15 minutes on two cores, the run of figure 3 being there.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies section4 fig4 "$@"
