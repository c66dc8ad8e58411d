#!/usr/bin/env bash
# The spectra by SLEPc beside the theory: the plane of wave vectors of figures 1(a) and 1(b), both
# laws over the inertial number, and the finite specimen over its size, the inertial number and the
# mesh.
# Tables go to results/spectra_*.csv and results/spectra.txt.
# Usage: bash jobs/spectra.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
set_up
mkdir -p results
exec > >(tee results/spectra.txt)

eigen() {
    mpiexec -n "${PGRAN_RANKS:-2}" $python -m pgran.eigen -options_file options/eigen.opts "$@"
}

for model in ngf li; do
    echo "== $model over the plane of wave vectors, Jop law, I0 = 0.001"
    eigen -pgran_model "$model" -pgran_law jop -pgran_output "results/spectra_$model.h5" \
        -sweep 8 -sweep_end 0.19 -eps_nev 4
done

echo "== fastest mode over the inertial number: I0, law, computed, analytic, relative error"
for law in bingham jop; do
    for number in 1e-4 1e-3 3e-3 1e-2; do
        eigen -pgran_law "$law" -pgran_inertial_number "$number" -pgran_cell_elements 32 \
            -eps_nev 1 -json | $python -c "
import json, sys
row = json.load(sys.stdin)[0]
print(f'  $number  $law  {row[\"computed\"]:.8g}  {row[\"analytic\"]:.8g}  {row[\"relative_error\"]:.2e}')"
    done
done

echo "== one wave vector each: model, I0, wave vector, computed, analytic, relative error (Jop law)"
one() {
    local target
    target=$($python -m pgran.stability -pgran_law jop -pgran_model "$1" \
        -pgran_inertial_number "$2" -wave_vector "$3" -json | $python -c \
        "import json, sys; print(0.999 * json.load(sys.stdin)['growth_rate_gdot0'])")
    eigen -pgran_law jop -pgran_model "$1" -pgran_inertial_number "$2" -wave_vector "$3" \
        -target "$target" -pgran_cell_elements 32 -eps_nev 2 -json | $python -c "
import json, sys
rows = json.load(sys.stdin)
row = min(rows, key=lambda row: abs(row['analytic'] * 0.999 - $target))
print(f'  $1  $2  $3  {row[\"computed\"]:.8g}  {row[\"analytic\"]:.8g}  {row[\"relative_error\"]:.2e}')"
}
for model in ngf li; do
    for number in 1e-4 1e-3 1e-2 0.1 1; do one "$model" "$number" 0.10,0.03; done
done
for vector in 0.0325,0.0265 0.065,0.053 0.13,0.106 0.26,0.212; do one li 1e-3 "$vector"; done

echo "== the specimen on its frozen initial mesh: I0, L (d), element (d), modes found to grow, leading ones"
specimen() {
    eigen -pgran_case biaxial -pgran_inertial_number "$1" -pgran_width "$2" \
        -pgran_element_size "$3" -json | $python -c "
import json, sys
rows = json.load(sys.stdin)
growing = sum(row['computed'] > 0 for row in rows)
shown = ', '.join(f'{row[\"computed\"]:.4g}' + (f'{row[\"imaginary\"]:+.4g}i' if row['imaginary'] else '')
                  for row in rows[:4])
print(f'  $1  {$2:3d}  $3  {growing:3d}  {shown}', flush=True)"
}
for width in 20 40 80 160; do specimen 1e-3 $width 4; specimen 1e-3 $width 2; done
specimen 1e-3 320 8
specimen 1e-3 320 4
for number in 1e-4 1e-2; do for width in 20 40 80 160; do specimen $number $width 4; done; done
