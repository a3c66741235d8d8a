"""Gymnasium environments, by id or as an object: those of this suite, and those with a MuJoCo model."""

import warnings
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import mujoco
import numpy as np

from gauge_envs.backends import Simulation
from gauge_envs.errors import MissingExtraError, TargetError
from gauge_envs.experiments.variants import variants
from gauge_envs.tools.sanity.model import Settings, TrainingConfiguration
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.stacks.mjcf import model_name
from gauge_envs.tools.sanity.stacks.reader import GeomPair, NotATargetError, Reader

Target: TypeAlias = str | Path | mujoco.MjModel | gymnasium.Env | Settings
"""A target of a sanity check; see `gauge_envs.tools.sanity.configuration`."""

UNDECLARED = ("imageio", "packaging")
"""Packages that Gymnasium's MuJoCo environments import without declaring them."""


def _read_id(name: str, pair: GeomPair | None) -> TrainingConfiguration:
    suite_ids = {variant.name: variant.id for variant in variants()}
    try:
        env = gymnasium.make(suite_ids.get(name, name))
    except Exception as error:  # Other environments raise exceptions of any kind.
        if isinstance(error, ImportError) and error.name in UNDECLARED:
            raise MissingExtraError(name, "sanity", error) from error
        cause = " ".join(str(error).split())
        raise NotATargetError(
            f"{name!r}: gymnasium.make fails: {cause} ({type(error).__name__})"
        ) from error
    try:
        return _read_env(env, name, pair)
    finally:
        env.close()


def _read_env(
    env: gymnasium.Env, name: str, pair: GeomPair | None
) -> TrainingConfiguration:
    inner: Any = env.unwrapped
    # A control task has a simulation of its own, any other environment of this suite that of its rollout.
    simulation = getattr(getattr(inner, "rollout", inner), "simulation", None)
    if isinstance(simulation, Simulation):
        if pair is not None:
            raise TargetError(
                f"{name}: an environment of this suite has no geoms to choose from"
            )
        settings = {
            key: value
            for key, value in simulation.settings.items()
            if key != "drive_interval_s"
        }
        return TrainingConfiguration(
            name=name,
            source="environment of this suite",
            backend=inner.arguments.backend,
            settings=settings,
            origins=dict.fromkeys(settings, f"settings of {name}"),
        )
    model = getattr(inner, "model", None)
    if not isinstance(model, mujoco.MjModel):
        kind = f"{type(inner).__module__}.{type(inner).__qualname__}"
        raise NotATargetError(f"{name} is {kind}, which has no MuJoCo model")
    source = f"Gymnasium environment, model {model_name(model)!r}, MuJoCo {mujoco.__version__}"
    return mujoco_configuration(
        model,
        name=name,
        source=source,
        pair=pair,
        frame_skip=getattr(inner, "frame_skip", None),
        spec=_spec_of(inner, model),
        file=_file_of(inner),
    )


def _spec_of(inner: Any, model: mujoco.MjModel) -> mujoco.MjSpec | None:
    """Return the model of an environment before it was compiled; None when its file gives another one."""
    try:
        with warnings.catch_warnings(action="ignore"):
            spec = mujoco.MjSpec.from_file(str(inner.fullpath))
            same = spec.compile()
    except (AttributeError, ValueError):
        return None
    return spec if np.array_equal(same.geom_bodyid, model.geom_bodyid) else None


def _file_of(inner: Any) -> Path | None:
    """Return the file of an environment's model; None when it is not known."""
    stated = getattr(inner, "fullpath", None)
    return None if stated is None else Path(stated)


def _env_name(env: gymnasium.Env) -> str:
    return type(env.unwrapped).__name__ if env.spec is None else env.spec.id


READERS = (
    # It takes every text, so it is the last reader of texts.
    Reader(
        "a Gymnasium id with a MuJoCo model (HalfCheetah-v5)",
        lambda target: isinstance(target, str | Path),
        lambda target, pair: _read_id(str(target), pair),
    ),
    Reader(
        "an env",
        lambda target: isinstance(target, gymnasium.Env),
        lambda target, pair: _read_env(target, _env_name(target), pair),
    ),
)
