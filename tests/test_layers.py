"""What the contracts in pyproject.toml leave open: no two files import each other, and instruments have doors."""

from graphlib import CycleError, TopologicalSorter

import grimp
import pytest
from places import ROOT

TOOLS = "gauge_envs.tools."


@pytest.fixture(scope="module")
def edges():
    """Modules of the package that each module imports: at the top, in functions, and for type checkers alone."""
    graph = grimp.build_graph("gauge_envs", cache_dir=None)
    return {
        name: graph.find_modules_directly_imported_by(name) for name in graph.modules
    }


def past_doors(edges):
    """Return imports of a module inside another instrument.

    The bench has no door: its scenes and measurements are there for all of them.
    """
    found = []
    for one in (ROOT / "gauge_envs/tools").iterdir():
        if one.name == "bench":
            continue
        folder = f"{TOOLS}{one.name}"
        for name, imported in edges.items():
            if not name.startswith(TOOLS) or f"{name}.".startswith(f"{folder}."):
                continue
            found += [
                (name, target) for target in imported if target.startswith(f"{folder}.")
            ]
    return found


def test_no_two_files_import_each_other(edges):
    TopologicalSorter(edges).prepare()


def test_an_instrument_is_used_through_its_door(edges):
    assert past_doors(edges) == []


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


def test_a_planted_import_past_a_door_is_found(edges):
    planted = ("gauge_envs.tools.sweep.plan", "gauge_envs.tools.compare.ranks")
    assert past_doors({**edges, planted[0]: {planted[1]}}) == [planted]
