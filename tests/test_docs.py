"""The pages hold: links lead somewhere, names are in the code, commands and files are there."""

import importlib
import re
from functools import reduce

import pytest
from conftest import ROOT

PAGES = sorted([*ROOT.glob("docs/**/*.md"), ROOT / "README.md"])
COMMANDS = {path.stem for path in (ROOT / "pgran").glob("*.py")} | {"cases", "studies"}


def anchors(page):
    """The anchors of the headings of a page, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_pages_sections_and_files(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        other = (page.parent / name) if name else page
        assert other.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(other), f"{page.name}: {target}"


def test_every_page_and_notebook_is_in_the_site():
    listed = set(re.findall(r"^([\w/]+)$", (ROOT / "docs/index.md").read_text(), re.MULTILINE))
    pages = {str(path.relative_to(ROOT / "docs").with_suffix("")) for path in
             [*ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/examples/*.ipynb")]}
    assert {page for page in pages if not page.startswith("generated/")} - {"index"} == listed


def test_pages_are_short():
    for page in PAGES:
        if page.name not in ("validation.md", "options.md"):
            assert len(page.read_text().splitlines()) <= 250, page.name


def test_every_equation_has_its_place_in_the_code():
    page = (ROOT / "docs/explanation/model.md").read_text()
    rows = re.findall(r"^\| .* \| `(pgran[\w.]+)` \|$", page, re.MULTILINE)
    assert len(rows) > 15
    for name in rows:
        parts = name.split(".")
        for count in range(len(parts), 0, -1):
            try:
                module = importlib.import_module(".".join(parts[:count]))
                break
            except ModuleNotFoundError:
                continue
        reduce(getattr, parts[count:], module)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_files_are_there(page):
    text = page.read_text()
    for name in re.findall(r"python -m pgran\.(\w+)", text):
        assert name in COMMANDS or name == "studies", (page.name, name)
    files = r"(?<![\w/])(?:jobs|options|docs)/[\w/]+\.(?:sh|py|opts|slurm|def)\b"
    for name in re.findall(files, text):
        assert (ROOT / name).exists(), (page.name, name)
    for name in re.findall(r"\bpgran-(\w+)\b(?![-.\w])", text):
        assert name in COMMANDS or name in ("KIND", "ready"), (page.name, name)
