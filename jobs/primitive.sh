#!/usr/bin/env bash
# Does the specimen care which form of NGF it has? The main job with the primitive form, t0 from 1e-4
# to 1 times the time of the growing mode, beside the steady form: growth rates, onset and band.
#
#   bash jobs/primitive.sh ["sizes": "2 1"] [directory: results/primitive] [-pgran_... options]
#
# Some 15 minutes on two idle cores, two thirds of them at elements of d.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
exec "$python" -m studies primitive "$@"
