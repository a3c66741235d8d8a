"""The metadata declares every import of the package, and every requirement has a lower bound."""

from __future__ import annotations

import ast
import sys
import tomllib

import pytest
from packaging.requirements import Requirement
from places import ROOT

from gauge_envs.cli.commands import all_commands

PACKAGE = ROOT / "gauge_envs"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

DISTRIBUTION = {
    "mcap_ros2": "mcap-ros2-support",
    "mpl_toolkits": "matplotlib",
    "cv2": "opencv-python-headless",
    "PIL": "pillow",
    "genesis": "genesis-world",
    "pydrake": "drake",
    "pxr": "usd-core",
    "pybullet_utils": "pybullet",
    "warp": "warp-lang",
    "yaml": "pyyaml",
}
"""Distributions whose module has another name."""


NOT_OF_USERS = {"dev", "docs"}
"""Extras of development and guides, which the package does not import."""


def canonical(name):
    return name.lower().replace("_", "-")


def declared(requirements):
    names = {canonical(Requirement(requirement).name) for requirement in requirements}
    return names - {canonical(PROJECT["name"])}


BASE = declared(PROJECT["dependencies"])
EXTRAS = {
    extra: declared(requirements)
    for extra, requirements in PROJECT["optional-dependencies"].items()
    if extra not in NOT_OF_USERS
}


ELSEWHERE = {
    "tools/sanity/readers/gauge_probe.py": {"mjlab"},
    "rendering/window.py": {"glfw"},
    "pytest_plugin.py": {"pytest"},
}
"""Imports of programs that run in a training stack and in pytest, and of a package that MuJoCo installs."""


def imported(text):
    """Distributions that a file imports: all, and those at its top level."""
    everything, at_once = set(), set()
    waiting = [(ast.parse(text), False)]
    while waiting:
        node, is_later = waiting.pop()
        is_later = (
            is_later
            or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            or _for_types(node)
        )
        waiting += [(inner, is_later) for inner in ast.iter_child_nodes(node)]
        if isinstance(node, ast.Import):
            tops = {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            tops = {str(node.module).partition(".")[0]}
        else:
            continue
        names = {
            canonical(DISTRIBUTION.get(top, top))
            for top in tops - sys.stdlib_module_names - {"gauge_envs"}
        }
        everything |= names
        at_once |= set() if is_later else names
    return everything, at_once


def _for_types(node):
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


@pytest.fixture(scope="module")
def files():
    """Imports of each file of the package, see `imported`."""
    return {
        file.relative_to(PACKAGE).as_posix(): imported(file.read_text())
        for file in PACKAGE.rglob("*.py")
    }


def test_every_import_is_of_a_declared_dependency(files):
    allowed = BASE.union(*EXTRAS.values())
    undeclared = {}
    for file, (names, _) in files.items():
        unknown = names - allowed - ELSEWHERE.get(file, set())
        if unknown:
            undeclared[file] = unknown
    assert undeclared == {}


def test_extras_are_imported_at_first_use(files):
    extras = set().union(*EXTRAS.values()) - BASE
    declared = {
        f"tools/{command.point.module.split('.')[2]}/": EXTRAS[command.info.extra]
        for command in all_commands().values()
        if command.info.extra
    } | {"formats/usd/": EXTRAS["usd"]}
    at_once = {
        file: used
        for file, (_, names) in files.items()
        if (used := names & extras - declared.get(_folder(file), set()))
    }
    own = (
        "backends/drake/",
        "backends/genesis/",
        "backends/newton/",
        "backends/physx/",
        "backends/pybullet/",
        "backends/rapier/",
        "envs/dm_env.py",
        "pages/figures.py",
        "tools/compare/",
    )
    assert {
        file: names for file, names in at_once.items() if not file.startswith(own)
    } == {}


def _folder(file):
    return file.rpartition("/")[0] + "/"


def test_every_requirement_has_a_lower_bound():
    extras = [
        requirement
        for requirements in PROJECT["optional-dependencies"].values()
        for requirement in requirements
    ]
    requirements = [Requirement(text) for text in (*PROJECT["dependencies"], *extras)]
    without = [
        str(requirement)
        for requirement in requirements
        if requirement.name != PROJECT["name"]
        and not any(bound.operator == ">=" for bound in requirement.specifier)
    ]
    assert without == []
