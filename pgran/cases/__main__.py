"""Print the tables of all options in Markdown: python -m pgran.cases"""

import sys

from ..options import markdown
from . import KINDS

if len(sys.argv) > 1:
    sys.exit(f"pgran.cases: error: {sys.argv[1]}: no arguments are allowed")
print(markdown(KINDS), end="")
