"""Isaac Lab: what a training run writes down, `params/env.yaml` or `.hydra/config.yaml`.

The engine is PhysX. The file states the solver, the step, materials and rules of combination. Assets in USD may state
more, which a reader of this file cannot see; notes say where that matters. Changes are lines of Python for the
`__post_init__` of a configuration class: `self.sim.physx.bounce_threshold_velocity = 0.2`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import Need, Settings, TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import (
    Dialect,
    Entries,
    joined,
    number_text,
    settings_of,
)
from gauge_envs.tools.sanity.stacks.documents import Table, file_value, yaml_document
from gauge_envs.tools.sanity.stacks.physx import (
    COEFFICIENTS,
    SOLVERS,
    Material,
    PhysxValues,
    coefficient_range,
    combined,
    constant,
    radians,
    solver_name,
    stated_material,
)

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


def _length_m(physx: Table, key: str) -> float | None:
    """Return the length scale that gives both lengths of friction [m]; None where no scale gives both."""
    offset_m, distance_m = map(physx.number, FRICTION_SCALE)
    if offset_m is None or distance_m is None:
        return None
    per_offset, per_distance = FRICTION_SCALE.values()
    length_m = offset_m / per_offset
    is_same = abs(distance_m / per_distance - length_m) <= SAME_LENGTH * length_m
    return round(length_m, 12) if length_m > 0.0 and is_same else None


def _lines(entries: Entries) -> str:
    """Return lines of Python, properties of colliders as one call."""
    lines = {place: several for place, several in entries.items() if place != COLLIDER}
    if COLLIDER in entries:
        call = f"sim_utils.CollisionPropertiesCfg({', '.join(entries[COLLIDER])})"
        lines[COLLIDER] = [f"self.{COLLIDER} = {call}"]
    return joined("; ")(lines)


SETTINGS = """
timestep_s                         sim        dt                                      number
solver                             {physx}    solver_type                             solver
bounce_threshold_m_per_s           {physx}    bounce_threshold_velocity               number
continuous_detection               {physx}    enable_ccd                              value
enhanced_determinism               {physx}    enable_enhanced_determinism             value
tolerance_length_m                 {physx}    friction_offset_threshold               length
position_iterations                {spawn}    {actor}.solver_position_iteration_count value
velocity_iterations                {spawn}    {actor}.solver_velocity_iteration_count value
sleep_threshold_m2_per_s2          {spawn}    {actor}.sleep_threshold                 number
linear_damping_per_s               {spawn}    {body}.linear_damping                   number
angular_damping_per_s              {spawn}    {body}.angular_damping                  number
max_linear_velocity_m_per_s        {spawn}    {body}.max_linear_velocity              number
max_depenetration_velocity_m_per_s {spawn}    {body}.max_depenetration_velocity       number
max_angular_velocity_rad_per_s     {spawn}    {body}.max_angular_velocity             degrees
contact_offset_m                   {collider} contact_offset                          argument
rest_offset_m                      {collider} rest_offset                             argument
patch_radius_m                     {collider} torsional_patch_radius                  argument
min_patch_radius_m                 {collider} min_torsional_patch_radius              argument
"""
"""Settings of the backend, the place and the key of each in Isaac Lab, and the kind of its value."""


def _dialect(name: str, physx: str) -> Dialect:
    """Return the dialect of a version, which has its PhysxCfg at a place of its own."""

    def both_lengths(length_m: float) -> str:
        return "; ".join(
            f"self.{physx}.{key} = {number_text(ratio * length_m)}"
            for key, ratio in FRICTION_SCALE.items()
        )

    table = SETTINGS.format(
        physx=physx,
        spawn=SPAWN,
        collider=COLLIDER,
        actor="articulation_props",
        body="rigid_props",
    )
    kinds = {
        "solver": (solver_name, lambda solver: str(SOLVERS.index(solver)), ""),
        "length": (_length_m, both_lengths, "{value}"),
        "degrees": (radians, lambda speed: number_text(math.degrees(speed)), ""),
        "argument": (Table.number, None, "{key}={value}"),
    }
    return Dialect(
        name=name,
        settings=settings_of(table, kinds),
        pattern="self.{place}.{key} = {value}",
        join=_lines,
        text=number_text,
        is_closed=True,
    )


ISAAC_LAB = _dialect("isaac_lab", "sim.physx")
ISAAC_LAB_3 = _dialect("isaac_lab_3", "sim.physics")
"""Isaac Lab 3 has its PhysxCfg at another place."""

RUN_FILES = ("params/env.yaml", ".hydra/config.yaml")
"""Files in the folder of a training run."""

DEFAULT = constant("no material: Isaac Sim's default", friction=0.5)
"""Material of a body for which neither the file nor an asset states one."""

DEFAULT_GROUND = constant(
    "no material: Isaac Sim's default ground plane", friction=0.5, restitution=0.8
)
"""Material that Isaac Sim's default ground plane brings along."""

NOT_CARRIED_OVER = {
    "enable_stabilization": "its additional stabilization pass",
    "enable_external_forces_every_iteration": "forces in every iteration",
    "solve_articulation_contact_last": "contacts of articulations as the last ones",
}
"""Flags of `sim.physx` that SAPIEN does not expose, and what they switch on."""

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
    table = Table(cfg, source=name)
    if "sim" not in table and "env.sim" in table:
        table = table.part("env")
    sim = table.part("sim")
    if "dt" not in sim:
        raise TargetError(
            f"{name}: there is no sim.dt: give the params/env.yaml of a training run with Isaac Lab"
        )
    physx = _physx(sim)
    dialect = ISAAC_LAB if physx.path.endswith("physx") else ISAAC_LAB_3
    values = PhysxValues(dialect=dialect, settings={"preset": "isaac"})
    robot = _robot(table)
    spawn = None if robot is None else robot.table("spawn")
    if spawn is None:
        values.notes.append(
            "no robot is found: what bodies state for themselves is that of Isaac Sim's schema"
        )
        spawn = Table({}, source=name, path=SPAWN)
    place = "sim.physx" if dialect is ISAAC_LAB else "sim.physics"
    places = {"sim": sim, place: physx, SPAWN: spawn}
    if collider := spawn.table("collision_props"):
        places[COLLIDER] = collider
    values.take_places(places)
    for kind in ASSET_ITERATIONS:
        _clamp_iterations(physx, kind, values)
    _note_scene(sim, physx, spawn, values)
    ground, foot = _materials(table, sim, robot, values)
    return values.configuration(
        table,
        source=source,
        gravity_m_per_s2=sim.numbers("gravity", 3),
        frame_skip=table.value("decimation"),
        foot_contact=combined(ground, foot),
        inapplicable=_springs(table, ground, foot),
    )


# --- solver ----------------------------------------------------------------------------------------------------------


def _physx(sim: Table) -> Table:
    """Return the settings of PhysX; Isaac Lab 3 has them at another place."""
    physx, other = sim.table("physx"), sim.value("physics")
    if physx is None and isinstance(other, Mapping):
        is_physx = "bounce_threshold_velocity" in other
        physx = sim.table("physics") if is_physx else None
    if physx is None:
        others = [sim.name(key) for key in OTHER_ENGINES if key in sim]
        reason = f"there is {others[0]} instead" if others else "it states no solver"
        raise TargetError(
            f"{sim.source}: there is no {sim.name('physx')}, and {reason}: only PhysX is read of Isaac Lab"
        )
    return physx


def _note_scene(sim: Table, physx: Table, spawn: Table, values: PhysxValues) -> None:
    """Note what the file states and no setting has."""
    if "tolerance_length_m" not in values.settings and all(
        key in physx for key in FRICTION_SCALE
    ):
        stated = " and ".join(f"{k} {physx.number(k):g} m" for k in FRICTION_SCALE)
        values.notes.append(
            f"{stated} are not carried over: SAPIEN leaves them at 0.04 and 0.025 of one length scale, here 1 m"
        )
    for key, effect in NOT_CARRIED_OVER.items():
        if physx.value(key):
            values.notes.append(
                f"{physx.name(key)} is not carried over: SAPIEN does not expose {effect}"
            )
    if str(sim.value("device") or "").startswith("cuda"):
        values.notes.append("training ran PhysX on the GPU; here it runs on the CPU")
    if spawn.value("rigid_props.disable_gravity"):
        values.notes.append(
            f"{spawn.name('rigid_props.disable_gravity')} is not carried over: the experiments have it"
        )


def _robot(table: Table) -> Table | None:
    """Return the robot: the asset of that name, or else the first articulation of the scene."""
    scene = table.part("scene")
    others = [f"scene.{key}" for key in scene.values if f"{key}.actuators" in scene]
    keys = ["scene.robot", "robot", "robot_cfg", *others]
    found = (key for key in keys if isinstance(table.value(key), Mapping))
    first = next(found, None)
    return None if first is None else table.table(first)


def _clamp_iterations(physx: Table, kind: str, values: PhysxValues) -> None:
    """Clamp the robot's count of iterations into the range of the scene."""
    name = f"{kind}_iterations"
    count, origin = values.settings.get(name), values.origins.get(name)
    low, high = (
        physx.number(f"{end}_{kind}_iteration_count") for end in ("min", "max")
    )
    if low is not None and high is not None and low > high:
        key = physx.name(f"min_{kind}_iteration_count")
        raise TargetError(
            f"{physx.source}: {key} is {low:g}, more than the maximum of {high:g}: exchange them"
        )
    stated = ASSET_ITERATIONS[kind] if count is None else count
    used = int(min(max(stated, low or 0), 255 if high is None else high))
    if count is None:
        origin = "Isaac Sim's schema"
        values.notes.append(
            f"the robot states no count of {kind} iterations, so its asset decides; {used} is used"
        )
    clamped = "" if used == stated else f", clamped to {physx.path}"
    values.take(name, used, f"{origin}{clamped}")


# --- materials -------------------------------------------------------------------------------------------------------


def _springs(table: Table, ground: Material, foot: Material) -> dict[Need, str]:
    """Return what cannot be judged where a material that counts makes contacts springs."""
    for key in ("scene.terrain", "terrain", "sim"):
        material = table.part(f"{key}.physics_material")
        stiffness = material.number("compliant_contact_stiffness")
        if stiffness and material.path in (ground.origin, foot.origin):
            name = material.name("compliant_contact_stiffness")
            reason = f"{name} makes contacts springs, which SAPIEN does not expose"
            return {Need.CONTACT: reason}
    return {}


def _materials(
    table: Table, sim: Table, robot: Table | None, values: PhysxValues
) -> tuple[Material, Material]:
    """Return the materials of the ground and of the robot, before they are combined."""
    default = stated_material(sim.table("physics_material"), "body", DEFAULT)
    ground = _ground(table, replace(default, body="ground"), values)
    stated = None if robot is None else robot.table("spawn.physics_material")
    if stated is None:
        values.notes.append(
            "a material that the robot's asset itself binds is not seen"
        )
    foot = stated_material(stated, "robot", DEFAULT if stated else default)
    return ground, _randomized(table, foot, values)


def _ground(table: Table, default: Material, values: PhysxValues) -> Material:
    terrain = table.table("scene.terrain") or table.table("terrain")
    is_plane = terrain is None or terrain.value("terrain_type") == "plane"
    if terrain is None:
        scene = table.part("scene")
        planes = (
            scene.part(f"{key}.spawn")
            for key, value in scene.values.items()
            if isinstance(value, Mapping) and isinstance(value.get("spawn"), Mapping)
        )
        terrain = next(
            (p for p in planes if "spawn_ground_plane" in str(p.value("func"))), None
        )
    unseen = ""
    if terrain is None:
        unseen = "no ground is found in the file: the default material of the simulation is used for it"
    elif terrain.value("terrain_type") == "usd":
        unseen = f"{terrain.name('usd_path')} decides the material of the ground, which is not seen"
    if terrain is None or unseen:
        values.notes.append(unseen)
        return default
    material = terrain.table("physics_material")
    if material is None:
        return DEFAULT_GROUND if is_plane else default
    return stated_material(material, "ground", DEFAULT)


def _randomized(table: Table, foot: Material, values: PhysxValues) -> Material:
    """Return the robot's material with the ranges that an event draws from, if there is one."""
    events = table.part("events")
    for key, value in events.values.items():
        if not isinstance(value, Mapping):
            continue
        term, params = events.name(str(key)), events.part(f"{key}.params")
        if "static_friction_range" not in params:
            continue
        asset, bodies = (params.value(f"asset_cfg.{k}") for k in ("name", "body_names"))
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
            key: coefficient_range(params, f"{key}_range") or foot.ranges[key]
            for key in COEFFICIENTS
        }
        return replace(foot, body="robot", origin=term, ranges=ranges)
    return foot


# --- files -----------------------------------------------------------------------------------------------------------


def file_of_run(folder: Path) -> Path:
    """Return the file of the folder of a training run, or the folder itself."""
    files = (folder / name for name in RUN_FILES)
    return next((file for file in files if file.is_file()), folder)


def read_file(path: Path, pair: object = None) -> TrainingConfiguration:
    """Return the configuration of a file; a run, whose files are all called the same, has the name of its folder."""
    is_of_run = f"{path.parent.name}/{path.name}" in RUN_FILES
    name = path.parent.parent.name if is_of_run else path.name
    cfg = file_value(path, yaml_document)
    source = f"Isaac Lab, file {path}"
    return isaac_lab_configuration(cfg, name=name or path.name, source=source)
