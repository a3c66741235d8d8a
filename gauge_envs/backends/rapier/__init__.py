"""Rapier: rigid bodies in single precision, with a native restitution and snapshots."""

from gauge_envs.backends.rapier.backend import BackendRapier

__all__ = ["BackendRapier"]
