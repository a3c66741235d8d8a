"""Find the model of a task of dm_control's suite by its name, without importing dm_control.

The package needs a MuJoCo of its own version. Its XML files do not, so they are read from its folder.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.readers.mujoco_model import read_model_file
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader

PREFIX = "dm_control:"
"""Start of the name of a task."""

XML_EDITORS = ("etree", "xml_tools")
"""Names in a domain's code that show that it changes its XML before it loads it."""


@dataclass(frozen=True, kw_only=True)
class SuiteTask:
    """A task of dm_control's suite.

    Attributes:
        model: Its model file.
        source: Description of the origin.
        notes: What the model file does not show.
    """

    model: Path
    source: str
    notes: tuple[str, ...] = ()


def suite_task(name: str) -> SuiteTask:
    """Return the model of a task.

    Args:
        name: `dm_control:DOMAIN/TASK`, as `dm_control:walker/walk`.
    """
    folder = _suite_folder()
    domain, _, task = name.removeprefix(PREFIX).partition("/")
    domains = sorted(path.stem for path in folder.glob("*.xml") if path.with_suffix(".py").is_file())
    if domain not in domains:
        raise TargetError(f"{name}: dm_control's suite has no domain {domain!r}; it has {', '.join(domains)}")
    code = _code(folder / f"{domain}.py")
    tasks = _tasks(code)
    if task not in tasks:
        raise TargetError(f"{name}: the domain {domain!r} has no task {task!r}; it has {', '.join(tasks)}")
    edits = any(isinstance(node, ast.Name) and node.id in XML_EDITORS for node in ast.walk(code))
    note = f"dm_control changes {domain}.xml before it loads it; options and contacts are read from the file as it is"
    return SuiteTask(
        model=folder / f"{domain}.xml",
        source=f"dm_control {_version()}, suite, {domain}.xml",
        notes=(note,) if edits else (),
    )


def _suite_folder() -> Path:
    spec = find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        raise TargetError(
            "dm_control is not installed here: pip install --no-deps dm_control is enough to read its models"
        )
    return Path(spec.submodule_search_locations[0]) / "suite"


def _version() -> str:
    try:
        return version("dm_control")
    except PackageNotFoundError:
        return "of an unknown version"


def _code(path: Path) -> ast.Module:
    try:
        return ast.parse(read_regular(path, MEGABYTE))
    except (OSError, SyntaxError, ValueError) as error:
        raise TargetError(f"{path}: cannot be read: {error}; reinstall dm_control") from None


def _tasks(code: ast.Module) -> list[str]:
    """Return the functions that a domain registers with `@SUITE.add`."""
    functions = [node for node in code.body if isinstance(node, ast.FunctionDef)]
    return [one.name for one in functions if any(_registers(decorator) for decorator in one.decorator_list)]


def _registers(decorator: ast.expr) -> bool:
    call = decorator.func if isinstance(decorator, ast.Call) else decorator
    return ast.unparse(call) == "SUITE.add"


def _read(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    name = str(target)
    task = suite_task(name)
    read = read_model_file(task.model, pair)
    return replace(read, name=name, source=task.source, notes=(*task.notes, *read.notes))


DM_CONTROL = Reader(
    name="dm_control",
    accepts="a task of dm_control's suite (dm_control:walker/walk)",
    matches=lambda target: isinstance(target, str | Path) and str(target).startswith(PREFIX),
    read=_read,
    has_geoms=True,
)
"""Reader of tasks of dm_control's suite."""
