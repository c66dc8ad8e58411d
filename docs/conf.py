"""How `bash jobs/docs.sh` builds these pages."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import pgran

project, author, release = "pgran", "the pgran authors", pgran.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["examples/*"]
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
default_role = "code"
napoleon_numpy_docstring, napoleon_use_ivar = True, True
autodoc_member_order = "bysource"
# The API is read where no PETSc is: the site needs nothing that a run needs.
autodoc_mock_imports = ["petsc4py", "slepc4py", "mpi4py"]
html_theme = "furo"
html_title = f"pgran {release}"
# Pages link to files of the repository, which are no pages.
suppress_warnings = ["myst.xref_missing"]


def escape_bars(app, what, name, obj, options, lines):
    """Keep the bars of |k|, which docutils would take for a substitution."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def setup(app):
    """Connect what docstrings need."""
    app.connect("autodoc-process-docstring", escape_bars)
