"""Isaac Lab: what a training run writes down, `params/env.yaml` or `.hydra/config.yaml`.

The engine is PhysX. The file has the solver, the step and materials; checks need only whether a material has a
restitution or is a spring. Assets in USD may have more, which a reader of this file cannot see. Changes are lines of
Python for the `__post_init__` of a configuration class: `self.sim.physx.bounce_threshold_velocity = 0.2`.
"""

from collections.abc import Mapping
from pathlib import Path

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.readers.dialect import (
    Dialect,
    Entries,
    NestedTable,
    joined,
    not_carried_over,
    python_text,
    settings_of,
)
from gauge_envs.tools.sanity.readers.documents import file_value, yaml_document
from gauge_envs.tools.sanity.readers.physx import GRAVITY, KINDS, physx_configuration
from gauge_envs.tools.sanity.training import Settings, TrainingConfiguration

SPRING = "physics_material.compliant_contact_stiffness"
"""Key that makes contacts of a body springs."""

SPAWN = "scene.robot.spawn"

COLLIDER = f"{SPAWN}.collision_props"
"""Properties of colliders. Most robots have none, so they are written as a whole."""

ASSET_ITERATIONS = {"position": 16, "velocity": 1}
"""Default counts of iterations in Isaac Sim's schema."""


def _python_lines(entries: Entries) -> str:
    """Return lines of Python, properties of colliders as one call."""
    lines = {place: texts for place, texts in entries.items() if place != COLLIDER}
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
position_iterations                {spawn}    {body}.solver_position_iteration_count  value
velocity_iterations                {spawn}    {body}.solver_velocity_iteration_count  value
position_iterations                {spawn}    {actor}.solver_position_iteration_count value
velocity_iterations                {spawn}    {actor}.solver_velocity_iteration_count value
sleep_threshold_m2_per_s2          {spawn}    {body}.sleep_threshold                  number
sleep_threshold_m2_per_s2          {spawn}    {actor}.sleep_threshold                 number
linear_damping_per_s               {spawn}    {body}.linear_damping                   number
angular_damping_per_s              {spawn}    {body}.angular_damping                  number
max_linear_velocity_m_per_s        {spawn}    {body}.max_linear_velocity              speed
max_depenetration_velocity_m_per_s {spawn}    {body}.max_depenetration_velocity       speed
max_angular_velocity_rad_per_s     {spawn}    {body}.max_angular_velocity             degrees
contact_offset_m                   {collider} contact_offset                          argument
rest_offset_m                      {collider} rest_offset                             argument
patch_radius_m                     {collider} torsional_patch_radius                  argument
min_patch_radius_m                 {collider} min_torsional_patch_radius              argument
"""
"""Settings of the backend, the place and the key of each in Isaac Lab, and the kind of its value; the last key wins."""


def _dialect(name: str, physx: str) -> Dialect:
    """Return the dialect of a version, which has its PhysxCfg at a place of its own."""
    table = SETTINGS.format(
        physx=physx,
        spawn=SPAWN,
        collider=COLLIDER,
        actor="articulation_props",
        body="rigid_props",
    )
    return Dialect(
        name=name,
        settings=settings_of(table, KINDS),
        pattern="self.{place}.{key} = {value}",
        join=_python_lines,
        text=python_text,
        is_closed=True,
    )


ISAAC_LAB = _dialect("isaac_lab", "sim.physx")
ISAAC_LAB_3 = _dialect("isaac_lab_3", "sim.physics")
"""Isaac Lab 3 has its PhysxCfg at another place."""

RUN_FILES = ("params/env.yaml", ".hydra/config.yaml")
"""Files in the folder of a training run."""

UNKNOWN_TO_SAPIEN = {
    "friction_offset_threshold": 0.04,
    "friction_correlation_distance": 0.025,
    "enable_stabilization": False,
    "enable_external_forces_every_iteration": False,
    "solve_articulation_contact_last": False,
}
"""Keys of `sim.physx` that SAPIEN does not expose, with its values."""

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
    table = NestedTable(cfg, source=name)
    if not table.part("sim"):
        table = table.part("env")
    sim = table.part("sim")
    if sim.value("dt") is None:
        raise TargetError(
            f"{name}: there is no sim.dt: give the params/env.yaml of a training run with Isaac Lab"
        )
    physx, dialect = _physx(sim)
    robot = _robot(table)
    spawn = robot.part("spawn")
    places = {"sim": sim, "sim.physx": physx, "sim.physics": physx, SPAWN: spawn}
    places[COLLIDER] = spawn.part("collision_props")
    settings = dialect.read(places)
    settings["preset"] = "isaac", "not given: this package's preset"
    for kind, count in ASSET_ITERATIONS.items():
        name = f"{kind}_iterations"
        default = count, "Isaac Sim's schema: the robot's asset decides"
        settings[name] = _clamped(physx, kind, *settings.get(name, default))
    notes = [
        *not_carried_over(physx, UNKNOWN_TO_SAPIEN),
        *not_carried_over(spawn, {"rigid_props.disable_gravity": False}),
    ]
    if not spawn:
        notes.append(
            "no robot is in the file: settings of bodies are the defaults of Isaac Sim's schema"
        )
    if str(sim.value("device")).startswith("cuda"):
        notes.append("training ran PhysX on the GPU; here it runs on the CPU")
    materials = (sim, table.part("scene.terrain"), table.part("terrain"), spawn)
    springs = [part.name(SPRING) for part in materials if part.number(SPRING)]
    return physx_configuration(
        table,
        settings,
        source=source,
        gravity_m_per_s2=sim.numbers("gravity", 3) or GRAVITY,
        frame_skip=table.value("decimation"),
        notes=tuple(notes),
        bounces=_bounces(table),
        springs=springs[0] if springs else "",
        language=dialect.name,
    )


# --- solver ----------------------------------------------------------------------------------------------------------


def _physx(sim: NestedTable) -> tuple[NestedTable, Dialect]:
    """Return the settings of PhysX, and the dialect; Isaac Lab 3 has them at another place."""
    physx, physics = sim.part("physx"), sim.part("physics")
    if physx:
        return physx, ISAAC_LAB
    if physics.value("bounce_threshold_velocity") is not None:
        return physics, ISAAC_LAB_3
    engines = [sim.name(key) for key in OTHER_ENGINES if sim.value(key)]
    reason = f"there is {engines[0]} instead" if engines else "it has no solver"
    raise TargetError(
        f"{sim.source}: there is no {sim.name('physx')}, and {reason}: only PhysX is read of Isaac Lab"
    )


def _robot(table: NestedTable) -> NestedTable:
    """Return the robot: the asset of that name, or else the first articulation of the scene."""
    scene = table.part("scene").values
    assets = [key for key in scene if table.value(f"scene.{key}.actuators") is not None]
    keys = ["scene.robot", "robot", "robot_cfg", *(f"scene.{key}" for key in assets)]
    return next(filter(None, map(table.part, keys)), table.part(keys[0]))


def _clamped(physx: NestedTable, kind: str, count: int, origin: str) -> tuple[int, str]:
    """Return a count of iterations of the robot, clamped into the range of the scene, and its origin."""
    low, high = (
        physx.number(f"{end}_{kind}_iteration_count") for end in ("min", "max")
    )
    used = int(min(max(count, low or 0), 255 if high is None else high))
    return used, origin if used == count else f"{origin}, clamped to {physx.path}"


def _bounces(table: NestedTable) -> bool:
    """Return whether a material in a table, or a range that an event draws from, has a restitution."""
    ends = (table.numbers(key, 2) for key in ("restitution", "restitution_range"))
    parts = (key for key, value in table.values.items() if isinstance(value, Mapping))
    return any(map(any, filter(None, ends))) or any(
        _bounces(table.part(str(key))) for key in parts
    )


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
