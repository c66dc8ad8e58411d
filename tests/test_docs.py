"""What the pages name exists, the examples run at a tiny size, and the notebooks show them."""

import json
import pkgutil
import re
import runpy
import sys

import matplotlib
import pytest
from conftest import ROOT

import pgran

PAGES = sorted([*ROOT.glob("docs/**/*.md"), ROOT / "README.md"])
COMMANDS = {path.stem for path in (ROOT / "pgran").glob("*.py")} | {"cases", "runs"}
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def anchors(page):
    """The anchors of the headings of a page, as GitHub creates them."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@each_page
def test_links_lead_to_pages_sections_and_files(page):
    text = page.read_text()
    included = re.findall(r"^```\{include\} (\S+)", text, flags=re.MULTILINE)
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    for target in [*included, *re.findall(r"\]\(([^)\s]+)\)", text)]:
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        other = (page.parent / name) if name else page
        assert other.exists(), target
        assert not anchor or anchor in anchors(other), target


def test_every_page_and_notebook_is_in_the_site():
    listed = set(re.findall(r"^([\w/]+)$", (ROOT / "docs/index.md").read_text(), re.MULTILINE))
    pages = {str(path.relative_to(ROOT / "docs").with_suffix("")) for path in
             [*ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/examples/*.ipynb")]}
    assert {page for page in pages if not page.startswith("generated/")} - {"index"} == listed


def test_the_function_of_every_equation_exists():
    model, = ROOT.glob("docs/**/model.md")
    names = re.findall(r"^\| .* \| `(pgran[\w.]+)` \|$", model.read_text(), re.MULTILINE)
    assert len(names) > 15
    for name in names:
        pkgutil.resolve_name(name)


@each_page
def test_commands_and_files_exist(page):
    text = page.read_text()
    commands = re.findall(r"python -m pgran\.(\w+)|\bpgran-(\w+)\b(?![-.\w])", text)
    assert {name for pair in commands for name in pair if name} <= COMMANDS | {"KIND", "ready"}
    files = r"(?<![\w/])(?:jobs|options|docs)/[\w/]+\.(?:sh|py|opts|slurm|def)\b"
    for name in re.findall(files, text):
        assert (ROOT / name).exists(), name


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
    (tmp_path / "results").mkdir()
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
