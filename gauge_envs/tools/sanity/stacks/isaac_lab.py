"""Isaac Lab: what a training run writes down, `params/env.yaml` or `.hydra/config.yaml`.

The engine is PhysX. The file states the solver, the step, materials and rules of combination. Assets in USD may state
more, which a reader of this file cannot see; notes say where that matters. Changes are lines of Python for the
`__post_init__` of a configuration class: `self.sim.physx.bounce_threshold_velocity = 0.2`.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import UNREAD, Need, Settings, TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import (
    FLAG,
    NUMBER,
    WHOLE,
    Dialect,
    Kind,
    Place,
    Setting,
    number_text,
)
from gauge_envs.tools.sanity.stacks.documents import Table, read_yaml
from gauge_envs.tools.sanity.stacks.physx import (
    COEFFICIENTS,
    DEGREES,
    SOLVER,
    Material,
    PhysxValues,
    combined,
    drawn_range,
    stated_material,
)
from gauge_envs.tools.sanity.stacks.reader import Reader, has_suffix

SPAWN = "scene.robot.spawn"

COLLIDER = f"{SPAWN}.collision_props"
"""Properties of colliders. Most robots have none, so they are written as a whole."""

ASSET_ITERATIONS = {"position": 16, "velocity": 1}
"""Counts of iterations of Isaac Sim's schema, for an actor that states none."""

FRICTION_SCALE = {
    "friction_offset_threshold": 0.04,
    "friction_correlation_distance": 0.025,
}
"""Attributes of PhysxCfg that follow from PhysX's length scale, and their ratio to it."""

SAME_LENGTH = 1e-6
"""Relative difference of two length scales that counts as none."""


@dataclass(frozen=True, kw_only=True)
class IsaacLab(Dialect):
    """Lines of Python, of which the length scale takes two."""

    def _entry(self, one: Setting, value: Any) -> str:
        if one.name != "tolerance_length_m":
            return super()._entry(one, value)
        lines = {
            key: number_text(ratio * value) for key, ratio in FRICTION_SCALE.items()
        }
        return "; ".join(
            f"self.{one.place}.{key} = {text}" for key, text in lines.items()
        )


def _of_actor(name: str, key: str, kind: Kind = NUMBER) -> Setting:
    """Return a property of the robot's articulation, which its rigid bodies state where it has none."""
    return Setting(
        name, SPAWN, f"articulation_props.{key}", kind, others=(f"rigid_props.{key}",)
    )


def _of_collider(name: str, key: str) -> Setting:
    """Return a property of the robot's colliders, which stands with the others in one call."""
    return Setting(name, COLLIDER, key, pattern="{key}={value}")


def _dialect(name: str, physx: str) -> IsaacLab:
    """Return the dialect of a version, which has its PhysxCfg at a place of its own."""
    return IsaacLab(
        name=name,
        settings=(
            Setting("timestep_s", "sim", "dt"),
            Setting("solver", physx, "solver_type", SOLVER),
            Setting("bounce_threshold_m_per_s", physx, "bounce_threshold_velocity"),
            Setting("continuous_detection", physx, "enable_ccd", FLAG),
            Setting("enhanced_determinism", physx, "enable_enhanced_determinism", FLAG),
            Setting("tolerance_length_m", physx, "friction_offset_threshold"),
            _of_actor("position_iterations", "solver_position_iteration_count", WHOLE),
            _of_actor("velocity_iterations", "solver_velocity_iteration_count", WHOLE),
            Setting("linear_damping_per_s", SPAWN, "rigid_props.linear_damping"),
            Setting("angular_damping_per_s", SPAWN, "rigid_props.angular_damping"),
            Setting(
                "max_linear_velocity_m_per_s", SPAWN, "rigid_props.max_linear_velocity"
            ),
            Setting(
                "max_depenetration_velocity_m_per_s",
                SPAWN,
                "rigid_props.max_depenetration_velocity",
            ),
            _of_actor("sleep_threshold_m2_per_s2", "sleep_threshold"),
            _of_collider("contact_offset_m", "contact_offset"),
            _of_collider("rest_offset_m", "rest_offset"),
            _of_collider("patch_radius_m", "torsional_patch_radius"),
            _of_collider("min_patch_radius_m", "min_torsional_patch_radius"),
            Setting(
                "max_angular_velocity_rad_per_s",
                SPAWN,
                "rigid_props.max_angular_velocity",
                DEGREES,
            ),
        ),
        pattern="self.{place}.{key} = {value}",
        other="self.{key} = {value}",
        places={
            COLLIDER: Place(
                form=f"self.{COLLIDER} = sim_utils.CollisionPropertiesCfg({{}})"
            )
        },
        comes_last=True,
        joint="; ",
        text=number_text,
        other_text=number_text,
        gravity="self.sim.gravity = ({})",
        is_closed=True,
    )


PHYSX = {"isaac_lab": "sim.physx", "isaac_lab_3": "sim.physics"}
"""Place of the PhysxCfg by dialect: Isaac Lab 3 has another one."""

DIALECTS = tuple(_dialect(name, place) for name, place in PHYSX.items())

RUN_FILES = ("params/env.yaml", ".hydra/config.yaml")
"""Files in the folder of a training run."""

DEFAULT = Material.constant("body", "no material: Isaac Sim's default", friction=0.5)
"""Material of a body for which neither the file nor an asset states one."""

DEFAULT_GROUND = Material.constant(
    "ground",
    "no material: Isaac Sim's default ground plane",
    friction=0.5,
    restitution=0.8,
)
"""Material that Isaac Sim's default ground plane brings along."""

NOT_CARRIED_OVER = {
    "enable_stabilization": "its additional stabilization pass",
    "enable_external_forces_every_iteration": "forces in every iteration",
    "solve_articulation_contact_last": "contacts of articulations as the last ones",
}
"""Flags of `sim.physx` that SAPIEN does not expose, and what they switch on."""

KNOWN_PHYSX = (
    *(one.key for one in DIALECTS[0].settings if one.place == PHYSX["isaac_lab"]),
    *(
        f"{end}_{kind}_iteration_count"
        for kind in ASSET_ITERATIONS
        for end in ("min", "max")
    ),
    *(*FRICTION_SCALE, *NOT_CARRIED_OVER),
)
"""Keys of `sim.physx` that are read, beside sizes of buffers."""

BUFFERS = ("gpu_", "use_gpu", "class_type", "enable_scene_query_support")
"""Starts of keys of `sim.physx` that do not change the physics."""

ISAAC_LAB_3_MARKS = (
    "physics.bounce_threshold_velocity",
    "physics.min_position_iteration_count",
)
"""Keys of `sim` that show settings of PhysX where Isaac Lab 3 has them."""

OTHER_ENGINES = ("newton_cfg", "physics", "mujoco")
"""Keys of `sim` with settings of other engines."""


def isaac_lab_configuration(
    cfg: Settings, *, name: str, source: str
) -> TrainingConfiguration:
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
            f"{name}: there is no sim.dt: give the params/env.yaml of a training run with Isaac Lab"
        )
    physx = _physx(sim)
    dialect = DIALECTS[0 if physx.path.endswith("physx") else 1]
    values = PhysxValues("isaac", dialect)
    _take_scene(sim, physx, dialect, values)
    robot = _robot(table)
    _take_actor(physx, robot, dialect, values)
    ground, foot = _materials(table, sim, robot, values)
    return values.configuration(
        table,
        name=name,
        source=source,
        gravity_m_per_s2=sim.numbers("gravity", 3),
        frame_skip=table.whole("decimation"),
        foot_contact=combined(ground, foot),
        inapplicable=_inapplicable(table, ground, foot),
    )


# --- solver ----------------------------------------------------------------------------------------------------------


def _physx(sim: Table) -> Table:
    """Return the settings of PhysX; Isaac Lab 3 has them at another place."""
    physx = sim.table("physx")
    if physx is None and any(key in sim for key in ISAAC_LAB_3_MARKS):
        physx = sim.table("physics")
    if physx is None:
        others = [key for key in OTHER_ENGINES if key in sim]
        reason = (
            f"there is {sim.name(others[0])} instead"
            if others
            else "it states no solver"
        )
        raise TargetError(
            f"{sim.source}: there is no {sim.name('physx')}, and {reason}: only PhysX is read of Isaac Lab"
        )
    return physx


def _take_scene(
    sim: Table, physx: Table, dialect: Dialect, values: PhysxValues
) -> None:
    """Take what is stated for the whole scene: the step, the solver and the length scale of friction."""
    for name, value, origin in dialect.read({"sim": sim, PHYSX[dialect.name]: physx}):
        if name == "tolerance_length_m":
            values.take(
                name,
                _length_m(physx, values),
                f"{origin} over {FRICTION_SCALE['friction_offset_threshold']}",
            )
        else:
            values.take(name, value, origin)
    for key, effect in NOT_CARRIED_OVER.items():
        if physx.flag(key):
            values.notes.append(
                f"{physx.name(key)} is not carried over: SAPIEN does not expose {effect}"
            )
    unknown = [
        key
        for key in physx.values
        if key not in KNOWN_PHYSX and not str(key).startswith(BUFFERS)
    ]
    if unknown:
        keys = ", ".join(physx.name(str(key))[:80] for key in unknown[:4])
        values.notes.append(
            f"{UNREAD}: {keys}; Isaac Lab ignores keys that its PhysxCfg lacks"
        )
    if str(sim.value("device") or "").startswith("cuda"):
        values.notes.append("training ran PhysX on the GPU; here it runs on the CPU")


def _length_m(physx: Table, values: PhysxValues) -> float | None:
    """Return the length scale that gives the two lengths of friction [m]; a note where no scale gives both."""
    offset_m, distance_m = map(physx.number, FRICTION_SCALE)
    if offset_m is None or distance_m is None:
        return None
    per_offset, per_distance = FRICTION_SCALE.values()
    length = offset_m / per_offset
    if length > 0.0 and abs(distance_m / per_distance - length) <= SAME_LENGTH * length:
        return round(length, 12)
    values.notes.append(
        f"friction_offset_threshold {offset_m:g} m and friction_correlation_distance {distance_m:g} m are not "
        "carried over: SAPIEN leaves them at 0.04 and 0.025 of one length scale, here 1 m"
    )
    return None


def _robot(table: Table) -> Table | None:
    """Return the robot: the asset of that name, or else the first articulation of the scene."""
    scene = table.part("scene")
    for key in ("scene.robot", "robot", "robot_cfg"):
        if isinstance(table.value(key), Mapping):
            return table.table(key)
    found = (
        key
        for key, value in scene.values.items()
        if isinstance(value, Mapping) and "actuators" in value
    )
    first = next(found, None)
    return None if first is None else scene.table(str(first))


def _take_actor(
    physx: Table, robot: Table | None, dialect: Dialect, values: PhysxValues
) -> None:
    """Take what the robot states for itself: iterations, damping, limits and offsets."""
    spawn = None if robot is None else robot.table("spawn")
    if spawn is None:
        values.notes.append(
            "no robot is found: what bodies state for themselves is that of Isaac Sim's schema"
        )
        spawn = Table({}, source=physx.source, path=SPAWN)
    places = {SPAWN: spawn, COLLIDER: spawn.table("collision_props")}
    for name, value, origin in dialect.read(
        {place: table for place, table in places.items() if table is not None}
    ):
        kind = name.removesuffix("_iterations")
        if kind in ASSET_ITERATIONS:
            values.take(name, *_iterations(physx, kind, value, origin, values))
        else:
            values.take(name, value, origin)
    if spawn.flag("rigid_props.disable_gravity"):
        values.notes.append(
            f"{spawn.name('rigid_props.disable_gravity')} is not carried over: the experiments have it"
        )


def _iterations(
    physx: Table, kind: str, stated: int | None, origin: str, values: PhysxValues
) -> tuple[int, str]:
    """Return the robot's count of iterations, clamped into the range of the scene, and its origin."""
    count = ASSET_ITERATIONS[kind] if stated is None else stated
    smallest_key, largest_key = (
        f"min_{kind}_iteration_count",
        f"max_{kind}_iteration_count",
    )
    low, high = physx.whole(smallest_key), physx.whole(largest_key)
    if low is not None and high is not None and low > high:
        raise TargetError(
            f"{physx.source}: {physx.name(smallest_key)} is {low}, more than the maximum of {high}: exchange them"
        )
    used = min(max(count, 0 if low is None else low), 255 if high is None else high)
    if stated is None:
        origin = "Isaac Sim's schema"
        values.notes.append(
            f"the robot states no count of {kind} iterations, so its asset decides; {used} is used"
        )
    return used, origin if used == count else f"{origin}, clamped to {physx.path}"


def _inapplicable(table: Table, ground: Material, foot: Material) -> dict[Need, str]:
    """Return what the engine cannot represent and what then cannot be judged."""
    for key in (
        "scene.terrain.physics_material",
        "terrain.physics_material",
        "sim.physics_material",
    ):
        material = table.table(key)
        is_used = material is not None and material.path in (ground.origin, foot.origin)
        if (
            material is not None
            and is_used
            and (material.number("compliant_contact_stiffness") or 0.0) > 0.0
        ):
            name = material.name("compliant_contact_stiffness")
            return {
                Need.CONTACT: f"{name} makes contacts springs, which SAPIEN does not expose"
            }
    return {}


# --- materials -------------------------------------------------------------------------------------------------------


def _materials(
    table: Table, sim: Table, robot: Table | None, values: PhysxValues
) -> tuple[Material, Material]:
    """Return the materials of the ground and of the robot, before they are combined."""
    default = stated_material(sim.table("physics_material"), "body", DEFAULT)
    ground = _ground(table, replace(default, body="ground"), values)
    robot_material = None if robot is None else robot.table("spawn.physics_material")
    if robot_material is None:
        values.notes.append(
            "a material that the robot's asset itself binds is not seen"
        )
    foot = stated_material(
        robot_material, "robot", default if robot_material is None else DEFAULT
    )
    return ground, _randomized(table, foot, values)


def _ground(table: Table, default: Material, values: PhysxValues) -> Material:
    terrain = table.table("scene.terrain") or table.table("terrain")
    if terrain is not None:
        material, kind = terrain.table("physics_material"), terrain.text("terrain_type")
        if kind == "usd":
            values.notes.append(
                f"{terrain.name('usd_path')} decides the material of the ground, which is not seen"
            )
            return default
        if material is None:
            return DEFAULT_GROUND if kind == "plane" else default
        return stated_material(material, "ground", DEFAULT)
    plane = _ground_plane(table.part("scene"))
    if plane is None:
        values.notes.append(
            "no ground is found in the file: the default material of the simulation is used for it"
        )
        return default
    material = plane.table("physics_material")
    return stated_material(
        material, "ground", DEFAULT_GROUND if material is None else DEFAULT
    )


def _ground_plane(scene: Table) -> Table | None:
    """Return what makes the first ground plane of a scene; None when there is none."""
    for key in scene.values:
        spawn = scene.value(f"{key}.spawn") if "." not in str(key) else None
        if isinstance(spawn, Mapping) and str(spawn.get("func", "")).endswith(
            "spawn_ground_plane"
        ):
            return scene.table(f"{key}.spawn")
    return None


def _randomized(table: Table, foot: Material, values: PhysxValues) -> Material:
    """Return the robot's material with the ranges that an event draws from, if there is one."""
    events = table.part("events")
    for key, value in events.values.items():
        if not isinstance(value, Mapping) or "static_friction_range" not in (
            params := events.part(f"{key}.params")
        ):
            continue
        term, asset, bodies = (
            events.name(str(key)),
            params.text("asset_cfg.name"),
            params.value("asset_cfg.body_names"),
        )
        if asset not in (None, "robot"):
            values.notes.append(
                f"{term} changes the material of {asset!r}, which is not used"
            )
            continue
        if bodies not in (None, ".*", [".*"], (".*",)):
            values.notes.append(
                f"{term} changes {bodies!r} only; they are taken for the feet"
            )
        ranges = {
            key: drawn_range(params, f"{key}_range") or foot.ranges[key]
            for key in COEFFICIENTS
        }
        return replace(foot, body="robot", origin=term, ranges=ranges)
    return foot


# --- reader ----------------------------------------------------------------------------------------------------------


def _file(target: Path) -> Path:
    """Return the file of a target: itself, or the first one of a training run's folder."""
    with suppress(OSError):
        return next(
            (target / name for name in RUN_FILES if (target / name).is_file()), target
        )
    return target


def _matches(target: Any) -> bool:
    return isinstance(target, str | Path) and has_suffix(".yaml", ".yml")(
        _file(Path(target))
    )


def _read(target: Any) -> TrainingConfiguration:
    path = _file(Path(target))
    # Every run calls its file the same; its folder tells runs apart.
    run = (
        path.parent.parent.name
        if f"{path.parent.name}/{path.name}" in RUN_FILES
        else ""
    )
    return isaac_lab_configuration(
        read_yaml(path), name=run or path.name, source=f"Isaac Lab, file {path}"
    )


READERS = (
    Reader(
        "the params/env.yaml of a training run with Isaac Lab",
        _matches,
        _read,
        has_geoms=False,
    ),
)
