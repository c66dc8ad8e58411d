"""Print the tables of all options in Markdown: python -m pgran.cases"""

from ..options import markdown
from . import KINDS

print(markdown(KINDS), end="")
