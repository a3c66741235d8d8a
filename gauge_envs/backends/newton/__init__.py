"""NVIDIA Newton: its MuJoCo solver for rigid bodies, VBD for deformable bodies, implicit MPM as a choice for foam."""

from gauge_envs.backends.newton.backend import BackendNewton

__all__ = ["BackendNewton"]
