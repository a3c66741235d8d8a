"""MuJoCo backend, the default engine."""

from gauge_envs.backends.mujoco.backend import BackendMuJoCo
from gauge_envs.backends.mujoco.settings import PRESETS, SettingsMuJoCo
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo

__all__ = [
    "PRESETS",
    "BackendMuJoCo",
    "SettingsMuJoCo",
    "SimulationMuJoCo",
]
