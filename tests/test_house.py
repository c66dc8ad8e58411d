"""The folders know what they should: imports go one way, and names stay in their rooms."""

import ast
import re

import pytest
from conftest import ROOT

PACKAGE = ROOT / "pgran"
#: Each folder may import only from itself and from those before it; commands come last.
ORDER = ["options", "material", "theory", "cases", "signals", "versions", "cli", "space", "output",
         "solve", "runs"]
FILES = sorted(path for path in PACKAGE.rglob("*.py"))


def room(path):
    """The folder or module of the house that a file belongs to."""
    first = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    return first if first in ORDER else "commands"


def imported(path):
    """Yield the modules that a file imports, as dotted names."""
    package = ["pgran", *path.relative_to(PACKAGE).parent.parts]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[:len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_one_way(path):
    here = room(path)
    for name in imported(path):
        parts = name.split(".")
        if parts[0] != "pgran" or len(parts) == 1:
            continue
        there = parts[1]
        if here == "commands" or there.startswith("__"):
            continue
        assert there in ORDER, f"{name} is a command"
        assert ORDER.index(there) <= ORDER.index(here), f"{here} imports {name}"


@pytest.mark.parametrize("folder, more", [("material", set()), ("theory", {"scipy"})])
def test_material_is_numpy_alone_and_theory_numpy_and_scipy(folder, more):
    for path in (PACKAGE / folder).rglob("*.py"):
        roots = {name.split(".")[0] for name in imported(path)}
        assert roots <= {"pgran", "numpy", "dataclasses", "abc", "functools", "math", *more}, path


def literals(path):
    """Yield the text constants of a file that are no docstrings."""
    tree = ast.parse(path.read_text())
    docstrings = {id(node.body[0].value) for node in ast.walk(tree)
                  if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
                  and node.body and isinstance(node.body[0], ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) \
                and id(node) not in docstrings:
            yield node.value


@pytest.mark.parametrize("folder", ["material", "theory", "cases", "space", "output", "solve"])
def test_the_library_does_not_know_what_an_option_is_called(folder):
    for path in (PACKAGE / folder).rglob("*.py"):
        for text in literals(path):
            assert not re.search(r"-(pgran|ts|snes|ksp|pc|eps|st)_", text), (path, text)


def test_the_specimen_is_known_in_its_own_file_only():
    words = {"compression", "top_stress", "plates_slip", "imperfection_size",
             "imperfection_mirrored", "biaxial"}
    for folder in ("material", "cases", "space", "solve"):
        for path in (PACKAGE / folder).rglob("*.py"):
            if path.name == "biaxial.py":
                continue
            names = {node.attr for node in ast.walk(ast.parse(path.read_text()))
                     if isinstance(node, ast.Attribute)}
            assert not words & (names | set(literals(path))), path
    for name in ("writer", "terminal", "band", "pictures"):
        assert not words & set(literals(PACKAGE / "output" / f"{name}.py")), name
    assert not words & (set(literals(PACKAGE / "__main__.py")) | set(literals(PACKAGE / "cli.py")))


def test_sizes_of_elements_have_names():
    for folder in ("space", "solve", "output", "material", "cases"):
        for path in (PACKAGE / folder).rglob("*.py"):
            numbers = {node.value for node in ast.walk(ast.parse(path.read_text()))
                       if isinstance(node, ast.Constant) and type(node.value) is int}
            found = numbers & {18, 27, 31}
            assert not found, (path, found)
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, (ast.Slice, ast.Subscript)):
                    inside = {n.value for n in ast.walk(node) if isinstance(n, ast.Constant)}
                    assert 9 not in inside, path


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_words_that_could_be_confused_are_gone(path):
    names = {node.id for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, ast.Name)}
    assert not names & {"settings", "setting", "Settings", "Step"}
