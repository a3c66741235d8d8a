"""Contact settings of each engine in its own terms."""

from importlib import import_module

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.recipes.engines.base import ContactSettings

__all__ = ["engine_names", "engine_settings"]

CLASSES = {
    "mujoco": ("mujoco", "MuJoCoSettings"),
    "newton": ("newton", "NewtonSettings"),
    "physx": ("physx", "PhysXSettings"),
    "pybullet": ("pybullet", "PyBulletSettings"),
    "rapier": ("rapier", "RapierSettings"),
    "drake": ("drake", "DrakeSettings"),
    "genesis": ("genesis", "GenesisSettings"),
}
"""Module and class of each engine, which are imported when they are used."""


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
    module, attribute = CLASSES[name]
    return getattr(import_module(f"{__name__}.{module}"), attribute)
