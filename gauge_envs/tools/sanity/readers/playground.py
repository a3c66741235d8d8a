"""Read tasks of MuJoCo Playground by name, without importing Playground or JAX, and its environments.

The settings of a task stand in its Python source, in its XML files, and for contact limits in its configuration. All
are read as data. Robots whose meshes Playground downloads are compiled with substitutes, which a note names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.contact_capacity import CapacityLimits, ContactCapacity, contact_capacity
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.python_source import UNKNOWN, Config, External, Instance, Source
from gauge_envs.tools.sanity.readers.mujoco_model import read_model
from gauge_envs.tools.sanity.readers.packaged_mjcf import PackagedModel, packaged_model
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader

PREFIX = "playground:"
"""Start of the name of a task."""

PACKAGE = "mujoco_playground"

SUITES = ("dm_control_suite", "locomotion", "manipulation")
"""Parts of Playground that register tasks."""

WARP = "warp"
"""Implementation whose memory for contacts is limited."""

MODEL_EDITORS = ("etree", "MjSpec.")
"""Texts in a task's code that show that it changes its XML before it compiles it."""


@dataclass(frozen=True, kw_only=True)
class PlaygroundTask:
    """What Playground's source states about a task.

    Attributes:
        name: Registered name.
        model_file: Its XML file.
        folders: Folders in which it looks for further files.
        options: Options of the engine that its code sets after it has compiled the model.
        config: Its configuration.
        world_count: Environments of Playground's own training; None when not stated.
        edits: Whether its code changes the XML before it compiles it.
    """

    name: str
    model_file: Path
    folders: tuple[Path, ...]
    options: Mapping[str, float]
    config: Mapping[str, Any]
    world_count: int | None
    edits: bool = False

    @property
    def limits(self) -> CapacityLimits | None:
        """Limits of the memory for contacts; None for an implementation that has none."""
        if self.config.get("impl") != WARP:
            return None
        return _limits(self.config, self.world_count)


def playground_tasks() -> tuple[str, ...]:
    """Return the names of all registered tasks."""
    return tuple(name for suite in SUITES for name in _registered(_source([]), suite))


def playground_task(name: str) -> PlaygroundTask:
    """Return what Playground's source states about a task.

    Args:
        name: `playground:NAME`, as `playground:Go1JoystickFlatTerrain`.
    """
    folders: list[Path] = []
    source = _source(folders)
    task = name.removeprefix(PREFIX)
    suite = next((one for one in SUITES if task in _registered(source, one)), None)
    if suite is None:
        raise TargetError(f"{name}: MuJoCo Playground has no task {task!r}; it has {', '.join(playground_tasks())}")
    made = source.call(_registered(source, suite)[task], [], {})
    attributes = made.attributes if isinstance(made, Instance) else {}
    path, config = attributes.get("_xml_path"), attributes.get("_config")
    if not isinstance(path, str) or not isinstance(config, Config):
        raise TargetError(f"{name}: its model or its configuration is not stated in a way that is read")
    code = Path(str(made.kind.module.path)).read_text(encoding="utf-8")
    parameters = source.module(f"{PACKAGE}.config.{suite}_params")
    training = UNKNOWN if parameters is None else source.call(source.value(parameters, "brax_ppo_config"), [task], {})
    worlds = training.get("num_envs") if isinstance(training, Config) else None
    model = attributes.get("_mj_model")
    options = model.attributes["opt"].attributes if isinstance(model, Instance) else {}
    return PlaygroundTask(
        name=task,
        model_file=Path(path),
        folders=tuple(folders),
        options={"timestep": config.get("sim_dt")} | {k: v for k, v in options.items() if isinstance(v, int | float)},
        config=config,
        world_count=worlds if isinstance(worlds, int) else None,
        edits=any(text in code for text in MODEL_EDITORS),
    )


def _source(folders: list[Path]) -> Source:
    """Return Playground's source; folders of files that it reads are added to a list."""
    spec = find_spec(PACKAGE)
    if spec is None or not spec.submodule_search_locations:
        raise TargetError(
            "MuJoCo Playground is not installed here: pip install --no-deps playground is enough to read its tasks"
        )

    def path(args: list[Any], _: dict[str, Any]) -> Any:
        return Path(args[0]) if args and isinstance(args[0], str | Path) else UNKNOWN

    def update_assets(args: list[Any], _: dict[str, Any]) -> None:
        if len(args) > 1 and isinstance(args[1], Path):
            folders.append(args[1])

    def model(*_: Any) -> Instance:
        return Instance(External("mujoco.MjModel"), {"opt": Instance(External("mujoco.MjOption"))})

    def editable(*_: Any) -> Instance:
        return Instance(External("mujoco.MjSpec"), {"compile": model, "sites": UNKNOWN})

    known = {
        "etils.epath.Path": path,
        "ml_collections.config_dict.create": lambda _, kwargs: Config(kwargs),
        f"{PACKAGE}._src.mjx_env.update_assets": update_assets,
        "mujoco.MjModel.from_xml_string": model,
        "mujoco.MjModel.from_xml_path": model,
        "mujoco.MjSpec.from_string": editable,
        "mujoco.MjSpec.from_file": editable,
    }
    return Source(Path(spec.submodule_search_locations[0]), PACKAGE, known)


def _registered(source: Source, suite: str) -> Mapping[str, Any]:
    module = source.module(f"{PACKAGE}._src.{suite}")
    registered = UNKNOWN if module is None else source.value(module, "_envs")
    return registered if isinstance(registered, dict) else {}


def _version() -> str:
    try:
        return version("playground")
    except PackageNotFoundError:
        return "of an unknown version"


def _limits(config: Mapping[str, Any], worlds: int | None) -> CapacityLimits:
    values = [config.get(key) for key in ("njmax", "naconmax")]
    njmax, naconmax = [one if isinstance(one, int) and not isinstance(one, bool) else None for one in values]
    return CapacityLimits(njmax=njmax, naconmax=naconmax, worlds=worlds)


def _substepped(config: Mapping[str, Any]) -> int | None:
    step, control = config.get("sim_dt"), config.get("ctrl_dt")
    return round(control / step) if step and control else None


def _read_name(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    name = str(target)
    task = playground_task(name)
    packaged = _packaged(task)
    read = read_model(
        packaged.model,
        name=name,
        source=f"MuJoCo Playground {_version()}, {task.model_file.name} and its configuration",
        pair=pair,
        frame_skip=_substepped(task.config),
    )
    notes = [*_config_notes(task.config), *_missing_notes(packaged)]
    if task.edits:
        notes.append(f"Playground changes {task.model_file.name} before it compiles it; the file is read as it is")
    limits = task.limits
    capacity = None if limits is None else contact_capacity(packaged.model, limits, unknown=packaged.missing_geoms)
    return _completed(read, capacity, notes)


def _packaged(task: PlaygroundTask) -> PackagedModel:
    """Return the compiled model of a task, with the options that its code sets."""
    try:
        packaged = packaged_model(task.model_file, task.folders)
    except TargetError as error:
        raise TargetError(f"{PREFIX}{task.name}: {error}") from None
    for option, value in task.options.items():
        setattr(packaged.model.opt, option, value)
    return packaged


def _completed(
    read: TrainingConfiguration, capacity: ContactCapacity | None, notes: list[str]
) -> TrainingConfiguration:
    return replace(read, capacity=capacity, notes=(*notes, *read.notes), language="playground")


def _config_notes(config: Mapping[str, Any]) -> list[str]:
    implementation = config.get("impl")
    if implementation == WARP:
        return ["trains with MJX on mujoco_warp, in single precision; the rows run MuJoCo's C engine"]
    if isinstance(implementation, str):
        return [
            f"trains with MJX's implementation {implementation!r}, in single precision; the rows run MuJoCo's C engine"
        ]
    return ["trains with MJX, in single precision; the rows run MuJoCo's C engine"]


def _missing_notes(packaged: PackagedModel) -> list[str]:
    missing = packaged.missing
    if not missing:
        return []
    shown = ", ".join(missing[:3]) + (f" and {len(missing) - 3} more" if len(missing) > 3 else "")
    which = (
        f"{len(packaged.missing_geoms)} colliding geoms have one"
        if packaged.missing_geoms
        else "no colliding geom has one"
    )
    return [f"Playground downloads files that are not here ({shown}); substitutes stand for them, and {which}"]


def _is_env(target: Any) -> bool:
    """Return whether an object is an environment of Playground, or of a wrapper around one."""
    inner = getattr(target, "unwrapped", target)
    return any(kind.__module__.startswith(PACKAGE) for kind in type(inner).__mro__) and isinstance(
        getattr(inner, "mj_model", None), mujoco.MjModel
    )


def _read_env(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    inner = getattr(target, "unwrapped", target)
    name, model = type(inner).__name__, inner.mj_model
    config = getattr(inner, "_config", {})
    read = read_model(
        model,
        name=name,
        source=f"environment of MuJoCo Playground {_version()}, MuJoCo {mujoco.__version__}",
        pair=pair,
        frame_skip=getattr(inner, "n_substeps", None),
    )
    capacity = contact_capacity(model, _limits(config, None)) if config.get("impl") == WARP else None
    return _completed(read, capacity, _config_notes(config))


PLAYGROUND = Reader(
    name="playground",
    accepts="a task of MuJoCo Playground (playground:Go1JoystickFlatTerrain)",
    matches=lambda target: isinstance(target, str | Path) and str(target).startswith(PREFIX),
    read=_read_name,
    has_geoms=True,
    model=lambda target: _packaged(playground_task(str(target))).model,
)
"""Reader of Playground's tasks."""

PLAYGROUND_ENV = Reader(
    name="playground-env",
    accepts="an env of MuJoCo Playground",
    matches=_is_env,
    read=_read_env,
    has_geoms=True,
    model=lambda target: getattr(target, "unwrapped", target).mj_model,
)
"""Reader of Playground's environments in this process."""
