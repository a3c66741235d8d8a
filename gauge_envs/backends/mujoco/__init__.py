"""MuJoCo, the default engine."""

from gauge_envs.backends.mujoco.backend import BackendMuJoCo, SimulationMuJoCo
from gauge_envs.backends.mujoco.settings import PRESETS, SettingsMuJoCo

__all__ = ["PRESETS", "BackendMuJoCo", "SettingsMuJoCo", "SimulationMuJoCo"]
