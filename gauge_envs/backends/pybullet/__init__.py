"""PyBullet: sequential impulses for rigid bodies, Featherstone's algorithm for joints, tetrahedra for foam."""

from gauge_envs.backends.pybullet.backend import BackendPyBullet

__all__ = ["BackendPyBullet"]
