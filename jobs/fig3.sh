#!/usr/bin/env bash
# Figure 3: L = 40 d, I0 = 0.001 at 5, 10 and 14 % compression. Usage: bash jobs/fig3.sh
# Elements of d/2 as in the paper; about 7 minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies section4 fig3 "$@"
