"""Read what a training run with Isaac Lab writes down: `params/env.yaml`, or `.hydra/config.yaml`.

The engine is PhysX. The file states the solver, the step, materials and rules of combination. Assets in USD may state
more, which a reader of this file cannot see; notes say where that matters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import Need, TrainingConfiguration
from gauge_envs.tools.sanity.readers.materials import Material, Range, combined, of_body, one_value, stated_material
from gauge_envs.tools.sanity.readers.physx_values import PhysxValues, solver_name
from gauge_envs.tools.sanity.readers.reader import Reader
from gauge_envs.tools.sanity.readers.table import Table
from gauge_envs.tools.sanity.readers.yaml_document import read_yaml, yaml_document

RUN_FILES = ("params/env.yaml", ".hydra/config.yaml")
"""Files in the folder of a training run."""

YAML_SUFFIXES = (".yaml", ".yml")

DEFAULT_MATERIAL = Material(
    body="body",
    origin="no material: Isaac Sim's default",
    static_friction=one_value(0.5),
    dynamic_friction=one_value(0.5),
    restitution=one_value(0.0),
)
"""Material of a body for which neither the file nor an asset states one."""

DEFAULT_GROUND = Material(
    body="ground",
    origin="no material: Isaac Sim's default ground plane",
    static_friction=one_value(0.5),
    dynamic_friction=one_value(0.5),
    restitution=one_value(0.8),
)
"""Material that Isaac Sim's default ground plane brings along."""

ASSET_ITERATIONS = {"position": 16, "velocity": 1}
"""Counts of iterations of Isaac Sim's schema, for an actor that states none."""

NOT_CARRIED_OVER = {
    "enable_stabilization": "its additional stabilization pass",
    "enable_external_forces_every_iteration": "forces in every iteration",
    "solve_articulation_contact_last": "contacts of articulations as the last ones",
}
"""Flags of `sim.physx` that SAPIEN does not expose, and what they switch on."""

KNOWN_PHYSX = (
    *("solver_type", "min_position_iteration_count", "max_position_iteration_count"),
    *("min_velocity_iteration_count", "max_velocity_iteration_count", "enable_ccd", "enable_enhanced_determinism"),
    *("bounce_threshold_velocity", "friction_offset_threshold", "friction_correlation_distance"),
    *NOT_CARRIED_OVER,
)
"""Keys of `sim.physx` that are read, beside sizes of buffers."""

BUFFERS = ("gpu_", "use_gpu", "class_type", "enable_scene_query_support")
"""Starts of keys of `sim.physx` that do not change the physics."""

ISAAC_LAB_3_MARKS = ("physics.bounce_threshold_velocity", "physics.min_position_iteration_count")
"""Keys of `sim` that show settings of PhysX where Isaac Lab 3 has them."""

OTHER_ENGINES = ("newton_cfg", "physics", "mujoco")
"""Keys of `sim` with settings of other engines."""


def isaac_lab_configuration(cfg: Mapping[str, Any], *, name: str, source: str) -> TrainingConfiguration:
    """Return the training configuration of an environment of Isaac Lab.

    Args:
        cfg: The configuration as nested tables, as `env.yaml` holds it; also below a key `env`.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    whole = Table(cfg, source=name)
    table = whole
    if "sim" not in whole and "env.sim" in whole:
        table = Table(whole.value("env"), source=name, path="env", root=cfg)
    sim = table.table("sim")
    if sim is None or "dt" not in sim:
        raise TargetError(
            f"{name}: there is no sim.dt: give the params/env.yaml of a training run with Isaac Lab, or a file with "
            "sim.physx.num_position_iterations as IsaacGym has it"
        )
    physx = _physx(sim)
    values = PhysxValues("isaac")
    _take_solver(sim, physx, values)
    robot = _robot(table)
    _take_actor(physx, robot, values)
    ground, foot = _materials(table, sim, robot, values)
    contact = combined(ground, foot)
    values.take("hinges", "articulation", "a robot is an articulation")
    values.take("sustained_restitution", any(contact.restitution), "the stated restitution")
    return values.configuration(
        table,
        name=name,
        source=source,
        language="isaac_lab" if physx.path.endswith("physx") else "isaac_lab_3",
        gravity_m_per_s2=sim.numbers("gravity", 3),
        frame_skip=table.whole("decimation"),
        foot_contact=contact,
        inapplicable=_inapplicable(table, ground, foot),
    )


def isaac_lab_yaml(content: bytes | str, *, name: str, source: str) -> TrainingConfiguration:
    """Return the training configuration of the text of an `env.yaml`; see `isaac_lab_configuration`."""
    try:
        document = yaml_document(content)
    except ValueError as error:
        raise TargetError(f"{name}: {error}") from None
    return isaac_lab_configuration(document, name=name, source=source)


# --- solver ----------------------------------------------------------------------------------------------------------


def _physx(sim: Table) -> Table:
    """Return the settings of PhysX; Isaac Lab 3 has them at another place."""
    if sim.value("physx") is not None:
        physx = sim.table("physx")
    else:
        physx = sim.table("physics") if any(key in sim for key in ISAAC_LAB_3_MARKS) else None
    if physx is None:
        others = [key for key in OTHER_ENGINES if key in sim]
        reason = f"there is {sim.name(others[0])} instead" if others else "it states no solver"
        raise TargetError(
            f"{sim.source}: there is no {sim.name('physx')}, and {reason}: only PhysX is read of Isaac Lab"
        )
    return physx


def _take_solver(sim: Table, physx: Table, values: PhysxValues) -> None:
    values.take("timestep_s", sim.number("dt"), sim.name("dt"))
    for name, value, key in (
        ("solver", solver_name(physx, "solver_type"), "solver_type"),
        ("bounce_threshold_m_per_s", physx.number("bounce_threshold_velocity"), "bounce_threshold_velocity"),
        ("continuous_detection", physx.flag("enable_ccd"), "enable_ccd"),
        ("enhanced_determinism", physx.flag("enable_enhanced_determinism"), "enable_enhanced_determinism"),
    ):
        values.take(name, value, physx.name(key))
    offset, distance = physx.number("friction_offset_threshold"), physx.number("friction_correlation_distance")
    values.take_friction_scale(offset, distance, f"{physx.name('friction_offset_threshold')} over 0.04")
    for key, effect in NOT_CARRIED_OVER.items():
        if physx.flag(key):
            values.notes.append(f"{physx.name(key)} is not carried over: SAPIEN does not expose {effect}")
    unknown = [key for key in physx.values if key not in KNOWN_PHYSX and not str(key).startswith(BUFFERS)]
    if unknown:
        values.notes.append(f"not known and not read: {', '.join(physx.name(str(key))[:80] for key in unknown[:4])}")
    if str(sim.value("device") or "").startswith("cuda"):
        values.notes.append("training ran PhysX on the GPU; here it runs on the CPU")


def _robot(table: Table) -> Table | None:
    """Return the robot: the asset of that name, or else the first articulation of the scene."""
    scene = table.table("scene")
    for key in ("scene.robot", "robot", "robot_cfg"):
        if isinstance(table.value(key), Mapping):
            return table.table(key)
    if scene is None:
        return None
    found = (key for key, value in scene.values.items() if isinstance(value, Mapping) and "actuators" in value)
    first = next(found, None)
    return None if first is None else scene.table(str(first))


def _take_actor(physx: Table, robot: Table | None, values: PhysxValues) -> None:
    """Take what the robot states for itself: iterations, damping, limits and offsets."""
    spawn = None if robot is None else robot.table("spawn")
    if robot is None or spawn is None:
        values.notes.append("no robot is found: what bodies state for themselves is that of Isaac Sim's schema")
        spawn = Table({}, source=physx.source, path="scene.robot.spawn")
    for kind in ASSET_ITERATIONS:
        _take_iterations(physx, spawn, kind, values)
    for name, keys in {
        "linear_damping_per_s": ("rigid_props.linear_damping",),
        "angular_damping_per_s": ("rigid_props.angular_damping",),
        "max_linear_velocity_m_per_s": ("rigid_props.max_linear_velocity",),
        "max_depenetration_velocity_m_per_s": ("rigid_props.max_depenetration_velocity",),
        "sleep_threshold_m2_per_s2": ("articulation_props.sleep_threshold", "rigid_props.sleep_threshold"),
        "contact_offset_m": ("collision_props.contact_offset",),
        "rest_offset_m": ("collision_props.rest_offset",),
        "patch_radius_m": ("collision_props.torsional_patch_radius",),
        "min_patch_radius_m": ("collision_props.min_torsional_patch_radius",),
    }.items():
        stated = next((key for key in keys if key in spawn), keys[0])
        values.take(name, spawn.number(stated), spawn.name(stated))
    degrees = spawn.number("rigid_props.max_angular_velocity")
    if degrees is not None:
        values.take(
            "max_angular_velocity_rad_per_s", math.radians(degrees), spawn.name("rigid_props.max_angular_velocity")
        )
    if spawn.flag("rigid_props.disable_gravity"):
        values.notes.append(f"{spawn.name('rigid_props.disable_gravity')} is not carried over: the experiments have it")


def _take_iterations(physx: Table, spawn: Table, kind: str, values: PhysxValues) -> None:
    """Take the robot's count of iterations, clamped into the range of the scene."""
    suffix = f"solver_{kind}_iteration_count"
    key = next((k for k in (f"articulation_props.{suffix}", f"rigid_props.{suffix}") if k in spawn), None)
    count = ASSET_ITERATIONS[kind] if key is None else spawn.whole(key)
    assert count is not None, "the key has a value"
    low = physx.whole(f"min_{kind}_iteration_count")
    high = physx.whole(f"max_{kind}_iteration_count")
    if low is not None and high is not None and low > high:
        name = physx.name(f"min_{kind}_iteration_count")
        raise TargetError(f"{physx.source}: {name} is {low}, more than the maximum of {high}: exchange them")
    used = min(max(count, 0 if low is None else low), 255 if high is None else high)
    origin = "Isaac Sim's schema" if key is None else spawn.name(key)
    if used != count:
        origin += f", clamped to {physx.path}"
    if key is None:
        values.notes.append(f"the robot states no count of {kind} iterations, so its asset decides; {used} is used")
    values.take(f"{kind}_iterations", used, origin)


def _inapplicable(table: Table, ground: Material, foot: Material) -> dict[Need, str]:
    """Return what the engine cannot represent and what then cannot be judged."""
    for key in ("scene.terrain.physics_material", "terrain.physics_material", "sim.physics_material"):
        material = table.table(key)
        is_used = material is not None and material.path in (ground.origin, foot.origin)
        if material is not None and is_used and (material.number("compliant_contact_stiffness") or 0.0) > 0.0:
            name = material.name("compliant_contact_stiffness")
            return {Need.CONTACT: f"{name} makes contacts springs, which SAPIEN does not expose"}
    return {}


# --- materials -------------------------------------------------------------------------------------------------------


def _materials(table: Table, sim: Table, robot: Table | None, values: PhysxValues) -> tuple[Material, Material]:
    """Return the materials of the ground and of the robot, before they are combined."""
    stated = sim.table("physics_material")
    default = DEFAULT_MATERIAL if stated is None else stated_material(stated, body="body", default=DEFAULT_MATERIAL)
    ground = _ground(table, default, values)
    foot = of_body(default, "robot")
    own = None if robot is None else robot.table("spawn.physics_material")
    if own is not None:
        foot = stated_material(own, body="robot", default=DEFAULT_MATERIAL)
    else:
        values.notes.append("a material that the robot's asset itself binds is not seen")
    return ground, _randomized(table, foot, values)


def _ground(table: Table, default: Material, values: PhysxValues) -> Material:
    terrain = next((found for key in ("scene.terrain", "terrain") if (found := table.table(key)) is not None), None)
    if terrain is not None:
        material, kind = terrain.table("physics_material"), terrain.text("terrain_type")
        if kind == "usd":
            values.notes.append(f"{terrain.name('usd_path')} decides the material of the ground, which is not seen")
            return of_body(default, "ground")
        if material is not None:
            return stated_material(material, body="ground", default=DEFAULT_MATERIAL)
        return DEFAULT_GROUND if kind == "plane" else of_body(default, "ground")
    for plane in _ground_planes(table):
        material = plane.table("physics_material")
        return (
            DEFAULT_GROUND if material is None else stated_material(material, body="ground", default=DEFAULT_MATERIAL)
        )
    values.notes.append("no ground is found in the file: the default material of the simulation is used for it")
    return of_body(default, "ground")


def _ground_planes(table: Table) -> Iterator[Table]:
    scene = table.table("scene")
    for key in () if scene is None else scene.values:
        spawn = scene.value(f"{key}.spawn") if scene is not None and "." not in str(key) else None
        if isinstance(spawn, Mapping) and str(spawn.get("func", "")).endswith("spawn_ground_plane"):
            yield Table(spawn, source=table.source, path=f"{table.name('scene')}.{key}.spawn", root=table.values)


def _randomized(table: Table, foot: Material, values: PhysxValues) -> Material:
    """Return the robot's material with the ranges that an event draws from, if there is one."""
    events = table.table("events")
    for key in () if events is None else events.values:
        term = None if events is None or not isinstance(events.values[key], Mapping) else events.table(str(key))
        params = None if term is None else term.table("params")
        if term is None or params is None or "static_friction_range" not in params:
            continue
        asset = params.text("asset_cfg.name")
        if asset not in (None, "robot"):
            values.notes.append(f"{term.path} changes the material of {asset!r}, which is not used")
            continue
        bodies = params.value("asset_cfg.body_names")
        if bodies not in (None, ".*", [".*"], (".*",)):
            values.notes.append(f"{term.path} changes {bodies!r} only; they are taken for the feet")
        return Material(
            body="robot",
            origin=term.path,
            static_friction=_ends(params, "static_friction_range") or foot.static_friction,
            dynamic_friction=_ends(params, "dynamic_friction_range") or foot.dynamic_friction,
            restitution=_ends(params, "restitution_range") or foot.restitution,
            friction_mode=foot.friction_mode,
            restitution_mode=foot.restitution_mode,
        )
    return foot


def _ends(table: Table, key: str) -> Range | None:
    ends = table.numbers(key, 2)
    if ends is None:
        return None
    low, high = sorted(ends)
    if not 0.0 <= low <= high < math.inf:
        raise TargetError(f"{table.source}: {table.name(key)} is {low:g} to {high:g}: give numbers of 0 or more")
    return low, high


# --- reader ----------------------------------------------------------------------------------------------------------


def _file(target: Path) -> Path:
    """Return the file of a target: itself, or the first one of a training run's folder."""
    with suppress(OSError):
        return next((target / name for name in RUN_FILES if (target / name).is_file()), target)
    return target


def _matches(target: Any) -> bool:
    if isinstance(target, Mapping):
        return isinstance(target.get("sim"), Mapping) or isinstance(target.get("env"), Mapping)
    return isinstance(target, str | Path) and _file(Path(target)).suffix.lower() in YAML_SUFFIXES


def _read(target: Any) -> TrainingConfiguration:
    if isinstance(target, Mapping):
        return isaac_lab_configuration(target, name="Isaac Lab", source="configuration of Isaac Lab")
    path = _file(Path(target))
    # Every run calls its file the same; its folder tells runs apart.
    run = path.parent.parent.name if f"{path.parent.name}/{path.name}" in RUN_FILES else ""
    return isaac_lab_configuration(read_yaml(path), name=run or path.name, source=f"Isaac Lab, file {path}")


ISAAC_LAB = Reader(
    name="isaac-lab",
    accepts="the params/env.yaml of a training run with Isaac Lab",
    matches=_matches,
    read=lambda target, _: _read(target),
)
"""Reader of files of Isaac Lab; it takes every YAML file that another reader does not take."""
