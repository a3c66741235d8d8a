"""NVIDIA Newton: rigid bodies by its MuJoCo solver; cloth, foam, ropes and rods by VBD; foam by implicit MPM too."""

from gauge_envs.backends.newton.backend import BackendNewton

__all__ = [
    "BackendNewton",
]
