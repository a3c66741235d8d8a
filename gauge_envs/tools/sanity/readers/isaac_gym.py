"""Read configurations in the style of IsaacGym: legged_gym, IsaacGymEnvs, HumanoidVerse, ProtoMotions.

All of them have a table `sim` with a table `physx` in it, somewhere in the file. The engine is PhysX, whose materials
IsaacGym combines by their mean.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import read_regular
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.readers.materials import Material, combined, of_body, one_value, stated_material
from gauge_envs.tools.sanity.readers.physx_values import PhysxValues, solver_name
from gauge_envs.tools.sanity.readers.reader import Reader
from gauge_envs.tools.sanity.readers.table import Table
from gauge_envs.tools.sanity.readers.yaml_document import MOST_YAML_BYTES, read_yaml

MARK = "num_position_iterations"
"""Key that only this style has."""

PLACES = ("sim", "simulator.config.sim", "task.sim", "env.sim", "cfg.sim", "simulator.sim")
"""Places of the table `sim`."""

GROUNDS = ("terrain", "plane", "simulator.config.plane", "env.plane", "task.env.plane", "simulator.plane")
"""Places of the material of the ground."""

MOST_DEPTH = 8
"""Largest depth of attributes of a configuration in this process."""

DEFAULT_MATERIAL = Material(
    body="body",
    origin="not stated: 1.0",
    static_friction=one_value(1.0),
    dynamic_friction=one_value(1.0),
    restitution=one_value(0.0),
)
"""Material of a body for which the file states none."""

FLAGS = ("enable_stabilization",)


def isaac_gym_configuration(cfg: Mapping[str, Any], *, name: str, source: str) -> TrainingConfiguration:
    """Return the training configuration of an environment in the style of IsaacGym.

    Args:
        cfg: The configuration as nested tables.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    table = Table(cfg, source=name)
    sim = next((found for place in PLACES if (found := _table(table, place)) is not None and "physx" in found), None)
    physx = None if sim is None else sim.table("physx")
    if sim is None or physx is None:
        raise TargetError(f"{name}: there is no table sim.physx; looked for {', '.join(PLACES)}")
    values = PhysxValues("isaac")
    substeps = sim.whole("substeps") or 1
    if substeps < 1:
        raise TargetError(f"{name}: {sim.name('substeps')} is {substeps}: give 1 or more")
    dt, origin = _step(sim)
    values.take("timestep_s", dt / substeps, origin if substeps == 1 else f"{origin}, in {substeps} substeps")
    _take_solver(physx, values)
    asset = table.table("asset")
    if asset is None:
        values.notes.append("damping and caps on speeds are not stated: they are those of this package's preset isaac")
    else:
        _take_asset(asset, values)
    values.notes.append("gym's friction offset threshold and correlation distance are taken as 0.04 m and 0.025 m")
    foot = combined(_ground(table), _foot(table))
    values.take("hinges", "articulation", "a robot is an articulation")
    values.take("sustained_restitution", any(foot.restitution), "the stated restitution")
    decimation = _decimation(table, sim)
    return values.configuration(
        table,
        name=name,
        source=source,
        language="isaac_gym",
        gravity_m_per_s2=_gravity(sim),
        frame_skip=None if decimation is None else decimation * substeps,
        foot_contact=foot,
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
        raise TargetError(f"{sim.source}: there is neither {sim.name('dt')} nor a positive {sim.name('fps')}: add one")
    return 1.0 / rate, f"1 / {sim.name('fps')}"


def _decimation(table: Table, sim: Table) -> int | None:
    keys = ("control.decimation", "env.controlFrequencyInv", "env.control.decimation", "task.env.controlFrequencyInv")
    own = sim.whole("control_decimation") or sim.whole("decimation")
    return own or next((count for key in keys if (count := table.whole(key)) is not None), None)


def _gravity(sim: Table) -> tuple[float, ...] | None:
    """Return gravity with z upwards [m/s^2]; None when the file states none."""
    gravity = sim.numbers("gravity", 3)
    if gravity is None or sim.value("up_axis") not in ("y", 0):
        return gravity
    x, y, z = gravity
    return x, -z, y


def _take_solver(physx: Table, values: PhysxValues) -> None:
    for name, value, key in (
        ("solver", solver_name(physx, "solver_type"), "solver_type"),
        ("position_iterations", physx.whole(MARK), MARK),
        ("velocity_iterations", physx.whole("num_velocity_iterations"), "num_velocity_iterations"),
        ("bounce_threshold_m_per_s", physx.number("bounce_threshold_velocity"), "bounce_threshold_velocity"),
        ("contact_offset_m", physx.number("contact_offset"), "contact_offset"),
        ("rest_offset_m", physx.number("rest_offset"), "rest_offset"),
        (
            "max_depenetration_velocity_m_per_s",
            physx.number("max_depenetration_velocity"),
            "max_depenetration_velocity",
        ),
    ):
        values.take(name, value, physx.name(key))
    for key in FLAGS:
        if physx.flag(key):
            values.notes.append(f"{physx.name(key)} is not carried over: SAPIEN does not expose it")


def _take_asset(asset: Table, values: PhysxValues) -> None:
    for name, key in {
        "linear_damping_per_s": "linear_damping",
        "angular_damping_per_s": "angular_damping",
        "max_linear_velocity_m_per_s": "max_linear_velocity",
        "max_angular_velocity_rad_per_s": "max_angular_velocity",
    }.items():
        values.take(name, asset.number(key), asset.name(key))


# --- materials -------------------------------------------------------------------------------------------------------


def _ground(table: Table) -> Material:
    for place in GROUNDS:
        ground = _table(table, place)
        if ground is not None and ("dynamic_friction" in ground or "static_friction" in ground):
            return stated_material(ground, body="ground", default=DEFAULT_MATERIAL)
        if ground is not None and "dynamicFriction" in ground:
            return _in_camel_case(ground)
    return of_body(DEFAULT_MATERIAL, "ground")


def _in_camel_case(ground: Table) -> Material:
    names = {"static_friction": "staticFriction", "dynamic_friction": "dynamicFriction", "restitution": "restitution"}
    values = {name: ground.value(key) for name, key in names.items()}
    plain = Table(values, source=ground.source, path=ground.path)
    return stated_material(plain, body="ground", default=DEFAULT_MATERIAL)


def _foot(table: Table) -> Material:
    """Return the material of the robot, with the range from which its friction is drawn."""
    for place in ("domain_rand", "env.domain_rand", "env.config.domain_rand"):
        drawn = _table(table, place)
        if drawn is None or not drawn.flag("randomize_friction"):
            continue
        ends = drawn.numbers("friction_range", 2)
        if ends is not None and min(ends) >= 0.0 and max(ends) < float("inf"):
            drawn_from = (min(ends), max(ends))
            return Material(
                body="robot",
                origin=drawn.name("friction_range"),
                static_friction=drawn_from,
                dynamic_friction=drawn_from,
                restitution=DEFAULT_MATERIAL.restitution,
            )
        raise TargetError(
            f"{drawn.source}: {drawn.name('friction_range')} is impossible: give two numbers of 0 or more"
        )
    return of_body(DEFAULT_MATERIAL, "robot")


# --- reader ----------------------------------------------------------------------------------------------------------


def _plain(value: Any, depth: int = MOST_DEPTH) -> Any:
    """Return nested objects as tables, as legged_gym's classes of attributes."""
    is_plain = value is None or isinstance(value, Mapping | str | int | float | list | tuple)
    if is_plain or not depth or not hasattr(value, "__dict__"):
        return value
    return {key: _plain(getattr(value, key), depth - 1) for key in _names(value)}


def _names(value: Any) -> Iterator[str]:
    for key in dir(value):
        if not key.startswith("_") and not inspect.isroutine(getattr(value, key, None)):
            yield key


def _matches(target: Any) -> bool:
    if isinstance(target, str | Path):
        return Path(target).suffix.lower() in (".yaml", ".yml") and _has_mark(Path(target))
    if isinstance(target, Mapping):
        return any(_has_physx(_at(target, place)) for place in PLACES)
    return hasattr(getattr(getattr(target, "sim", None), "physx", None), MARK)


def _has_physx(sim: Any) -> bool:
    return isinstance(sim, Mapping) and isinstance(sim.get("physx"), Mapping) and MARK in sim["physx"]


def _at(values: Any, place: str) -> Any:
    for part in place.split("."):
        values = values.get(part) if isinstance(values, Mapping) else None
    return values


def _has_mark(path: Path) -> bool:
    try:
        return MARK.encode() in read_regular(path, MOST_YAML_BYTES)
    except OSError:
        return False


def _read(target: Any) -> TrainingConfiguration:
    if isinstance(target, str | Path):
        path = Path(target)
        source = f"configuration in the style of IsaacGym, file {path}"
        return isaac_gym_configuration(read_yaml(path), name=path.name, source=source)
    name = "configuration" if isinstance(target, Mapping) else type(target).__name__
    return isaac_gym_configuration(_plain(target), name=name, source="configuration in the style of IsaacGym")


ISAAC_GYM = Reader(
    name="isaac-gym",
    accepts="a YAML file of legged_gym, HumanoidVerse or ProtoMotions with its sim.physx",
    matches=_matches,
    read=lambda target, _: _read(target),
)
"""Reader of configurations in the style of IsaacGym."""
