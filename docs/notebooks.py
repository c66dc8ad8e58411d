"""Run each example and store it with its outputs as a notebook: python docs/notebooks.py

A code cell of a script begins with ``# %%``, a text cell with ``# %% [markdown]``. Run this command
from the repository.
"""

import base64
import contextlib
import io
import json
import re
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parent / "examples"


def scripts():
    """Return the paths of the examples with cells."""
    return [path for path in sorted(EXAMPLES.glob("*.py")) if "# %%" in path.read_text()]


def cells(text):
    """Return the cells of a script as a list of (type, source)."""
    found = []
    for part in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        body = body.strip()
        if "[markdown]" in head:
            found.append(("markdown", re.sub(r"^# ?", "", body, flags=re.MULTILINE)))
        else:
            found.append(("code", body))
    return found


def outputs(code, namespace):
    """Run a code cell; return its printed text and its figures as outputs of a notebook."""
    from matplotlib import pyplot

    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        exec(compile(code, "<cell>", "exec"), namespace)
    text = stream.getvalue().replace(f"{Path.cwd()}/", "")
    found = [{"output_type": "stream", "name": "stdout", "text": text}] if text else []
    for number in pyplot.get_fignums():
        picture = io.BytesIO()
        pyplot.figure(number).savefig(picture, format="png", dpi=80)
        found.append({"output_type": "display_data", "metadata": {},
                      "data": {"image/png": base64.b64encode(picture.getvalue()).decode()}})
    pyplot.close("all")
    return found


def notebook(text):
    """Run a script and return its notebook, a dictionary."""
    namespace, book = {}, []
    for number, (kind, source) in enumerate(cells(text)):
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": source}
        if kind == "code":
            cell.update(execution_count=None, outputs=outputs(source, namespace))
        book.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": book, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


if __name__ == "__main__":
    import matplotlib

    matplotlib.use("Agg")
    sys.path.insert(0, str(EXAMPLES))
    Path("results").mkdir(exist_ok=True)
    for path in scripts():
        target = path.with_suffix(".ipynb")
        target.write_text(json.dumps(notebook(path.read_text()), indent=1) + "\n")
        print(target.name)
