"""Sphinx configuration of the documentation; `bash jobs/docs.sh` builds it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import pgran

project, author, release = "pgran", "the pgran authors", pgran.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["generated/*"]
nb_execution_mode = "off"  # notebooks contain their outputs
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
default_role = "code"
napoleon_numpy_docstring, napoleon_use_ivar = True, True
autodoc_member_order = "bysource"
# The site is built without PETSc.
autodoc_mock_imports = ["petsc4py", "slepc4py", "mpi4py"]
html_theme = "furo"
html_title = f"pgran {release}"
# Pages link to files of the repository that are not pages.
suppress_warnings = ["myst.xref_missing"]


def escape_bars(app, what, name, obj, options, lines):
    """Escape vertical bars, which docutils reads as substitutions."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def setup(app):
    """Register the hook for docstrings."""
    app.connect("autodoc-process-docstring", escape_bars)
