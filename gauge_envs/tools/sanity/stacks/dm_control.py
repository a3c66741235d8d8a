"""Tasks of dm_control's suite by name, without importing dm_control.

The package needs a MuJoCo of its own version. Its XML files do not, so they are read from its folder.
"""

import ast
from dataclasses import replace
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.python_source.source import package_folder, package_version, source_tree
from gauge_envs.tools.sanity.stacks.mjcf import read_model_file
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader, has_start

PREFIX = "dm_control:"
"""Start of the name of a task."""

PACKAGE = "dm_control"

REGISTER = "SUITE.add"
"""Decorator with which a domain registers a task."""

XML_EDITORS = ("etree", "xml_tools")
"""Names in a domain's code that show that it changes its XML before it loads it."""


def _read(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    name = str(target)
    folder = package_folder(PACKAGE, PACKAGE, PACKAGE) / "suite"
    domain, _, task = name.removeprefix(PREFIX).partition("/")
    domains = sorted(path.stem for path in folder.glob("*.xml") if path.with_suffix(".py").is_file())
    if domain not in domains:
        raise TargetError(f"{name}: dm_control's suite has no domain {domain!r}; it has {', '.join(domains)}")
    code = source_tree(folder / f"{domain}.py")
    functions = [node for node in code.body if isinstance(node, ast.FunctionDef)]
    tasks = [one.name for one in functions if any(_registers(decorator) for decorator in one.decorator_list)]
    if task not in tasks:
        raise TargetError(f"{name}: the domain {domain!r} has no task {task!r}; it has {', '.join(tasks)}")
    read = read_model_file(folder / f"{domain}.xml", pair)
    notes = read.notes
    if any(isinstance(node, ast.Name) and node.id in XML_EDITORS for node in ast.walk(code)):
        note = (
            f"dm_control changes {domain}.xml before it loads it; options and contacts are read from the file as it is"
        )
        notes = (note, *notes)
    return replace(read, name=name, source=f"dm_control {package_version(PACKAGE)}, suite, {domain}.xml", notes=notes)


def _registers(decorator: ast.expr) -> bool:
    return ast.unparse(decorator.func if isinstance(decorator, ast.Call) else decorator) == REGISTER


READERS = (Reader("a task of dm_control's suite (dm_control:walker/walk)", has_start(PREFIX), _read),)
