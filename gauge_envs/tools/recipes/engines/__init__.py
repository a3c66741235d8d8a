"""Contact settings of each engine in its own terms."""

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
"""Class of each engine in the module of its name, which is imported when it is used."""


def engine_names() -> tuple[str, ...]:
    """Return the names of engines that recipes are written for, installed or not."""
    return tuple(CLASSES)


def engine_settings(name: str) -> type[ContactSettings]:
    """Return the class of an engine's contact settings.

    Raises:
        UnknownNameError: No recipes are written for the engine.
    """
    if name not in CLASSES:
        raise UnknownNameError("engine", name, CLASSES)
    return getattr(import_module(f"{__name__}.{name}"), CLASSES[name])
