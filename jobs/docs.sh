#!/usr/bin/env bash
# Build the documentation, results/site/index.html, with warnings as errors: bash jobs/docs.sh [links]
# Sphinx and MyST are installed in .venv-docs. With "links", external links are checked too.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

modules=(sphinx myst-parser furo numpy h5py matplotlib)
wanted="$(pwd) ${modules[*]}"
if ! is_ready .venv-docs "$wanted"; then
    install_packages python3-venv
    rm -rf .venv-docs
    /usr/bin/python3 -m venv .venv-docs
    .venv-docs/bin/pip install --quiet --disable-pip-version-check "${modules[@]}"
    echo "$wanted" > .venv-docs/pgran-ready
fi
.venv-docs/bin/python -m sphinx -W --keep-going -q -b html docs results/site
[[ ${1:-} != links ]] || .venv-docs/bin/python -m sphinx -q -b linkcheck docs results/site/links
echo "results/site/index.html"
