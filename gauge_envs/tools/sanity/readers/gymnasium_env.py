"""Gymnasium environments, by id or as an object: those of this suite, and those with a MuJoCo model."""

import importlib.util
import warnings
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import mujoco
import numpy as np

from gauge_envs.backends import Simulation
from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.errors import (
    MissingExtraError,
    NoRewardWarning,
    TargetError,
    install_command,
)
from gauge_envs.tools.sanity.readers.mjcf import GeomPair, model_name, read_model
from gauge_envs.tools.sanity.readers.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.verdict import Need, TrainingConfiguration

Target: TypeAlias = (
    str | Path | mujoco.MjModel | tuple[mujoco.MjModel, mujoco.MjData] | gymnasium.Env
)
"""A target of a sanity check; see `gauge_envs.tools.sanity.configuration`."""

ACCEPTED = "a Gymnasium id with a MuJoCo model, a model file (.xml, .urdf), or another target of docs/sanity.md"
"""Targets that can be checked, as a text."""

UNDECLARED = ("imageio", "packaging")
"""Packages that Gymnasium's MuJoCo environments import without declaring them."""


SUITE = "dm_control:"
"""Start of the name of a task of dm_control."""


def suite_file(name: str) -> Path:
    """Return the file of the model of a task of dm_control, which is not imported: its bindings need an older MuJoCo.

    Raises:
        TargetError: dm_control is not installed, or has no such domain.
    """
    found = importlib.util.find_spec("dm_control")
    if found is None or not found.submodule_search_locations:
        raise TargetError(
            f"{name}: dm_control is not installed: {install_command('gauge-envs', 'dm')}"
        )
    folder = Path(found.submodule_search_locations[0]) / "suite"
    domain = name.removeprefix(SUITE).partition("-")[0]
    file = folder / f"{domain}.xml"
    if not file.is_file():
        domains = sorted(path.stem for path in folder.glob("*.xml"))
        raise TargetError(
            f"{name}: dm_control has no domain {domain!r}; it has {', '.join(domains)}"
        )
    return file


def read_object(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of a model, of a pair of model and data, or of an environment."""
    if isinstance(target, gymnasium.Env):
        spec = target.spec
        name = type(target.unwrapped).__name__ if spec is None else spec.id
        return _read_env(target, name, pair)
    model, data = target if isinstance(target, tuple) else (target, None)
    if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData | None):
        return read_model(model, data, pair)
    raise TargetError(f"{type(target).__name__} cannot be checked; give {ACCEPTED}")


def read_id(name: str, pair: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of an environment by its id."""
    suite_id = f"GAUGE/{name}"
    try:
        with mujoco_warnings() as warned, warnings.catch_warnings():
            warnings.simplefilter("ignore", NoRewardWarning)
            env = gymnasium.make(suite_id if suite_id in gymnasium.registry else name)
    except Exception as error:  # Other environments raise exceptions of any kind.
        if isinstance(error, ImportError) and error.name in UNDECLARED:
            raise MissingExtraError(name, "sanity", error) from error
        cause = " ".join(str(error).split())
        raise TargetError(
            f"{name!r}: gymnasium.make fails: {cause} ({type(error).__name__}); give {ACCEPTED}"
        ) from error
    with closing(env):
        read = _read_env(env, name, pair)
    # A file of Gymnasium is not the user's.
    is_users = not type(env.unwrapped).__module__.startswith("gymnasium.")
    return replace(read, warnings=tuple(warned)) if is_users else read


def read_task(path: Path) -> TrainingConfiguration:
    """Return the configuration of an experiment by its task file: the settings of its scene."""
    with closing(GaugeEnv(str(path))) as env:
        return _read_env(env, path.name, None)


def _read_env(
    env: gymnasium.Env, name: str, pair: GeomPair | None
) -> TrainingConfiguration:
    inner: Any = env.unwrapped
    simulation = getattr(getattr(inner, "rollout", None), "simulation", None)
    if isinstance(simulation, Simulation):
        return _suite_configuration(inner, simulation, name)
    model = getattr(inner, "model", None)
    if not isinstance(model, mujoco.MjModel):
        kind = f"{type(inner).__module__}.{type(inner).__qualname__}"
        raise TargetError(
            f"{name} is {kind}, which has no MuJoCo model; give {ACCEPTED}"
        )
    path = getattr(inner, "fullpath", None)
    file = None if path is None else Path(path)
    return mujoco_configuration(
        model,
        name=name,
        source=f"Gymnasium environment, model {model_name(model)!r}, MuJoCo {mujoco.__version__}",
        pair=pair,
        spec=None if file is None else _spec_of(file, model),
        file=file,
    )


def _suite_configuration(
    env: Any, simulation: Simulation, name: str
) -> TrainingConfiguration:
    """Return the configuration of an environment of this suite."""
    settings = dict(simulation.settings)
    settings.pop("drive_interval_s", None)
    scene = env.experiment.scene
    rigid = {body.name for body in scene.bodies}
    touches = any(
        rigid.intersection(contact.first) and rigid.intersection(contact.second)
        for contact in scene.contacts
    )
    reason = {Need.CONTACT: "no rigid bodies touch in its scene"}
    return TrainingConfiguration(
        name=name,
        source="environment of this suite",
        backend=env.arguments.backend,
        settings=settings,
        inapplicable={} if touches else reason,
    )


def _spec_of(file: Path, model: mujoco.MjModel) -> mujoco.MjSpec | None:
    """Return the model of an environment before it was compiled; None when its file gives another one."""
    try:
        with warnings.catch_warnings(action="ignore"):
            spec = mujoco.MjSpec.from_file(str(file))
            compiled = spec.compile()
    except ValueError:
        return None
    return spec if np.array_equal(compiled.geom_bodyid, model.geom_bodyid) else None
