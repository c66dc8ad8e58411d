"""Documentation: links, equations, commands and files that the pages name exist."""

import pkgutil
import re

import pytest
from conftest import ROOT

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
