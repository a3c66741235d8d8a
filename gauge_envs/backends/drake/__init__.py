"""Drake: rigid bodies with point and hydroelastic contact, and its four discrete approximations of contact."""

from gauge_envs.backends.drake.backend import BackendDrake

__all__ = ["BackendDrake"]
