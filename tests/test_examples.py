"""The examples run at a tiny size, and the notebooks agree with the scripts."""

import json
import os
import runpy
import sys

import matplotlib
import pytest
from conftest import ROOT

import pgran
from pgran.runs import sweep

EXAMPLES = ROOT / "docs" / "examples"
#: Options for tiny runs of each example.
TINY = {"band": {"width": 8, "height": 24, "compression": 0.002, "snapshots": [0.001, 0.002]},
        "own_law": {"width": 8, "height": 24, "compression": 0.002, "snapshots": [0.002]},
        "sweep": {"width": 8, "height": 24, "compression": 0.001, "snapshots": [0.001]},
        "band_theory": {}, "stopping_slope": {}}


@pytest.mark.parametrize("name", TINY)
def test_an_example_runs_and_prints_its_result(name, tmp_path, monkeypatch, capsys):
    matplotlib.use("Agg")
    tiny = TINY[name]
    monkeypatch.setattr(pgran, "run", lambda output=None, **given: sweep.run(
        output, **{**given, **tiny}))
    monkeypatch.setattr(pgran, "sweep", lambda parameters, **given: sweep.sweep(
        parameters, **{**given, **tiny}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    os.mkdir("results")
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    text = capsys.readouterr().out
    wanted = {"band": "2 snapshots, complete", "band_theory": "waves longer than 25.4 d grow",
              "own_law": "0.2 % compression: I from", "sweep": "| 0.03 | True |",
              "stopping_slope": "0.9 H_stop: the surface moves at"}
    assert wanted[name] in text
    sys.modules.pop("power_law", None)


def test_notebooks_agree_with_the_scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import notebooks

    paths = notebooks.scripts()
    assert {path.stem for path in paths} == set(TINY)
    for path in paths:
        book = json.loads(path.with_suffix(".ipynb").read_text())
        found = [(cell["cell_type"], cell["source"]) for cell in book["cells"]]
        assert found == notebooks.cells(path.read_text()), path
        assert any(cell.get("outputs") for cell in book["cells"]), path
