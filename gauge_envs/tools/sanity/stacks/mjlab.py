"""mjlab: tasks by name from its source, or the `params/env.yaml` that each of its training runs writes.

mjlab needs torch and a MuJoCo of its own version, so it is not imported. Its task configurations are read as data, and
the model of a scene is built of them: a ground plane, the robots' XML files, and the collision settings of each.
Changes are arguments of configuration classes: `SimulationCfg(mujoco=MujocoCfg(cone="elliptic"))`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.backends.mujoco.model import CONES, ENABLE_FLAGS, INTEGRATORS, SOLVERS
from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE
from gauge_envs.tools.sanity.model import CapacityLimits, ContactCapacity, TrainingConfiguration
from gauge_envs.tools.sanity.python_source.source import Source, package_folder, package_version
from gauge_envs.tools.sanity.python_source.values import External, Instance, Module, plain, source_path
from gauge_envs.tools.sanity.robot.contact_capacity import contact_capacity
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.stacks.dialect import WHOLE, Dialect, Kind, Place, Setting, python_text
from gauge_envs.tools.sanity.stacks.documents import Table, read_yaml
from gauge_envs.tools.sanity.stacks.mjcf import MODEL_SETTINGS
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader, has_start, named_content

PREFIX = "mjlab:"
"""Start of the name of a task."""

PACKAGE = "mjlab"

REGISTER = "register_mjlab_task"
"""Function with which mjlab registers a task."""

MUJOCO_SECTION = re.compile(rb"^sim:.*?\n(?:[ \t].*\n)*?[ ]+mujoco:", re.MULTILINE)
"""Tables of a configuration that only mjlab has."""

NAMED = {
    option: {name.lower(): constant for name, constant in constants.items()}
    for option, constants in {"integrator": INTEGRATORS, "cone": CONES, "solver": SOLVERS}.items()
}
"""Options that mjlab states by name, and MuJoCo's constants."""

FLAGS = {"disableflags": ("mjDSBL_", mujoco.mjtDisableBit), "enableflags": ("mjENBL_", mujoco.mjtEnableBit)}
"""Lists of flags, with the start and the type of MuJoCo's bits."""

GEOM_NUMBERS = ("contype", "conaffinity", "condim", "priority", "margin", "gap", "solmix")
GEOM_CONSTANTS = ("friction", "solref", "solimp")

LONGEST_PATTERN = 200
"""Longest pattern of names of geoms."""

REPEATED_GROUP = re.compile(r"\)[*+{]")
"""Patterns that may take forever; mjlab has none."""

MOST_ENTITIES = 32
"""Most entities of a scene."""

PLACES = {"option": "MujocoCfg", "flag": "MujocoCfg", "geom": "CollisionCfg"}
"""Classes that hold the attributes of a model's elements."""


def _argument(one: Setting) -> Setting:
    """Return the argument that states an attribute of a model."""
    key, kind = one.key, one.kind
    if one.place == "flag":
        key, shown = ("enableflags", True) if one.name in ENABLE_FLAGS else ("disableflags", False)
        kind = Kind(text=lambda is_on: f'("{one.key}",)' if is_on is shown else "()")
    elif key in NAMED:
        kind = Kind(lambda table, _: table.choice(key, NAMED[key]), lambda name: python_text(name.lower()))
    return replace(one, place=PLACES[one.place], key=key, kind=kind)


MJLAB = Dialect(
    name="mjlab",
    settings=(
        *map(_argument, MODEL_SETTINGS),
        Setting("njmax", "SimulationCfg", "njmax", WHOLE),
        # mjlab states contacts of one world.
        Setting("naconmax", "SimulationCfg", "nconmax", WHOLE),
    ),
    places={
        "MujocoCfg": Place(form="mujoco=MujocoCfg({})", within="SimulationCfg"),
        "SimulationCfg": Place(form="SimulationCfg({})"),
        "CollisionCfg": Place(form="CollisionCfg({})", has_geoms=True),
    },
    gravity="SimulationCfg(mujoco=MujocoCfg(gravity=({})))",
    absent='without the flag "override"',
)


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
    table = Table(cfg, source=source)
    built = _built(table)
    read = mujoco_configuration(
        built.model, name=name, source=source, pair=pair, frame_skip=table.whole("decimation"), spec=built.spec
    )
    note = "trains on mujoco_warp, in single precision; the rows run MuJoCo's C engine"
    notes = (note, *built.notes, *read.notes)
    capacity = _capacity(table, built)
    robot = replace(read.robot, delay_s=_delay_s(table, built.model.opt.timestep))
    return replace(read, language=MJLAB.name, notes=notes, capacity=capacity, trains_on="mujoco_warp", robot=robot)


def _delay_s(table: Table, step_s: float) -> float | None:
    """Return the longest delay of what the policy observes and of the actuators [s]; None when none is stated.

    Lags of actuators are steps of the engine, those of observations steps of the environment.
    """
    terms = [one for group in ("actor", "policy") for one in table.part(f"observations.{group}.terms").values.values()]
    entities = [one for one in table.part("scene.entities").values.values() if isinstance(one, Mapping)]
    parts = [Table(entity, source="entity").part("articulation") for entity in entities]
    actuators = [one for part in parts for one in part.entries("actuators")]
    seen, acted = (
        [lag for one in several if isinstance(one, Mapping) and isinstance(lag := one.get("delay_max_lag"), int)]
        for several in (terms, actuators)
    )
    if not seen and not acted:
        return None
    return step_s * (max(seen, default=0) * (table.whole("decimation") or 1) + max(acted, default=0))


def _capacity(table: Table, built: _Built) -> ContactCapacity | None:
    sim = table.part("sim")
    limits = {name: value for name, value, _ in MJLAB.read({"SimulationCfg": sim}) if value is not None}
    if not limits:
        return None
    worlds = 1 if "naconmax" in limits else None
    return contact_capacity(built.model, CapacityLimits(worlds=worlds, **limits), reason=built.incomplete)


# --- model -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Built:
    """A compiled scene with the options of the configuration, what is left out, and why contacts cannot be counted."""

    model: mujoco.MjModel
    notes: tuple[str, ...]
    incomplete: str
    spec: mujoco.MjSpec


def _built(table: Table) -> _Built:
    """Build the model of a configuration."""
    source = None if find_spec(PACKAGE) is None else _source()
    notes, left_out = [], []
    spec = mujoco.MjSpec()
    ground = spec.worldbody.add_body(name="terrain")
    ground.add_geom(name="terrain", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 0.01))
    is_plane = table.value("scene.terrain.terrain_type") in (None, "plane")
    if not is_plane:
        notes.append("a plane stands for the terrain, which mjlab generates")
    for name, entity in list(table.part("scene.entities").values.items())[:MOST_ENTITIES]:
        function = entity.get("spec_fn") if isinstance(entity, Mapping) else None
        file = _file_of(source, function.replace(":", ".")) if isinstance(function, str) and source else None
        if file is None:
            left_out.append(str(name))
            continue
        part = _entity(file, Table(entity, source=f"entity {name}"))
        spec.attach(part, prefix=f"{name}/", frame=spec.worldbody.add_frame())
    if left_out:
        notes.append(f"left out: {', '.join(left_out)}, whose model mjlab builds in code, or is not installed here")
    try:
        model = spec.compile()
    except ValueError as error:
        raise TargetError(f"MuJoCo cannot compile the scene: {' '.join(str(error).split())}") from None
    _set_options(model, table.part("sim.mujoco"))
    incomplete = "its scene is not complete here" if left_out or not is_plane else ""
    return _Built(model=model, notes=tuple(notes), incomplete=incomplete, spec=spec)


def _file_of(source: Source, name: str) -> Path | None:
    """Return the MJCF file that a function of mjlab loads; None when unknown."""
    place, _, function = name.rpartition(".")
    module = source.module(place)
    loaded = None if module is None else source.call(source.value(module, function), [], {})
    file = loaded.attributes.get("file") if isinstance(loaded, Instance) else None
    return Path(file) if isinstance(file, str | Path) else None


def _entity(file: Path, table: Table) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_file(str(file))
    except ValueError as error:
        raise TargetError(f"{file}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    for key in list(spec.keys):
        spec.delete(key)
    for policy in table.entries("collisions"):
        _apply_collisions(spec, Table(policy, source="collisions"))
    return spec


def _apply_collisions(spec: mujoco.MjSpec, policy: Table) -> None:
    """Set the collision attributes of the geoms whose names match; of several patterns of a value, the first counts."""
    patterns = policy.texts("geom_names_expr")
    for geom in spec.geoms:
        if not any(_matches(pattern, geom.name) for pattern in patterns):
            if policy.value("disable_other_geoms") is not False:
                geom.contype = geom.conaffinity = 0
            continue
        for name in (*GEOM_NUMBERS, *GEOM_CONSTANTS):
            value = _for_geom(policy.value(name), geom.name)
            with _taken(f"{policy.source}: {name}", value):
                if name in GEOM_NUMBERS and isinstance(value, int | float):
                    setattr(geom, name, value)
                elif name in GEOM_CONSTANTS and isinstance(value, list | tuple):
                    constants = getattr(geom, name)
                    constants[: len(value)] = value[: len(constants)]


@contextmanager
def _taken(place: str, value: Any) -> Iterator[None]:
    """Raise an error for people where MuJoCo does not take a value."""
    try:
        yield
    except (TypeError, ValueError):
        raise TargetError(f"{place} is {value!r}, which MuJoCo does not take") from None


def _for_geom(value: Any, geom: str) -> Any:
    if not isinstance(value, Mapping):
        return value
    return next((one for pattern, one in value.items() if _matches(str(pattern), geom)), None)


def _matches(pattern: str, name: str) -> bool:
    if len(pattern) > LONGEST_PATTERN or REPEATED_GROUP.search(pattern):
        raise TargetError(f"the pattern {pattern[:40]!r} of names of geoms is too long or repeats a group")
    try:
        return re.match(pattern, name) is not None
    except re.error as error:
        raise TargetError(f"the pattern {pattern!r} of names of geoms is not valid: {error}") from None


def _set_options(model: mujoco.MjModel, table: Table) -> None:
    options = model.opt
    for one in MJLAB.settings:
        value = one.kind.read(table, one.key) if one.place == "MujocoCfg" and one.key not in FLAGS else None
        if value is not None:
            with _taken(f"{table.source}: {table.name(one.key)}", value):
                setattr(options, one.key, int(NAMED[one.key][value]) if one.key in NAMED else value)
    gravity = table.numbers("gravity", 3)
    if gravity is not None:
        options.gravity[:] = gravity
    for name, (start, kind) in FLAGS.items():
        for flag in table.texts(name):
            bit = getattr(kind, f"{start}{flag.upper()}", None)
            if bit is None:
                raise TargetError(f"{flag!r} is no flag of MuJoCo {mujoco.__version__}")
            setattr(options, name, getattr(options, name) | int(bit))


# --- source ----------------------------------------------------------------------------------------------------------


def _source() -> Source:
    def from_file(args: list[Any], _: dict[str, Any]) -> Any:
        return Instance(External("mujoco.MjSpec"), {"file": args[0]} if args else {})

    known = {
        "pathlib.Path": source_path,
        "copy.deepcopy": lambda args, _: args[0],
        "mujoco.MjSpec.from_file": from_file,
    }
    return Source(package_folder(PACKAGE, PACKAGE, PACKAGE), PACKAGE, known)


def _registered(source: Source) -> dict[str, tuple[Module, ast.expr]]:
    """Return the module and the expression of the configuration of each task."""
    found: dict[str, tuple[Module, ast.expr]] = {}
    for module in source.modules("tasks", REGISTER):
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == REGISTER:
                given = {one.arg: one.value for one in node.keywords}
                task = source.evaluate(given["task_id"], module) if "task_id" in given else None
                if isinstance(task, str) and "env_cfg" in given:
                    found[task] = (module, given["env_cfg"])
    return found


def mjlab_tasks() -> tuple[str, ...]:
    """Return the names of all registered tasks."""
    return tuple(sorted(_registered(_source())))


# --- readers ---------------------------------------------------------------------------------------------------------


def _read_name(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    name, code = str(target), _source()
    tasks = _registered(code)
    task = name.removeprefix(PREFIX)
    if task not in tasks:
        raise TargetError(f"{name}: mjlab has no task {task!r}; it has {', '.join(sorted(tasks))}")
    module, expression = tasks[task]
    cfg = code.evaluate(expression, module)
    if not isinstance(cfg, Instance):
        raise TargetError(f"{name}: its configuration is not stated in a way that is read")
    source = f"mjlab {package_version(PACKAGE)}, task configuration"
    return mjlab_configuration(plain(cfg), name=name, source=source, pair=pair)


def _read_file(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    path = Path(target)
    cfg = read_yaml(path, takes_objects=True)
    return mjlab_configuration(cfg, name=path.name, source=f"training run {target}", pair=pair)


def _read_cfg(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    name, source = type(target).__name__, "task configuration of mjlab"
    return mjlab_configuration(plain(target), name=name, source=source, pair=pair)


def _is_cfg(target: Any) -> bool:
    sim = getattr(target, "sim", None)
    return is_dataclass(target) and hasattr(sim, "mujoco") and hasattr(sim, "njmax")


DIALECTS = (MJLAB,)

READERS = (
    Reader("a task configuration of mjlab", _is_cfg, _read_cfg),
    Reader("a task of mjlab (mjlab:Mjlab-Velocity-Flat-Unitree-Go1)", has_start(PREFIX), _read_name),
    Reader(
        "params/env.yaml of a training run of mjlab",
        lambda target: MUJOCO_SECTION.search(named_content(target, (".yaml", ".yml"), MEGABYTE)) is not None,
        _read_file,
    ),
)
