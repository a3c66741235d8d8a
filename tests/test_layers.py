"""Layers beyond the contracts in pyproject.toml: no import cycles, and imports of tools only through their package."""

from graphlib import CycleError, TopologicalSorter

import grimp
import pytest
from places import ROOT

TOOLS = "gauge_envs.tools."


@pytest.fixture(scope="module")
def edges():
    """Modules of the package that each module imports at the top, in functions, or only for type checkers."""
    graph = grimp.build_graph("gauge_envs", cache_dir=None)
    return {
        name: graph.find_modules_directly_imported_by(name) for name in graph.modules
    }


def inner_imports(edges):
    """Return imports of a module inside another tool."""
    imports = []
    for folder in (ROOT / "gauge_envs/tools").iterdir():
        package = f"{TOOLS}{folder.name}"
        for name, imported in edges.items():
            if not name.startswith(TOOLS) or f"{name}.".startswith(f"{package}."):
                continue
            imports += [
                (name, target)
                for target in imported
                if target.startswith(f"{package}.")
            ]
    return imports


def test_no_two_files_import_each_other(edges):
    TopologicalSorter(edges).prepare()


def test_a_tool_is_imported_through_its_package(edges):
    assert inner_imports(edges) == []


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        ("gauge_envs.pages.html", "gauge_envs.cli.app"),
        ("gauge_envs.scene.pose", "gauge_envs.scene.scene"),
    ],
)
def test_a_planted_cycle_is_found(edges, importer, imported):
    planted = {**edges, imported: {importer}, importer: {imported}}
    with pytest.raises(CycleError):
        TopologicalSorter(planted).prepare()


def test_a_planted_import_of_an_inner_module_is_found(edges):
    planted = ("gauge_envs.tools.recipes.report", "gauge_envs.tools.compare.ranks")
    assert inner_imports({**edges, planted[0]: {planted[1]}}) == [planted]
