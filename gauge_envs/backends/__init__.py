"""Physics engines behind one interface, one folder per engine."""

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
