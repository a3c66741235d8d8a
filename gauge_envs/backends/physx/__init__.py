"""NVIDIA PhysX 5 through SAPIEN: rigid bodies on the CPU."""

from gauge_envs.backends.physx.backend import BackendPhysX

__all__ = ["BackendPhysX"]
