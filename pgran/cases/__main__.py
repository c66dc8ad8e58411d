"""Print the tables of all options in Markdown: python -m pgran.cases"""

from . import KINDS
from ..options import markdown

print(markdown(KINDS), end="")
