"""Read ManiSkill's settings: a task by its name, an environment, or a SimConfig.

A task is read without starting it, and without importing ManiSkill, which imports PyTorch and looks for a GPU driver:
the code of the task and of its base classes is parsed for the values of its `_default_sim_config`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.tools.sanity.foot_contact import FootContact
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.readers.materials import Material, combined, of_body, one_value, stated_material
from gauge_envs.tools.sanity.readers.physx_values import PhysxValues
from gauge_envs.tools.sanity.readers.reader import Reader
from gauge_envs.tools.sanity.readers.table import Table

PREFIX = "maniskill:"
"""Start of the name of a task."""

METHOD = "_default_sim_config"
"""Property of an environment that returns its SimConfig."""

TYPES_FILE = "utils/structs/types.py"
"""File of ManiSkill with the defaults of SimConfig."""

LINK_DAMPING_PER_S = 0.05
"""Linear and angular damping of links that SAPIEN starts with; a SimConfig has no field for it."""

MOST_NAMED = 8
"""Most tasks that the message on an unknown one names."""

BASE_CLASS = "BaseEnv"
"""Class that all environments have in common, and which has the defaults."""

MATERIAL = Material(
    body="body",
    origin="sim_config.default_materials_config",
    static_friction=one_value(0.3),
    dynamic_friction=one_value(0.3),
    restitution=one_value(0.0),
)
"""Default material of ManiSkill 3."""

SCENE_SETTINGS = {
    "bounce_threshold": "bounce_threshold_m_per_s",
    "sleep_threshold": "sleep_threshold_m2_per_s2",
    "contact_offset": "contact_offset_m",
    "rest_offset": "rest_offset_m",
    "solver_position_iterations": "position_iterations",
    "solver_velocity_iterations": "velocity_iterations",
    "enable_pcm": "persistent_manifolds",
    "enable_ccd": "continuous_detection",
    "enable_enhanced_determinism": "enhanced_determinism",
    "enable_friction_every_iteration": "friction_every_iteration",
}
"""Settings of the backend by the name of SceneConfig's field."""


def maniskill_configuration(sim_config: Mapping[str, Any], *, name: str, source: str) -> TrainingConfiguration:
    """Return the training configuration of a SimConfig.

    Args:
        sim_config: The fields of a SimConfig, as `dataclasses.asdict` returns them.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    table = Table(sim_config, source=name, path="sim_config")
    rate = table.number("sim_freq")
    if rate is None or not 0.0 < rate < float("inf"):
        raise TargetError(f"{name}: there is no positive sim_config.sim_freq: give all fields of a SimConfig")
    values = PhysxValues("out_of_box")
    values.take("timestep_s", 1.0 / rate, "1 / sim_config.sim_freq")
    scene = table.table("scene_config") or Table({}, source=name, path="sim_config.scene_config", root=sim_config)
    for key, setting in SCENE_SETTINGS.items():
        value = scene.flag(key) if key.startswith("enable_") else scene.number(key)
        if key.startswith("solver_"):
            value = scene.whole(key)
        values.take(setting, value, scene.name(key))
    uses_tgs = scene.flag("enable_tgs")
    if uses_tgs is not None:
        values.take("solver", "TGS" if uses_tgs else "PGS", scene.name("enable_tgs"))
    foot = _contact(table)
    values.take("hinges", "articulation", "a robot is an articulation")
    for setting in ("link_linear_damping_per_s", "angular_damping_per_s"):
        values.take(setting, LINK_DAMPING_PER_S, "SAPIEN's default for links")
    values.take("sustained_restitution", any(foot.restitution), "the stated restitution")
    values.notes.append("materials that a task gives its own objects, and friction of joints, are not seen")
    control = table.number("control_freq")
    return values.configuration(
        table,
        name=name,
        source=source,
        language="maniskill",
        gravity_m_per_s2=scene.numbers("gravity", 3),
        frame_skip=None if not control or control < 0.0 else round(rate / control),
        foot_contact=foot,
    )


def _contact(table: Table) -> FootContact:
    stated = table.table("default_materials_config")
    material = MATERIAL if stated is None else stated_material(stated, body="body", default=MATERIAL)
    return combined(of_body(material, "ground"), of_body(material, "robot"))


# --- a task by its name ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Class:
    """A class of ManiSkill's code: its file, its tree, and the files from which its base classes come."""

    path: Path
    tree: ast.ClassDef
    module: ast.Module


def task_sim_config(name: str) -> dict[str, Any]:
    """Return the fields of the SimConfig of a task of the installed ManiSkill.

    Args:
        name: `maniskill:TASK`, as `maniskill:PickCube-v1`.
    """
    folder = _folder()
    task = name.removeprefix(PREFIX)
    known = _registered(folder)
    if task not in known:
        near = get_close_matches(task, known, n=MOST_NAMED, cutoff=0.5) or sorted(known)[:MOST_NAMED]
        raise TargetError(f"{name}: ManiSkill {_version()} has no task {task!r}; similar ones: {', '.join(near)}")
    defaults = _defaults(folder)
    found: _Class | None = known[task]
    while found is not None and found.tree.name != BASE_CLASS:
        method = next((one for one in found.tree.body if isinstance(one, ast.FunctionDef) and one.name == METHOD), None)
        if method is not None:
            return _merged(defaults, _returned(method, f"{name}: {found.path.name}"))
        found = _base(folder, found)
    return _merged(defaults, {})


def _folder() -> Path:
    spec = find_spec("mani_skill")
    if spec is None or not spec.submodule_search_locations:
        raise TargetError(
            "ManiSkill is not installed here: pip install --no-deps mani-skill is enough to read its settings; or give "
            "an environment or a SimConfig to gauge_envs.tools.sanity.check"
        )
    return Path(spec.submodule_search_locations[0])


def _version() -> str:
    try:
        return version("mani_skill")
    except PackageNotFoundError:
        return "of an unknown version"


def _module(path: Path) -> ast.Module:
    try:
        return ast.parse(read_regular(path, MEGABYTE))
    except (OSError, SyntaxError, ValueError) as error:
        raise TargetError(f"{path}: cannot be read: {error}; reinstall ManiSkill") from None


@cache
def _registered(folder: Path) -> dict[str, _Class]:
    """Return the classes that ManiSkill registers as tasks, by the task's name."""
    found = {}
    for path in sorted((folder / "envs").rglob("*.py")):
        content = read_regular(path, MEGABYTE)
        if b"register_env" not in content:
            continue
        module = _module(path)
        for tree in (node for node in module.body if isinstance(node, ast.ClassDef)):
            for task in _tasks(tree):
                found[task] = _Class(path=path, tree=tree, module=module)
    return found


def _tasks(tree: ast.ClassDef) -> Iterator[str]:
    for call in tree.decorator_list:
        is_registration = isinstance(call, ast.Call) and ast.unparse(call.func) == "register_env" and call.args
        if is_registration and isinstance(call, ast.Call) and isinstance(call.args[0], ast.Constant):
            yield str(call.args[0].value)


def _base(folder: Path, found: _Class) -> _Class | None:
    """Return the first base class, from the same file or from the one that it is imported from."""
    if not found.tree.bases:
        return None
    name = ast.unparse(found.tree.bases[0]).rpartition(".")[2]
    path, module = found.path, found.module
    for node in module.body:
        if isinstance(node, ast.ImportFrom) and node.module and any((a.asname or a.name) == name for a in node.names):
            name = next(a.name for a in node.names if (a.asname or a.name) == name)
            path = _path_of(folder, found.path, node)
            module = _module(path)
            break
    tree = next((node for node in module.body if isinstance(node, ast.ClassDef) and node.name == name), None)
    return None if tree is None or tree is found.tree else _Class(path=path, tree=tree, module=module)


def _path_of(folder: Path, importer: Path, node: ast.ImportFrom) -> Path:
    parts = str(node.module).split(".")
    start = folder.parent
    if node.level:
        start = importer.parents[node.level - 1]
    place = start.joinpath(*parts)
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


def _defaults(folder: Path) -> dict[str, Any]:
    """Return the default fields of SimConfig, with those of the configurations in it."""
    classes = {node.name: node for node in _module(folder / TYPES_FILE).body if isinstance(node, ast.ClassDef)}

    def fields_of(name: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for node in classes[name].body:
            if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name) or node.value is None:
                continue
            inner = ast.unparse(node.annotation)
            found[node.target.id] = fields_of(inner) if inner in classes else _value(node.value, name)
        return found

    if "SimConfig" not in classes:
        raise TargetError(f"{folder / TYPES_FILE}: there is no SimConfig: ManiSkill 3 is read, this is {_version()}")
    return fields_of("SimConfig")


def _returned(method: ast.FunctionDef, where: str) -> dict[str, Any]:
    """Return the arguments of the SimConfig that a method returns."""
    returns = [node for node in ast.walk(method) if isinstance(node, ast.Return)]
    value = returns[0].value if len(returns) == 1 else None
    if not isinstance(value, ast.Call) or value.args:
        raise TargetError(f"{where} computes its SimConfig: give the environment to gauge_envs.tools.sanity.check")
    return _arguments(value, where)


def _arguments(call: ast.Call, where: str) -> dict[str, Any]:
    return {str(one.arg): _value(one.value, where) for one in call.keywords if one.arg != "gpu_memory_config"}


def _value(node: ast.expr, where: str) -> Any:
    """Return the value of an expression of numbers, lists, and calls of configurations; nothing is called."""
    if isinstance(node, ast.Call):
        name = ast.unparse(node.func).rpartition(".")[2]
        if name.endswith("Config") and not node.args:
            return _arguments(node, where)
        if name == "field" and node.keywords:
            return _value(node.keywords[0].value, where)
        if name == "array" and node.args:
            return _value(node.args[0], where)
    if isinstance(node, ast.Lambda):
        return _value(node.body, where)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        left, right = _value(node.left, where), _value(node.right, where)
        return left * right if isinstance(node.op, ast.Mult) else left / right
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        return None
    try:
        return ast.literal_eval(node)
    except ValueError:
        text = ast.unparse(node)[:60]
        raise TargetError(f"{where} computes {text!r}: give the environment to gauge_envs.tools.sanity.check") from None


def _merged(defaults: Mapping[str, Any], stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested defaults with what is stated instead."""
    found = dict(defaults)
    for key, value in stated.items():
        before = found.get(key)
        are_tables = isinstance(value, dict) and isinstance(before, dict)
        found[key] = _merged(before, value) if are_tables and before is not None else value
    return found


# --- reader ----------------------------------------------------------------------------------------------------------


def _is_sim_config(value: Any) -> bool:
    if isinstance(value, Mapping):
        return "sim_freq" in value and "scene_config" in value
    return is_dataclass(value) and not isinstance(value, type) and hasattr(value, "sim_freq")


def _matches(target: Any) -> bool:
    if isinstance(target, str | Path):
        return str(target).startswith(PREFIX)
    return _is_sim_config(target) or _is_sim_config(getattr(getattr(target, "unwrapped", None), "sim_config", None))


def _plain(value: Any) -> Any:
    """Return a configuration as tables, its arrays as lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: _plain(getattr(value, one.name)) for one in fields(value)}
    return value.tolist() if hasattr(value, "tolist") else value


def _read(target: Any) -> TrainingConfiguration:
    if isinstance(target, str | Path):
        name = str(target)
        source = f"ManiSkill {_version()}, {METHOD} of the task"
        return maniskill_configuration(task_sim_config(name), name=name, source=source)
    if _is_sim_config(target):
        return maniskill_configuration(_plain(target), name="SimConfig", source="ManiSkill's SimConfig")
    spec = getattr(target, "spec", None)
    name = type(target.unwrapped).__name__ if spec is None else spec.id
    return maniskill_configuration(_plain(target.unwrapped.sim_config), name=name, source="environment of ManiSkill")


MANISKILL = Reader(
    name="maniskill",
    accepts="a task of ManiSkill (maniskill:PickCube-v1)",
    matches=_matches,
    read=lambda target, _: _read(target),
)
"""Reader of tasks, environments and SimConfigs of ManiSkill."""
