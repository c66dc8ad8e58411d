# What the benches share; sourced by them. Sets up, and leaves the states they start from in
# results/bench/states.h5: 0.3 % (before localisation), 1.8 % (during), 3 %, 5 % and 10 % (after).
source "$(dirname "${BASH_SOURCE[0]}")/../common.sh"
set_up
bench=results/bench

answer() {  # answer RANKS NAME OPTIONS...: a whole run, once
    local ranks=$1 name=$2
    shift 2
    PGRAN_RANKS=$ranks run "$bench/$name.h5" options/biaxial.opts -pgran_progress quiet "$@" >&2
}

step() {  # step RANKS NAME OPTIONS...: one step from a state; its line of JSON
    local ranks=$1 name=$2
    shift 2
    timeout 1800 mpiexec -n "$ranks" $python jobs/bench/one_step.py \
        -options_file options/biaxial.opts -pgran_progress quiet -from $bench/states.h5 \
        -name "$name" "$@"
}

answer 2 states -pgran_snapshots 0.003,0.018,0.03,0.05,0.10
