"""The examples run at a tiny size, and the notebooks agree with the scripts."""

import json
import os
import runpy
import sys

import matplotlib
import pytest
from conftest import ROOT

import pgran

EXAMPLES = ROOT / "docs" / "examples"
SMALL = {"width": 8, "height": 24}
#: Options for tiny runs of each example, and what it prints.
TINY = {
    "band": ({**SMALL, "compression": 0.002, "snapshots": [0.001, 0.002]}, "2 snapshots, complete"),
    "own_law": ({**SMALL, "compression": 0.002, "snapshots": [0.002]}, "0.2 % compression: I from"),
    "sweep": ({**SMALL, "compression": 0.001, "snapshots": [0.001]}, "| 0.03 | True |"),
    "band_theory": ({}, "waves longer than 25.4 d grow"),
    "stopping_slope": ({}, "0.9 H_stop: the surface moves at")}


@pytest.mark.parametrize("name", TINY)
def test_an_example_runs_and_prints_its_result(name, tmp_path, monkeypatch, capsys):
    matplotlib.use("Agg")
    tiny, wanted = TINY[name]
    for command in (pgran.run, pgran.sweep):
        monkeypatch.setattr(pgran, command.__name__, lambda first=None, command=command, **given:
                            command(first, **{**given, **tiny}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    os.mkdir("results")
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    assert wanted in capsys.readouterr().out
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
