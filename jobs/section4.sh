# The runs of section 4, which several figures share; sourced by their scripts.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
results=${PGRAN_RESULTS:-results/section4}

ngf() {  # ngf WIDTH I0 ELEMENT_SIZE: the run to 10 %, that of figure 3 to 14 %
    local end=0.10 at=0.05,0.10
    [[ "$1 $2 $3" == "40 0.001 0.5" ]] && end=0.14 at=0.05,0.10,0.14
    run "$results/ngf_L$1_I$2_h$3.h5" options/biaxial.opts -pgran_width "$1" \
        -pgran_inertial_number "$2" -pgran_element_size "$3" -pgran_compression $end \
        -pgran_snapshots $at
}
