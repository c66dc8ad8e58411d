"""Source layout: the order of imports, libraries of the physics, and distinct names."""

import ast
from collections import Counter

import pytest
from conftest import ROOT

PACKAGE = ROOT / "pgran"
#: Each package or module imports only from itself and from earlier ones. Commands come last.
ORDER = ["options.errors", "options.definition", "options.loading", "options.parameters",
         "options.files", "options", "kinematics", "material", "theory", "cases", "signals",
         "versions", "cli", "space", "output", "solve", "runs"]
FILES = sorted(PACKAGE.rglob("*.py"))
TREES = {path: ast.parse(path.read_text()) for path in FILES}


def imported(path):
    """Yield the modules that a file imports, as dotted names."""
    package = ["pgran", *path.relative_to(PACKAGE).parent.parts]
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[:len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def position(module):
    """Return the position of a module of pgran in ``ORDER``; commands have the last one."""
    return next((n for n, name in enumerate(ORDER) if f"{module}.".startswith(f"pgran.{name}.")),
                len(ORDER))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_one_way(path):
    here = ".".join(["pgran", *path.relative_to(PACKAGE).with_suffix("").parts])
    for name in imported(path):
        # pgran itself has the version.
        if name.startswith("pgran.") and not name.startswith("pgran.__"):
            assert position(name) <= position(here), f"{here} imports {name}"


@pytest.mark.parametrize("folder", ["material", "theory"])
def test_material_uses_numpy_only_and_theory_numpy_and_scipy(folder):
    allowed = {"pgran", "numpy", "dataclasses", "abc", "functools", "math"}
    for path in (PACKAGE / folder).rglob("*.py"):
        roots = {name.split(".")[0] for name in imported(path)}
        assert roots <= allowed | ({"scipy"} if folder == "theory" else set()), path


def test_names_of_modules_and_classes_are_distinct():
    modules = {name.removesuffix(".py") for path in FILES
               for name in path.relative_to(PACKAGE).parts}
    assert not {name for name in modules if f"{name}s" in modules}
    classes = Counter(node.name for tree in TREES.values() for node in ast.walk(tree)
                      if isinstance(node, ast.ClassDef))
    assert not [name for name, count in classes.items() if count > 1]
