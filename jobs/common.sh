# Common part of the scripts. If PGRAN_PYTHON names a Python with PETSc, as on a cluster, nothing is
# installed. Runs start with PGRAN_LAUNCH (mpiexec -n PGRAN_RANKS) on PGRAN_RANKS (2) ranks.
# shellcheck shell=bash disable=SC2034
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMP_NUM_THREADS=1
export OMPI_MCA_rmaps_base_oversubscribe=1  # more ranks than cores
export PYTHONPATH=$PWD/jobs${PYTHONPATH:+:$PYTHONPATH}  # of the studies
python=${PGRAN_PYTHON:-.venv/bin/python}

set_up() {
    [[ -n ${PGRAN_PYTHON:-} ]] || bash jobs/local.sh setup
}

is_ready() {  # whether directory $1 was made with the requirements $2
    [[ -f $1/pgran-ready && "$(cat "$1/pgran-ready")" == "$2" ]]
}

install_packages() {  # the Debian packages that are missing
    local missing=() package root=()
    for package in "$@"; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q "ok installed" \
            || missing+=("$package")
    done
    ((${#missing[@]})) || return 0
    echo "pgran: missing Debian packages: ${missing[*]}"
    if (($(id -u))); then
        command -v sudo >/dev/null || {
            echo "pgran: error: they need root, and there is no sudo" >&2
            exit 1
        }
        echo "pgran: sudo is needed to install them"
        root=(sudo)
    fi
    "${root[@]}" apt-get update -qq
    "${root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends "${missing[@]}"
}
