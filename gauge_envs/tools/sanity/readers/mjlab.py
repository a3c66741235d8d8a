"""Read tasks of mjlab: by name from its source, or the `params/env.yaml` that each of its training runs writes.

mjlab needs torch and a MuJoCo of its own version, so it is not imported. Its task configurations are read as data. The
robot's XML file and the collision settings of its configuration give the contact constants.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import yaml

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.tools.sanity.contact_capacity import CapacityLimits, ContactCapacity, contact_capacity
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.python_source import UNKNOWN, External, Instance, Source
from gauge_envs.tools.sanity.python_source.values import Function
from gauge_envs.tools.sanity.readers.mjlab_model import MjlabModel, MjlabTable, mjlab_model
from gauge_envs.tools.sanity.readers.mujoco_model import read_model
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader

PREFIX = "mjlab:"
"""Start of the name of a task."""

PACKAGE = "mjlab"

REGISTER = "register_mjlab_task"
"""Function with which mjlab registers a task."""

FILE_SUFFIXES = (".yaml", ".yml")

MUJOCO_SECTION = re.compile(rb"^sim:.*?\n(?:[ \t].*\n)*?[ ]+mujoco:", re.MULTILINE)
"""Tables of a configuration that only mjlab has."""

DEEPEST_TABLE = 40
"""Deepest nesting of tables that is read."""

_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_Base):  # type: ignore[misc]
    """Loader of plain values. A tag of Python runs nothing: names become texts, and objects None."""


_Loader.add_constructor(
    "tag:yaml.org,2002:python/tuple", lambda loader, node: tuple(loader.construct_sequence(node, deep=True))
)
_Loader.add_multi_constructor("tag:yaml.org,2002:python/name:", lambda loader, suffix, node: suffix)
_Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: None)


def mjlab_configuration(
    cfg: Mapping[str, Any], *, name: str, source: str, pair: GeomPair | None = None
) -> TrainingConfiguration:
    """Return the configuration of an mjlab task.

    Args:
        cfg: The task configuration as plain values, as `env.yaml` holds it; functions are texts `module.name`.
        name: Name of the configuration.
        source: Description of where it is from.
        pair: Names of two geoms whose constants the experiments get, instead of all sets on ground.
    """
    table = MjlabTable(cfg, source)
    built = _built(table)
    read = read_model(built.model, name=name, source=source, pair=pair, frame_skip=table.whole("decimation"))
    note = "trains on mujoco_warp, in single precision; the rows run MuJoCo's C engine"
    return replace(
        read, language="mjlab", notes=(note, *built.notes, *read.notes), capacity=_capacity(table, built), is_model=True
    )


def mjlab_tasks() -> tuple[str, ...]:
    """Return the names of all registered tasks."""
    return tuple(sorted(_registered(_source())))


def _built(table: MjlabTable) -> MjlabModel:
    return mjlab_model(table, _spec_files(None if _folder() is None else _source()))


def _capacity(table: MjlabTable, built: MjlabModel) -> ContactCapacity | None:
    njmax, nconmax = table.whole("sim.njmax"), table.whole("sim.nconmax")
    if njmax is None and nconmax is None:
        return None
    limits = CapacityLimits(njmax=njmax, naconmax=nconmax, worlds=None if nconmax is None else 1)
    return contact_capacity(built.model, limits, reason=built.incomplete)


# --- source ----------------------------------------------------------------------------------------------------------


def _folder() -> Path | None:
    spec = find_spec(PACKAGE)
    return None if spec is None or not spec.submodule_search_locations else Path(spec.submodule_search_locations[0])


def _source() -> Source:
    folder = _folder()
    if folder is None:
        raise TargetError("mjlab is not installed here: pip install --no-deps mjlab is enough to read its tasks")

    def path(args: list[Any], _: dict[str, Any]) -> Any:
        return Path(args[0]) if args and isinstance(args[0], str | Path) else UNKNOWN

    def from_file(args: list[Any], _: dict[str, Any]) -> Any:
        return Instance(External("mujoco.MjSpec"), {"file": args[0] if args else UNKNOWN})

    known = {
        "pathlib.Path": path,
        "copy.deepcopy": lambda args, _: args[0],
        "mujoco.MjSpec.from_file": from_file,
    }
    return Source(folder, PACKAGE, known)


def _spec_files(source: Source | None) -> Callable[[str], Path | None]:
    """Return a function from the name of a function that loads an MJCF file to that file; None when unknown."""

    def file_of(name: str) -> Path | None:
        module = None if source is None else source.module(name.rpartition(".")[0])
        if source is None or module is None:
            return None
        loaded = source.call(source.value(module, name.rpartition(".")[2]), [], {})
        file = loaded.attributes.get("file") if isinstance(loaded, Instance) else None
        return Path(file) if isinstance(file, str | Path) else None

    return file_of


def _registered(source: Source) -> dict[str, tuple[Any, ast.expr]]:
    """Return the module and the expression of the configuration of each task."""
    folder = _folder()
    assert folder is not None, "the source of an installed package is read"
    found: dict[str, tuple[Any, ast.expr]] = {}
    for path in sorted((folder / "tasks").rglob("__init__.py")):
        module = source.module(".".join((PACKAGE, *path.parent.relative_to(folder).parts)))
        for node in () if module is None else ast.walk(module.tree):
            if not isinstance(node, ast.Call) or ast.unparse(node.func) != REGISTER or module is None:
                continue
            given = {one.arg: one.value for one in node.keywords}
            task = source.evaluate(given["task_id"], module) if "task_id" in given else UNKNOWN
            if isinstance(task, str) and "env_cfg" in given:
                found[task] = (module, given["env_cfg"])
    return found


def _plain(value: Any, depth: int = 0) -> Any:
    """Return a value of the source, or of a data class, as plain values; functions as their names."""
    if depth > DEEPEST_TABLE or value is UNKNOWN:
        return None
    if isinstance(value, Instance):
        return {key: _plain(one, depth + 1) for key, one in value.attributes.items()}
    if is_dataclass(value) and not isinstance(value, type | Function):
        return {one.name: _plain(getattr(value, one.name, None), depth + 1) for one in fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(one, depth + 1) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one, depth + 1) for one in value]
    if isinstance(value, Function):
        return value.name
    if callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', '')}"
    return value if isinstance(value, bool | int | float | str) else None


# --- readers ---------------------------------------------------------------------------------------------------------


def _version() -> str:
    try:
        return version(PACKAGE)
    except PackageNotFoundError:
        return "of an unknown version"


def _of_name(target: Any) -> tuple[Mapping[str, Any], str]:
    """Return the configuration of a task, and its origin."""
    name, source = str(target), _source()
    tasks = _registered(source)
    task = name.removeprefix(PREFIX)
    if task not in tasks:
        raise TargetError(f"{name}: mjlab has no task {task!r}; it has {', '.join(sorted(tasks))}")
    module, expression = tasks[task]
    cfg = source.evaluate(expression, module)
    if not isinstance(cfg, Instance):
        raise TargetError(f"{name}: its configuration is not stated in a way that is read")
    return _plain(cfg), f"mjlab {_version()}, task configuration"


def _of_file(target: Any) -> tuple[Mapping[str, Any], str]:
    """Return the configuration that a training run wrote, and its origin."""
    path = Path(target)
    try:
        cfg = yaml.load(read_regular(path, MEGABYTE), Loader=_Loader)
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise TargetError(f"{path}: is no YAML: {' '.join(str(error).split())}") from None
    return cfg, f"training run {path}"


def _of_object(target: Any) -> tuple[Mapping[str, Any], str]:
    """Return a task configuration in this process as plain values, and its origin."""
    return _plain(target), "task configuration of mjlab"


def _reader(
    name: str,
    accepts: str,
    *,
    matches: Callable[[Any], bool],
    cfg_of: Callable[[Any], tuple[Mapping[str, Any], str]],
    label: Callable[[Any], str] = str,
) -> Reader:
    """Return the reader of one kind of target that holds a task configuration."""

    def read(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
        cfg, source = cfg_of(target)
        return mjlab_configuration(cfg, name=label(target), source=source, pair=pair)

    def model(target: Any) -> mujoco.MjModel:
        return _built(MjlabTable(*cfg_of(target))).model

    return Reader(name=name, accepts=accepts, matches=matches, read=read, model=model, has_geoms=True)


def _is_file(target: Any) -> bool:
    if not isinstance(target, str | Path) or Path(target).suffix.lower() not in FILE_SUFFIXES:
        return False
    try:
        return MUJOCO_SECTION.search(read_regular(Path(target), MEGABYTE)) is not None
    except (OSError, ValueError):
        return False


def _is_cfg(target: Any) -> bool:
    sim = getattr(target, "sim", None)
    return is_dataclass(target) and hasattr(sim, "mujoco") and hasattr(sim, "njmax")


MJLAB = _reader(
    "mjlab",
    "a task of mjlab (mjlab:Mjlab-Velocity-Flat-Unitree-Go1)",
    matches=lambda target: isinstance(target, str | Path) and str(target).startswith(PREFIX),
    cfg_of=_of_name,
)
"""Reader of mjlab's tasks."""

MJLAB_FILE = _reader(
    "mjlab-file",
    "params/env.yaml of a training run of mjlab",
    matches=_is_file,
    cfg_of=_of_file,
    label=lambda target: Path(target).name,
)
"""Reader of the configuration that a training run writes."""

MJLAB_CFG = _reader(
    "mjlab-cfg",
    "a task configuration of mjlab",
    matches=_is_cfg,
    cfg_of=_of_object,
    label=lambda target: type(target).__name__,
)
"""Reader of task configurations in this process."""
