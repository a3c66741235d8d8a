"""Physics engines behind one interface, one folder per engine."""

from typing import Any

from gauge_envs.backends.base import Backend, Repeatability
from gauge_envs.backends.features import Feature, Support
from gauge_envs.backends.registry import (
    backend,
    backend_for,
    backend_names,
    engine_call,
    is_bundled,
    support_of,
    versions_of,
)
from gauge_envs.backends.simulation import LoopedSimulation, Simulation

__all__ = [
    "Backend",
    "Feature",
    "LoopedSimulation",
    "Repeatability",
    "Simulation",
    "Support",
    "backend",
    "backend_for",
    "backend_names",
    "engine_call",
    "is_bundled",
    "support_of",
    "versions_of",
]

_LEFT = (
    "ArraySimulation",
    "ArrayWorlds",
    "DeviceWorlds",
    "ReplayedSimulation",
    "World",
    "Worlds",
)
"""Classes of the contract of 0.3."""


def __getattr__(name: str) -> Any:
    """Say what replaces a class of the contract of 0.3."""
    if name in _LEFT:
        raise ImportError(
            f"gauge_envs.backends.{name} belongs to the engine contract of gauge-envs 0.3. In 1.0 one class, "
            "Simulation, holds N worlds, and nothing saves states; CHANGELOG.md lists the changes"
        )
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
