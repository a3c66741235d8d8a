"""Physics engines behind one contract: one folder an engine."""

from gauge_envs.backends.base import Backend, Simulation, Support
from gauge_envs.backends.registry import backend, backend_names

__all__ = ["Backend", "Simulation", "Support", "backend", "backend_names"]
