"""Physics engines behind one contract: one folder an engine."""

from gauge_envs.backends.base import Backend, Simulation, Support, World, Worlds
from gauge_envs.backends.registry import backend, backend_names

__all__ = ["Backend", "Simulation", "Support", "World", "Worlds", "backend", "backend_names"]
