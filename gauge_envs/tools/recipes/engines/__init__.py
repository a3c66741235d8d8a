"""Contact settings of each engine, under the names of the engine."""

from importlib import import_module

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.recipes.engines.base import ContactSettings

__all__ = ["engine_names", "engine_settings"]

CLASSES = {
    "mujoco": "MuJoCoSettings",
    "newton": "NewtonSettings",
    "physx": "PhysXSettings",
    "pybullet": "PyBulletSettings",
    "rapier": "RapierSettings",
    "drake": "DrakeSettings",
    "genesis": "GenesisSettings",
}
"""Class of each engine, in the module with the name of the engine. Modules are imported on use."""


def engine_names() -> tuple[str, ...]:
    """Return the names of engines with recipes, installed or not."""
    return tuple(CLASSES)


def engine_settings(name: str) -> type[ContactSettings]:
    """Return the class of an engine's contact settings.

    Raises:
        UnknownNameError: The engine has no recipes.
    """
    if name not in CLASSES:
        raise UnknownNameError("engine", name, CLASSES)
    return getattr(import_module(f"{__name__}.{name}"), CLASSES[name])
