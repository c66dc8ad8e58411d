#!/usr/bin/env bash
# Mesh independence for a weak square of fixed size, 2 d: what is left of the differences in figures
# 6 and 7 when the imperfection does not shrink with the elements.
#
#   bash jobs/meshes.sh [element sizes for NGF: 2 1 0.5] [for LI: 2 1 0.5]
#
# Prints the difference of I between successive meshes, over its L2 norm and its maximum, and the
# observed order. About fifteen minutes on two cores.
source "$(dirname "${BASH_SOURCE[0]}")/section4.sh"
for model in ngf li; do
    file=options/biaxial.opts sizes=${1:-2 1 0.5} names=()
    [[ $model == li ]] && file=options/li.opts sizes=${2:-2 1 0.5}
    for size in $sizes; do
        names+=("$results/${model}_square_h$size.h5")
        run "${names[-1]}" $file -pgran_imperfection_size 2 -pgran_element_size "$size"
    done
    $python -m pgran.measure -meshes "${names[@]}"
done
