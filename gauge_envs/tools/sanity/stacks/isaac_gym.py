"""IsaacGym's style: configurations of legged_gym, IsaacGymEnvs, HumanoidVerse and ProtoMotions.

All of them have a table `sim` with a table `physx` in it, somewhere in the file. The engine is PhysX, whose materials
IsaacGym combines by their mean. Changes are lines `sim.physx.bounce_threshold_velocity = 0.2`: Python for a
configuration object, and overrides on the command line of Hydra without the spaces.
"""

import inspect
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import Settings, TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import (
    WHOLE,
    Dialect,
    Kind,
    Setting,
    number_text,
)
from gauge_envs.tools.sanity.stacks.documents import MOST_YAML_BYTES, Table, read_yaml
from gauge_envs.tools.sanity.stacks.physx import (
    SOLVER,
    Material,
    PhysxValues,
    combined,
    drawn_range,
    stated_material,
)
from gauge_envs.tools.sanity.stacks.reader import Reader, named_content

MARK = "num_position_iterations"
"""Key of this style."""

ISAAC_LAB_MARK = "max_position_iteration_count"
"""Key of Isaac Lab beside which `MARK` is a mistake that it ignores."""

PHYSX, ASSET = "sim.physx", "asset"

STEP = Kind(text=lambda step_s: f"{number_text(step_s)}; sim.substeps = 1")
"""Step of the engine, which `dt` is only without substeps."""

ISAAC_GYM = Dialect(
    name="isaac_gym",
    settings=(
        Setting("timestep_s", "sim", "dt", STEP),
        Setting("solver", PHYSX, "solver_type", SOLVER),
        Setting("position_iterations", PHYSX, MARK, WHOLE),
        Setting("velocity_iterations", PHYSX, "num_velocity_iterations", WHOLE),
        Setting("bounce_threshold_m_per_s", PHYSX, "bounce_threshold_velocity"),
        Setting("contact_offset_m", PHYSX, "contact_offset"),
        Setting("rest_offset_m", PHYSX, "rest_offset"),
        Setting(
            "max_depenetration_velocity_m_per_s", PHYSX, "max_depenetration_velocity"
        ),
        Setting("linear_damping_per_s", ASSET, "linear_damping"),
        Setting("angular_damping_per_s", ASSET, "angular_damping"),
        Setting("max_linear_velocity_m_per_s", ASSET, "max_linear_velocity"),
        Setting("max_angular_velocity_rad_per_s", ASSET, "max_angular_velocity"),
    ),
    pattern="{place}.{key} = {value}",
    joint="; ",
    text=number_text,
    other_text=number_text,
    gravity="sim.gravity = [{}]",
    is_closed=True,
)

PLACES = (
    "sim",
    "simulator.config.sim",
    "task.sim",
    "env.sim",
    "cfg.sim",
    "simulator.sim",
)
"""Places of the table `sim`."""

GROUNDS = (
    "terrain",
    "plane",
    "simulator.config.plane",
    "env.plane",
    "task.env.plane",
    "simulator.plane",
)
"""Places of the material of the ground."""

DRAWN = ("domain_rand", "env.domain_rand", "env.config.domain_rand")
"""Places of ranges from which the robot's friction is drawn."""

DECIMATIONS = (
    "control.decimation",
    "env.controlFrequencyInv",
    "env.control.decimation",
    "task.env.controlFrequencyInv",
)
"""Keys of the number of steps for one action, beside those of `sim` itself."""

CAMEL_CASE = {
    "static_friction": "staticFriction",
    "dynamic_friction": "dynamicFriction",
    "restitution": "restitution",
}
"""Keys of a material in IsaacGymEnvs."""

MOST_DEPTH = 8
"""Largest depth of attributes of a configuration in this process."""

DEFAULT = Material.constant("body", "not stated: 1.0", friction=1.0)
"""Material of a body for which the file states none."""


def isaac_gym_configuration(
    cfg: Settings, *, name: str, source: str
) -> TrainingConfiguration:
    """Return the training configuration of an environment in the style of IsaacGym.

    Args:
        cfg: The configuration as nested tables.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    table = Table(cfg, source=name)
    sim = next(
        (
            found
            for place in PLACES
            if (found := _table(table, place)) is not None and "physx" in found
        ),
        None,
    )
    physx = None if sim is None else sim.table("physx")
    if sim is None or physx is None:
        raise TargetError(
            f"{name}: there is no table sim.physx; looked for {', '.join(PLACES)}"
        )
    values = PhysxValues("isaac", ISAAC_GYM)
    substeps = sim.whole("substeps") or 1
    if substeps < 1:
        raise TargetError(
            f"{name}: {sim.name('substeps')} is {substeps}: give 1 or more"
        )
    dt, origin = _step(sim)
    values.take(
        "timestep_s",
        dt / substeps,
        origin if substeps == 1 else f"{origin}, in {substeps} substeps",
    )
    values.take_places({PHYSX: physx})
    if physx.flag("enable_stabilization"):
        values.notes.append(
            f"{physx.name('enable_stabilization')} is not carried over: SAPIEN does not expose it"
        )
    asset = table.table("asset")
    if asset is None:
        values.notes.append(
            "damping and caps on speeds are not stated: they are those of this package's preset isaac"
        )
    else:
        values.take_places({ASSET: asset})
    values.notes.append(
        "gym's friction offset threshold and correlation distance are taken as 0.04 m and 0.025 m"
    )
    decimation = sim.whole("control_decimation") or sim.whole("decimation")
    decimation = decimation or next(
        (count for key in DECIMATIONS if (count := table.whole(key)) is not None), None
    )
    return values.configuration(
        table,
        name=name,
        source=source,
        gravity_m_per_s2=_gravity(sim),
        frame_skip=None if decimation is None else decimation * substeps,
        foot_contact=combined(_ground(table), _foot(table)),
    )


def _table(table: Table, key: str) -> Table | None:
    """Return a table; None where the value is something else."""
    return table.table(key) if isinstance(table.value(key), Mapping) else None


def _step(sim: Table) -> tuple[float, str]:
    """Return the step before it is divided into substeps [s], and its key."""
    step, rate = sim.number("dt"), sim.number("fps")
    if step is not None:
        return step, sim.name("dt")
    if rate is None or not 0.0 < rate < float("inf"):
        raise TargetError(
            f"{sim.source}: there is neither {sim.name('dt')} nor a positive {sim.name('fps')}: add one"
        )
    return 1.0 / rate, f"1 / {sim.name('fps')}"


def _gravity(sim: Table) -> tuple[float, ...] | None:
    """Return gravity with z upwards [m/s^2]; None when the file states none."""
    gravity = sim.numbers("gravity", 3)
    if gravity is None or sim.value("up_axis") not in ("y", 0):
        return gravity
    x, y, z = gravity
    return x, -z, y


def _ground(table: Table) -> Material:
    for place in GROUNDS:
        ground = _table(table, place)
        if ground is not None and "dynamicFriction" in ground:
            values = {name: ground.value(key) for name, key in CAMEL_CASE.items()}
            ground = Table(values, source=ground.source, path=ground.path)
        if ground is not None and (
            "dynamic_friction" in ground or "static_friction" in ground
        ):
            return stated_material(ground, "ground", DEFAULT)
    return stated_material(None, "ground", DEFAULT)


def _foot(table: Table) -> Material:
    """Return the material of the robot, with the range from which its friction is drawn."""
    drawn = next(
        (
            one
            for place in DRAWN
            if (one := _table(table, place)) and one.flag("randomize_friction")
        ),
        None,
    )
    if drawn is None:
        return stated_material(None, "robot", DEFAULT)
    ends, key = drawn_range(drawn, "friction_range"), drawn.name("friction_range")
    if ends is None:
        raise TargetError(
            f"{drawn.source}: there is no {key}: give two numbers of 0 or more"
        )
    ranges = {**DEFAULT.ranges, "static_friction": ends, "dynamic_friction": ends}
    return replace(DEFAULT, body="robot", origin=key, ranges=ranges)


# --- reader ----------------------------------------------------------------------------------------------------------


def _plain(value: Any, depth: int = MOST_DEPTH) -> Any:
    """Return nested objects as tables, as legged_gym's classes of attributes."""
    is_plain = value is None or isinstance(
        value, Mapping | str | int | float | list | tuple
    )
    if is_plain or not depth or not hasattr(value, "__dict__"):
        return value
    names = [
        key
        for key in dir(value)
        if not key.startswith("_") and not inspect.isroutine(getattr(value, key, None))
    ]
    return {key: _plain(getattr(value, key), depth - 1) for key in names}


def _matches(target: Any) -> bool:
    if isinstance(target, str | Path):
        content = named_content(target, (".yaml", ".yml"), MOST_YAML_BYTES)
        return MARK.encode() in content and ISAAC_LAB_MARK.encode() not in content
    if isinstance(target, Mapping):
        return any(_has_mark(target, place) for place in PLACES)
    physx = getattr(getattr(target, "sim", None), "physx", None)
    return hasattr(physx, MARK) and not hasattr(physx, ISAAC_LAB_MARK)


def _has_mark(values: Any, place: str) -> bool:
    for part in (*place.split("."), "physx"):
        values = values.get(part) if isinstance(values, Mapping) else None
    return (
        isinstance(values, Mapping) and MARK in values and ISAAC_LAB_MARK not in values
    )


def _read(target: Any) -> TrainingConfiguration:
    if isinstance(target, str | Path):
        path = Path(target)
        source = f"configuration in the style of IsaacGym, file {path}"
        return isaac_gym_configuration(read_yaml(path), name=path.name, source=source)
    name = "configuration" if isinstance(target, Mapping) else type(target).__name__
    return isaac_gym_configuration(
        _plain(target), name=name, source="configuration in the style of IsaacGym"
    )


DIALECTS = (ISAAC_GYM,)

READERS = (
    Reader(
        "a YAML file of legged_gym, HumanoidVerse or ProtoMotions with its sim.physx",
        _matches,
        _read,
        has_geoms=False,
    ),
)
