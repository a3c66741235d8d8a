"""MuJoCo Playground and mjlab: environments in this process, and the words of their changes.

They are read as the probe reads them elsewhere, in the stack's own Python; see `gauge sanity probe`. Changes of
Playground are overrides of the configuration, `config_overrides={"sim_dt": 0.002}`, and elements of the task's XML
file; changes of mjlab are arguments of configuration classes, `SimulationCfg(mujoco=MujocoCfg(cone="elliptic"))`.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import mujoco

from gauge_envs.backends.mujoco.model import CONES, ENABLE_FLAGS, INTEGRATORS, SOLVERS
from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.gauge_probe import (
    MJLAB_PACKAGE,
    PLAYGROUND_PACKAGE,
    found,
    frame_skip,
    implementation,
    is_of_package,
    limits,
    mujoco_model,
)
from gauge_envs.tools.sanity.model import CapacityLimits, TrainingConfiguration
from gauge_envs.tools.sanity.robot.contact_capacity import contact_capacity
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.stacks.dialect import (
    WHOLE,
    Dialect,
    Kind,
    Place,
    Setting,
    python_text,
)
from gauge_envs.tools.sanity.stacks.mjcf import MODEL_SETTINGS, Mjcf
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader

# --- Playground ------------------------------------------------------------------------------------------------------

OVERRIDE = '"{key}": {value}'

PLAYGROUND = Mjcf(
    name="playground",
    settings=(
        *MODEL_SETTINGS,
        # Keys of a task's configuration. Other options stand in the task's XML file alone.
        Setting("timestep_s", "config", "sim_dt", pattern=OVERRIDE),
        Setting("njmax", "config", "njmax", pattern=OVERRIDE),
        Setting("naconmax", "config", "naconmax", pattern=OVERRIDE),
    ),
)


def _read(target: Any, package: str, pair: GeomPair | None) -> TrainingConfiguration:
    return mujoco_configuration(
        _model(target),
        name=type(target).__name__,
        source=f"{package}, MuJoCo {mujoco.__version__}",
        pair=pair,
        frame_skip=frame_skip(target),
    )


def _read_playground(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    env = getattr(target, "unwrapped", target)
    model = _model(env)
    package = f"environment of MuJoCo Playground {_version('playground')}"
    read = _read(env, package, pair)
    engine, trains_on, capacity = "MJX", "", None
    runs_on = found(env, "_config.impl")
    if runs_on == "warp":
        engine, trains_on = "MJX on mujoco_warp", "mujoco_warp"
        stated = limits(env)
        capacity = contact_capacity(
            model,
            CapacityLimits(njmax=stated.get("njmax"), naconmax=stated.get("naconmax")),
        )
    elif isinstance(runs_on, str):
        engine = f"MJX's implementation {runs_on!r}"
    note = f"trains with {engine}, in single precision; the rows run MuJoCo's C engine"
    robot, scale = read.robot, found(env, "_config.action_scale")
    if isinstance(scale, int | float):
        robot = replace(robot, action_rad=float(scale))
    return replace(
        read,
        robot=robot,
        capacity=capacity,
        notes=(note, *read.notes),
        language=PLAYGROUND.name,
        trains_on=trains_on,
    )


# --- mjlab -----------------------------------------------------------------------------------------------------------

NAMED_OPTIONS = {"integrator": INTEGRATORS, "cone": CONES, "solver": SOLVERS}
"""Options that mjlab states by name, in small letters."""

CLASSES = {"option": "MujocoCfg", "flag": "MujocoCfg", "geom": "CollisionCfg"}
"""Classes of mjlab that hold the attributes of a model's elements."""


def _argument(one: Setting) -> Setting:
    """Return the argument of mjlab's classes that states an attribute of a model."""
    key, kind = one.key, one.kind
    if one.place == "flag":
        key, shown = (
            ("enableflags", True)
            if one.name in ENABLE_FLAGS
            else ("disableflags", False)
        )
        kind = Kind(text=lambda is_on: f'("{one.key}",)' if is_on is shown else "()")
    elif key in NAMED_OPTIONS:
        kind = Kind(text=lambda name: python_text(name.lower()))
    return replace(one, place=CLASSES[one.place], key=key, kind=kind)


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
        "CollisionCfg": Place(form="CollisionCfg({})"),
    },
    gravity="SimulationCfg(mujoco=MujocoCfg(gravity=({})))",
    absent='without the flag "override"',
)


def _read_mjlab(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    model = _model(target)
    cfg = found(target, "unwrapped.cfg") or found(target, "cfg") or target
    read = _read(target, f"mjlab {_version('mjlab')}", pair)
    stated, capacity = limits(target), None
    if stated:
        worlds = 1 if "nconmax" in stated else None
        capacity = contact_capacity(
            model,
            CapacityLimits(
                njmax=stated.get("njmax"), naconmax=stated.get("nconmax"), worlds=worlds
            ),
        )
    note = "trains on mujoco_warp, in single precision; the rows run MuJoCo's C engine"
    return replace(
        read,
        robot=replace(read.robot, delay_s=_delay_s(cfg, model.opt.timestep)),
        capacity=capacity,
        notes=(note, *read.notes),
        language=MJLAB.name,
        trains_on=implementation(target, model),
    )


def _delay_s(cfg: Any, step_s: float) -> float | None:
    """Return the longest delay of what the policy observes and of the actuators [s]; None when none is stated.

    Lags of actuators are steps of the engine, those of observations steps of the environment.
    """
    observed, acted = [], []
    for group in ("actor", "policy"):
        for term in (found(cfg, f"observations.{group}.terms") or {}).values():
            observed.append(found(term, "delay_max_lag"))
    for entity in (found(cfg, "scene.entities") or {}).values():
        for actuator in found(entity, "articulation.actuators") or ():
            acted.append(found(actuator, "delay_max_lag"))
    observed_lags = [lag for lag in observed if isinstance(lag, int)]
    actuator_lags = [lag for lag in acted if isinstance(lag, int)]
    if not observed_lags and not actuator_lags:
        return None
    steps_per_action = found(cfg, "decimation") or 1
    return step_s * (
        max(observed_lags, default=0) * steps_per_action + max(actuator_lags, default=0)
    )


# --- readers ---------------------------------------------------------------------------------------------------------


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "of an unknown version"


def _model(target: Any) -> mujoco.MjModel:
    model = mujoco_model(target)
    if not isinstance(model, mujoco.MjModel):
        raise TargetError(
            f"{type(target).__name__} holds no compiled model: give the environment"
        )
    return model


DIALECTS = (PLAYGROUND, MJLAB)

READERS = (
    Reader(
        "an env of MuJoCo Playground",
        lambda target: is_of_package(target, PLAYGROUND_PACKAGE),
        _read_playground,
    ),
    Reader(
        "an env or a task configuration of mjlab",
        lambda target: is_of_package(target, MJLAB_PACKAGE),
        _read_mjlab,
    ),
)
