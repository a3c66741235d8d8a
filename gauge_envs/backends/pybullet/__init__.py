"""PyBullet: rigid bodies by Bullet's sequential impulses, joints by Featherstone's algorithm."""

from gauge_envs.backends.pybullet.backend import BackendPyBullet

__all__ = ["BackendPyBullet"]
