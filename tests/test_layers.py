"""The package is a stack of layers: every import statement points down, and no two files import each other."""

from __future__ import annotations

import ast
import shutil
import tomllib
from collections.abc import Mapping
from functools import cache

import pytest
from places import ROOT

PACKAGE = "gauge_envs"

CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "tool"
]["importlinter"]["contracts"]
LAYERS = (
    *(tuple(line.split(" | ")) for line in reversed(CONTRACTS[0]["layers"])),
    ("",),
)
"""First-level modules, lowest first; those of one layer do not import each other. The last is the package itself."""

RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
ENTRY_LIMIT = 16

Edges = Mapping[str, set[str]]


def modules(root):
    """Every module of the package in a folder, by its dotted name."""
    files = sorted((root / PACKAGE).rglob("*.py"))
    return {
        ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(
            ".__init__"
        ): file
        for file in files
    }


def import_edges(root):
    """Modules of the package that each module imports: at the top, in functions, and for type checkers alone."""
    found = modules(root)
    return {
        name: set(_imported(name, file, found)) - {name} for name, file in found.items()
    }


def _imported(name, file, found):
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for level, module, names in _statements(file.read_text(encoding="utf-8")):
        parents = (
            package.split(".")[: len(package.split(".")) - level + 1] if level else []
        )
        base = ".".join([*parents, *([module] if module else [])])
        targets = [
            f"{base}.{one}" if f"{base}.{one}" in found else base for one in names
        ] or [base]
        yield from (target for target in targets if target in found)


@cache
def _statements(text):
    """Every import in a file: dots before the module, the module, and the names that are taken from it."""
    statements = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            statements += [(0, alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            statements.append(
                (
                    node.level,
                    node.module or "",
                    tuple(alias.name for alias in node.names),
                )
            )
    return tuple(statements)


def first_level(name):
    return name.split(".")[1] if "." in name else ""


def cycles(edges):
    """Sets of modules that can reach each other through imports."""
    reach = {}
    for start in edges:
        seen = set()
        waiting = [start]
        while waiting:
            new = edges[waiting.pop()] - seen
            seen |= new
            waiting.extend(new)
        reach[start] = seen
    groups = {
        frozenset({other for other in reach[name] if name in reach[other]})
        for name in edges
    }
    return sorted(sorted(group) for group in groups if group)


def not_downward(edges):
    """Imports between first-level modules that do not point to a lower layer."""
    between = {
        (a, b)
        for a, targets in edges.items()
        for b in targets
        if first_level(a) != first_level(b)
    }
    return sorted(
        f"{a} imports {b}"
        for a, b in between
        if RANK[first_level(b)] >= RANK[first_level(a)]
    )


def entries(root):
    """Modules and packages on the first level."""
    files = (root / PACKAGE).iterdir()
    return {
        file.stem
        for file in files
        if file.suffix == ".py" or (file / "__init__.py").is_file()
    }


def test_no_two_files_import_each_other():
    assert cycles(import_edges(ROOT)) == []


def test_every_import_points_to_a_lower_layer():
    assert not_downward(import_edges(ROOT)) == []


def test_the_first_level_is_small_and_has_a_place_in_the_stack():
    assert entries(ROOT) - {"__init__"} == set(RANK) - {""}
    assert len(entries(ROOT)) <= ENTRY_LIMIT


def past_doors(edges):
    """Imports of a module inside another instrument; only the door of its folder is for others.

    The bench declares no instrument: its scenes and measurements are there for all of them.
    """
    instruments = {
        file.parent.name
        for file in (ROOT / PACKAGE / "tools").glob("*/instrument.toml")
    }
    found = []
    for name, targets in edges.items():
        for target in targets:
            inside = (
                target.split(".")[1] == "tools"
                and target.count(".") > 2
                and target.split(".")[2] in instruments
            )
            if (
                inside
                and name.split(".")[:3] != target.split(".")[:3]
                and first_level(name) == "tools"
            ):
                found.append(f"{name} imports {target}")
    return sorted(found)


def test_an_instrument_is_used_through_its_door():
    assert past_doors(import_edges(ROOT)) == []


# --- planted faults: the checks above find them ---


@pytest.fixture
def copy(tmp_path):
    shutil.copytree(
        ROOT / PACKAGE, tmp_path / PACKAGE, ignore=shutil.ignore_patterns("__pycache__")
    )
    return tmp_path


def plant(root, file, text):
    path = root / PACKAGE / file
    path.write_text(f"{path.read_text(encoding='utf-8')}\n{text}\n", encoding="utf-8")
    return import_edges(root)


@pytest.mark.parametrize(
    "statement",
    [
        "import gauge_envs.cli.app",
        "from gauge_envs.cli import app",
        "from ..cli import app",
        "def later():\n    from gauge_envs.cli.app import main",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from gauge_envs.cli import app",
    ],
    ids=["module", "name", "relative", "function", "types"],
)
def test_an_upward_import_is_found(copy, statement):
    edges = plant(copy, "pages/html.py", statement)
    assert not_downward(edges) == ["gauge_envs.pages.html imports gauge_envs.cli.app"]
    assert any(
        {"gauge_envs.pages.html", "gauge_envs.cli.app"} <= set(group)
        for group in cycles(edges)
    )


def test_an_import_of_the_package_itself_is_found(copy):
    edges = plant(copy, "envs/env.py", "from gauge_envs import variants")
    assert not_downward(edges) == ["gauge_envs.envs.env imports gauge_envs"]


def test_an_import_within_a_layer_is_found(copy):
    edges = plant(
        copy, "references/tables.py", "from gauge_envs.backends import registry"
    )
    assert not_downward(edges) == [
        "gauge_envs.references.tables imports gauge_envs.backends.registry"
    ]


def test_a_cycle_within_a_package_is_found(copy):
    (copy / PACKAGE / "scene" / "first.py").write_text(
        "from gauge_envs.scene import second\n", encoding="utf-8"
    )
    (copy / PACKAGE / "scene" / "second.py").write_text(
        "def later():\n    import gauge_envs.scene.first\n", encoding="utf-8"
    )
    assert ["gauge_envs.scene.first", "gauge_envs.scene.second"] in cycles(
        import_edges(copy)
    )


def test_an_import_past_a_door_is_found(copy):
    edges = plant(
        copy,
        "tools/site/build.py",
        "from gauge_envs.tools.diagnose import error_budget",
    )
    assert past_doors(edges) == [
        "gauge_envs.tools.site.build imports gauge_envs.tools.diagnose.error_budget"
    ]


def test_an_entry_without_a_layer_is_found(copy):
    (copy / PACKAGE / "utils.py").touch()
    assert entries(copy) - {"__init__"} != set(RANK) - {""}
