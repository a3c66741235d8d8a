"""Layers beyond the contracts in pyproject.toml: no cycles, tools only through their package, no imports by string."""

import ast
import re
from graphlib import TopologicalSorter

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


# --- imports by string -----------------------------------------------------------------------------------------------


PACKAGE = ROOT / "gauge_envs"
FILES = sorted(PACKAGE.rglob("*.py"))
IMPORTERS = {"import_module", "__import__", "resolve_name", "find_spec", "EntryPoint"}
OTHER_PACKAGE = re.compile(r"f?['\"](?!gauge_envs\b)\w")
"""Beginning of a written name of a module that is not of this package, as `f"mujoco.{name}"`."""

BY_NAME = ("gauge_envs/registry.py", "/gauge_probe.py", "/versions/worker.py")
"""Ends of files that import what a table of `lazy_names` names, or what a user names."""


def imports_by_string(text):
    """Return the lines of imports whose module may be of this package."""
    lines = []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Call):
            continue
        function = ast.unparse(node.func).rpartition(".")[2]
        module = ast.unparse(node.args[0]) if node.args else ""
        if function in IMPORTERS and not OTHER_PACKAGE.match(module):
            lines.append(node.lineno)
    return lines


def lazy_table(text):
    """Return the names by module in the table of `lazy_names`; None without a table."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "lazy_names":
            return ast.literal_eval(node.args[1])
    return None


def imports_for_types(text):
    """Return the names by module that a file imports for type checkers alone."""
    imports = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for line in node.body:
                imports[line.module] = sorted(alias.name for alias in line.names)
    return imports


LAZY = [file for file in FILES if lazy_table(file.read_text("utf-8")) is not None]


@pytest.mark.parametrize(
    ("line", "is_seen"),
    [
        ('import_module("gauge_envs.scene")', True),
        ('import_module(f"gauge_envs.{name}")', True),
        ("EntryPoint(name, place, group).load()", True),
        ('import_module(f"mujoco.{name}")', False),
    ],
)
def test_an_import_by_string_is_seen(line, is_seen):
    assert bool(imports_by_string(line)) == is_seen


def test_no_module_of_the_package_is_imported_by_string():
    found = {}
    for file in FILES:
        lines = imports_by_string(file.read_text("utf-8"))
        if lines and not file.as_posix().endswith(BY_NAME):
            found[file.relative_to(PACKAGE).as_posix()] = lines
    assert found == {}


@pytest.mark.parametrize(
    "file", LAZY, ids=lambda file: file.parent.relative_to(ROOT).as_posix()
)
def test_type_checkers_import_what_a_lazy_table_names(file):
    text = file.read_text("utf-8")
    package = ".".join(file.parent.relative_to(ROOT).parts)
    table = {
        package + module if module.startswith(".") else module: sorted(names)
        for module, names in lazy_table(text).items()
    }
    assert imports_for_types(text) == table
