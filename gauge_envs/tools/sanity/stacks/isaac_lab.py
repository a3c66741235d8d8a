"""Isaac Lab: what a training run writes down, `params/env.yaml` or `.hydra/config.yaml`.

The engine is PhysX. The file states the solver, the step, materials and rules of combination. Assets in USD may state
more, which a reader of this file cannot see; notes say where that matters. Changes are lines of Python for the
`__post_init__` of a configuration class: `self.sim.physx.bounce_threshold_velocity = 0.2`.
"""

import math
from dataclasses import replace
from pathlib import Path

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import Need, Settings, TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import (
    Dialect,
    Entries,
    Table,
    joined,
    not_carried_over,
    python_text,
    settings_of,
)
from gauge_envs.tools.sanity.stacks.documents import file_value, yaml_document
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


def _length_m(physx: Table, key: str) -> float | None:
    """Return the length scale that gives both lengths of friction [m]; None where no scale gives both."""
    scales_m = [
        (physx.number(key) or 0.0) / ratio for key, ratio in FRICTION_SCALE.items()
    ]
    is_same = math.isclose(*scales_m, rel_tol=1e-6)
    return round(scales_m[0], 12) if is_same and scales_m[0] > 0.0 else None


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
position_iterations                {spawn}    {body}.solver_position_iteration_count  value
velocity_iterations                {spawn}    {body}.solver_velocity_iteration_count  value
position_iterations                {spawn}    {actor}.solver_position_iteration_count value
velocity_iterations                {spawn}    {actor}.solver_velocity_iteration_count value
sleep_threshold_m2_per_s2          {spawn}    {body}.sleep_threshold                  number
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
"""Settings of the backend, the place and the key of each in Isaac Lab, and the kind of its value; the last key wins."""


def _dialect(name: str, physx: str) -> Dialect:
    """Return the dialect of a version, which has its PhysxCfg at a place of its own."""

    def both_lengths(length_m: float) -> str:
        return "; ".join(
            f"self.{physx}.{key} = {python_text(ratio * length_m)}"
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
        "degrees": (radians, lambda speed: python_text(math.degrees(speed)), ""),
        "argument": (Table.number, None, "{key}={value}"),
    }
    return Dialect(
        name=name,
        settings=settings_of(table, kinds),
        pattern="self.{place}.{key} = {value}",
        join=_lines,
        text=python_text,
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

UNKNOWN_TO_SAPIEN = (
    "enable_stabilization",
    "enable_external_forces_every_iteration",
    "solve_articulation_contact_last",
)
"""Flags of `sim.physx` that SAPIEN does not expose."""

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
    table = table if table.part("sim") else table.part("env")
    sim = table.part("sim")
    if sim.value("dt") is None:
        raise TargetError(
            f"{name}: there is no sim.dt: give the params/env.yaml of a training run with Isaac Lab"
        )
    physx = _physx(sim)
    dialect = ISAAC_LAB if physx.path.endswith("physx") else ISAAC_LAB_3
    values = PhysxValues(dialect=dialect, settings={"preset": "isaac"})
    robot = _robot(table)
    spawn = robot.part("spawn")
    if not spawn:
        values.notes.append(
            "no robot is found: what bodies state for themselves is that of Isaac Sim's schema"
        )
    place = "sim.physx" if dialect is ISAAC_LAB else "sim.physics"
    places = {"sim": sim, place: physx, SPAWN: spawn}
    values.take_places(places | {COLLIDER: spawn.part("collision_props")})
    for kind in ASSET_ITERATIONS:
        _clamp_iterations(physx, kind, values)
    _note_scene(sim, physx, spawn, values)
    ground, foot = _materials(table, sim, spawn, values)
    reasons = {}
    if spring := ground.spring or foot.spring:
        reasons[Need.CONTACT] = (
            f"{spring} makes contacts springs, which SAPIEN does not expose"
        )
    return values.configuration(
        table,
        source=source,
        gravity_m_per_s2=sim.numbers("gravity", 3),
        frame_skip=table.value("decimation"),
        foot_contact=combined(ground, foot),
        inapplicable=reasons,
    )


# --- solver ----------------------------------------------------------------------------------------------------------


def _physx(sim: Table) -> Table:
    """Return the settings of PhysX; Isaac Lab 3 has them at another place."""
    physx, physics = sim.part("physx"), sim.part("physics")
    if physx or physics.value("bounce_threshold_velocity") is not None:
        return physx or physics
    others = [sim.name(key) for key in OTHER_ENGINES if sim.value(key)]
    reason = f"there is {others[0]} instead" if others else "it states no solver"
    raise TargetError(
        f"{sim.source}: there is no {sim.name('physx')}, and {reason}: only PhysX is read of Isaac Lab"
    )


def _note_scene(sim: Table, physx: Table, spawn: Table, values: PhysxValues) -> None:
    """Note what the file states and no setting has."""
    lengths_m = {key: physx.number(key) for key in FRICTION_SCALE}
    if "tolerance_length_m" not in values.settings and None not in lengths_m.values():
        stated = " and ".join(f"{key} {size:g} m" for key, size in lengths_m.items())
        values.notes.append(
            f"{stated} are not carried over: SAPIEN leaves them at 0.04 and 0.025 of one length scale, here 1 m"
        )
    values.notes += not_carried_over(physx, *UNKNOWN_TO_SAPIEN)
    values.notes += not_carried_over(spawn, "rigid_props.disable_gravity")
    if str(sim.value("device")).startswith("cuda"):
        values.notes.append("training ran PhysX on the GPU; here it runs on the CPU")


def _robot(table: Table) -> Table:
    """Return the robot: the asset of that name, or else the first articulation of the scene."""
    scene = table.part("scene").values
    others = [key for key in scene if table.value(f"scene.{key}.actuators") is not None]
    keys = ["scene.robot", "robot", "robot_cfg", *(f"scene.{key}" for key in others)]
    return next(filter(None, map(table.part, keys)), table.part(keys[0]))


def _clamp_iterations(physx: Table, kind: str, values: PhysxValues) -> None:
    """Clamp the robot's count of iterations into the range of the scene."""
    name = f"{kind}_iterations"
    stated = values.settings.get(name, ASSET_ITERATIONS[kind])
    origin = values.origins.get(name, "Isaac Sim's schema: the robot's asset decides")
    low, high = (
        physx.number(f"{end}_{kind}_iteration_count") for end in ("min", "max")
    )
    used = int(min(max(stated, low or 0), 255 if high is None else high))
    clamped = "" if used == stated else f", clamped to {physx.path}"
    values.take(name, used, f"{origin}{clamped}")


# --- materials -------------------------------------------------------------------------------------------------------


def _materials(
    table: Table, sim: Table, spawn: Table, values: PhysxValues
) -> tuple[Material, Material]:
    """Return the materials of the ground and of the robot, before they are combined."""
    default = stated_material(sim.part("physics_material"), "body", DEFAULT)
    ground = _ground(table, replace(default, body="ground"), values)
    stated = spawn.part("physics_material")
    if not stated:
        values.notes.append(
            "a material that the robot's asset itself binds is not seen"
        )
    foot = stated_material(stated, "robot", DEFAULT if stated else default)
    return ground, _randomized(table, foot, values)


def _ground(table: Table, default: Material, values: PhysxValues) -> Material:
    terrain = table.part("scene.terrain") or table.part("terrain")
    is_plane = not terrain or terrain.value("terrain_type") == "plane"
    if not terrain:
        spawns = [
            table.part(f"scene.{key}.spawn") for key in table.part("scene").values
        ]
        planes = (p for p in spawns if "spawn_ground_plane" in str(p.value("func")))
        terrain = next(planes, terrain)
    unseen = ""
    if not terrain:
        unseen = "no ground is found in the file: the default material of the simulation is used for it"
    elif terrain.value("terrain_type") == "usd":
        unseen = f"{terrain.name('usd_path')} decides the material of the ground, which is not seen"
    if unseen:
        values.notes.append(unseen)
        return default
    material = terrain.part("physics_material")
    if not material:
        return DEFAULT_GROUND if is_plane else default
    return stated_material(material, "ground", DEFAULT)


def _randomized(table: Table, foot: Material, values: PhysxValues) -> Material:
    """Return the robot's material with the ranges that an event draws from, if there is one."""
    events = table.part("events")
    for key in events.values:
        term, params = events.name(key), events.part(f"{key}.params")
        if params.value("static_friction_range") is None:
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
