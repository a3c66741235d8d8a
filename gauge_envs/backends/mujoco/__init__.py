"""MuJoCo backend, the default engine."""

from gauge_envs.backends.mujoco.backend import BackendMuJoCo

__all__ = ["BackendMuJoCo"]
