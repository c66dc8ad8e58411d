# What the jobs share; sourced by them from anywhere. PGRAN_RANKS (2) is the number of ranks. Where
# PETSc comes from elsewhere, as on a cluster, PGRAN_PYTHON names the Python to use, nothing is set up,
# and PGRAN_LAUNCH (mpiexec -n PGRAN_RANKS) starts the ranks.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMP_NUM_THREADS=1
export OMPI_MCA_rmaps_base_oversubscribe=1  # more ranks than cores, if asked for
python=${PGRAN_PYTHON:-.venv/bin/python}

set_up() {
    [[ -n ${PGRAN_PYTHON:-} ]] || bash jobs/local.sh setup
}

finished() {  # finished NAME.h5 FILE.opts: whether that run came to its end, with that file
    [[ -f $1 && $1 -nt $2 ]] && $python -c 'import h5py, sys
sys.exit(not h5py.File(sys.argv[1]).attrs.get("complete", False))' "$1"
}

run() {  # run NAME.h5 FILE.opts OPTIONS...: a whole run, unless it was done before
    local output=$1 file=$2
    shift 2
    if finished "$output" "$file"; then
        echo "pgran: $output is in place"
        return
    fi
    ${PGRAN_LAUNCH:-mpiexec -n "${PGRAN_RANKS:-2}"} "$python" -m pgran -options_file "$file" \
        -pgran_output "$output" "$@"
}
