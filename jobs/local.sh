#!/usr/bin/env bash
# From a fresh Debian 12 machine to a result with one command:
#
#   bash jobs/local.sh setup     packages and .venv
#   bash jobs/local.sh run       the biaxial job: results/biaxial.h5, .xdmf and pictures
#   bash jobs/local.sh test      the tests
#   bash jobs/local.sh figures   the figures of the linear theory: results/figures/fig*.png and .h5
#
# Each call sets up what is missing and skips what is in place. PGRAN_RANKS (2) is the
# number of ranks of a run. Two packages beyond the obvious: OpenBLAS makes MUMPS several times
# faster than the reference BLAS, OSMesa draws without a screen.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

packages=(python3-petsc4py python3-slepc4py python3-mpi4py python3-h5py-mpi mpi-default-bin
          python3-venv libopenblas0-pthread libosmesa6)
modules=(setuptools wheel "numpy<2" pyvista matplotlib pytest sympy)

export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMP_NUM_THREADS=1
export OMPI_MCA_rmaps_base_oversubscribe=1  # more ranks than cores, if asked for

setup() {
    local missing=() package root=()
    for package in "${packages[@]}"; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q "ok installed" \
            || missing+=("$package")
    done
    if ((${#missing[@]})); then
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
    fi
    local wanted
    wanted="$(pwd) ${modules[*]} $(sha256sum setup.cfg)"
    [[ -f .venv/pgran-ready && "$(cat .venv/pgran-ready)" == "$wanted" ]] && return
    echo "pgran: making .venv"
    rm -rf .venv
    /usr/bin/python3 -m venv --system-site-packages .venv
    # Debian keeps petsc4py and slepc4py beside their libraries: tell the venv where.
    local name
    for name in petsc4py slepc4py; do
        dpkg -L $(dpkg-query -W -f '${Package}\n' "python3-$name-real*") \
            | grep -E "/dist-packages/$name/__init__\.py$" | sed 's|/[^/]*/__init__.py$||'
    done | sort -u > "$(echo .venv/lib/python3*/site-packages)/debian-petsc.pth"
    .venv/bin/pip install --quiet --disable-pip-version-check "${modules[@]}"
    # Without dependencies: mpi4py and the h5py with MPI are Debian's.
    .venv/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    echo "$wanted" > .venv/pgran-ready
}

finished() {
    [[ -f results/$1.h5 && results/$1.h5 -nt options/$1.opts ]] \
        && .venv/bin/python -c 'import h5py, sys; sys.exit(not h5py.File(sys.argv[1]).attrs.get("complete", False))' \
            "results/$1.h5"
}

run() {
    if finished biaxial; then
        echo "pgran: results/biaxial.h5 is in place"
    else
        mpiexec -n "${PGRAN_RANKS:-2}" .venv/bin/python -m pgran -options_file options/biaxial.opts
    fi
    .venv/bin/python -m pgran.measure results/biaxial.h5
    [[ results/biaxial_0001.png -nt results/biaxial.h5 ]] \
        || .venv/bin/python -m pgran.plot results/biaxial.h5
}

case "${1:-}" in
    setup) setup ;;
    run) setup; run ;;
    figures) setup; .venv/bin/python -m pgran.figures fig1 fig2 fig8 fig9 ;;
    test) setup; shift; exec .venv/bin/python -m pytest "$@" ;;
    *) sed -n '2,11s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 1 ;;
esac
