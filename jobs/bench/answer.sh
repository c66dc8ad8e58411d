#!/usr/bin/env bash
# Time to the answer: L = 40 d, I0 = 0.001 to 10 % compression on two ranks, with
# options/biaxial.opts, beside a run with tight tolerances of steps and solvers.
#
#   bash jobs/bench/answer.sh [element sizes: "2 1"] [sizes of tight runs: "2 1"]
#
# Element sizes 2 1 0.5 0.25 take half an hour, tight runs ten times as long as the others.
# Nothing else should run meanwhile.
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
exec "$python" -m studies bench answer "$@"
