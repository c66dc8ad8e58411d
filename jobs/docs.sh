#!/usr/bin/env bash
# The pages of docs/ as a site, results/site/index.html, with no warning and no broken link.
#
#   bash jobs/docs.sh [links]
#
# Sphinx and MyST-NB are installed in .venv-docs. With links, those to other sites are followed too.
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

modules=(sphinx myst-nb furo numpy scipy h5py matplotlib)
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
