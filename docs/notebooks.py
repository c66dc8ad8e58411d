"""Write each example as a notebook beside it: python docs/notebooks.py

A cell of a script begins with ``# %%``, one of text with ``# %% [markdown]``.
"""

import json
import re
from pathlib import Path

EXAMPLES = Path(__file__).parent / "examples"


def notebook(text):
    """Return the notebook of a script in cells, a dictionary."""
    cells = []
    for number, part in enumerate(re.split(r"^# %%", text, flags=re.MULTILINE)[1:]):
        head, _, body = part.partition("\n")
        lines = body.strip().splitlines(keepends=True)
        if "[markdown]" in head:
            lines = [re.sub(r"^# ?", "", line) for line in lines]
            cells.append({"cell_type": "markdown", "id": f"cell-{number}", "metadata": {},
                          "source": lines})
        else:
            cells.append({"cell_type": "code", "id": f"cell-{number}", "metadata": {},
                          "execution_count": None, "outputs": [], "source": lines})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def written(script):
    """Return the text of the notebook of a script's path."""
    return json.dumps(notebook(script.read_text()), indent=1) + "\n"


def scripts():
    """Return the examples that are scripts in cells, a list of paths."""
    return [path for path in sorted(EXAMPLES.glob("*.py")) if "# %%" in path.read_text()]


if __name__ == "__main__":
    for path in scripts():
        path.with_suffix(".ipynb").write_text(written(path))
        print(path.with_suffix(".ipynb").relative_to(EXAMPLES.parents[1]))
