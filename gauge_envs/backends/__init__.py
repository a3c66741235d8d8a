"""Physics engines behind one interface, one folder per engine."""

from gauge_envs.backends.base import Backend, FileBackend, ModelFile, Repeatability
from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.features import Feature, Support
from gauge_envs.backends.registry import (
    backend,
    backend_for,
    backend_names,
    backend_of_suffix,
    engine_call,
    is_bundled,
    support_of,
    versions_of,
)
from gauge_envs.backends.shared.states import ReplayedSimulation
from gauge_envs.backends.world import Simulation, World
from gauge_envs.backends.worlds import ArraySimulation, ArrayWorlds, Worlds

__all__ = [
    "ArraySimulation",
    "ArrayWorlds",
    "Backend",
    "DeviceWorlds",
    "Feature",
    "FileBackend",
    "ModelFile",
    "Repeatability",
    "ReplayedSimulation",
    "Simulation",
    "Support",
    "World",
    "Worlds",
    "backend",
    "backend_for",
    "backend_names",
    "backend_of_suffix",
    "engine_call",
    "is_bundled",
    "support_of",
    "versions_of",
]
