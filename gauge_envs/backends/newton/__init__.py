"""NVIDIA Newton: rigid bodies by its MuJoCo solver, textiles and foam by VBD, foam by implicit MPM."""

from gauge_envs.backends.newton.backend import BackendNewton

__all__ = ["BackendNewton"]
