"""Contact settings of each engine, under the names of the engine."""

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.engines.drake import DrakeSettings
from gauge_envs.tools.recipes.engines.genesis import GenesisSettings
from gauge_envs.tools.recipes.engines.mujoco import MuJoCoSettings
from gauge_envs.tools.recipes.engines.newton import NewtonSettings
from gauge_envs.tools.recipes.engines.physx import PhysXSettings
from gauge_envs.tools.recipes.engines.pybullet import PyBulletSettings
from gauge_envs.tools.recipes.engines.rapier import RapierSettings

__all__ = ["engine_settings"]

CLASSES: dict[str, type[ContactSettings]] = {
    "mujoco": MuJoCoSettings,
    "newton": NewtonSettings,
    "physx": PhysXSettings,
    "pybullet": PyBulletSettings,
    "rapier": RapierSettings,
    "drake": DrakeSettings,
    "genesis": GenesisSettings,
}


def engine_settings(name: str) -> type[ContactSettings]:
    """Return the class of an engine's contact settings.

    Raises:
        UnknownNameError: The engine has no recipes.
    """
    if name not in CLASSES:
        raise UnknownNameError("engine", name, CLASSES)
    return CLASSES[name]
