"""Gymnasium environments that measure how far a physics engine is from reality.

Importing this package registers 75 experiments as `GAUGE/<Family>[-<subtask>]-<material>`:

    import gymnasium as gym
    import gauge_envs

    env = gym.make("GAUGE/SlopeSlider-2-wood")
"""

from gymnasium.envs.registration import WrapperSpec, register, registry

from gauge_envs.env import GaugeEnv
from gauge_envs.episode import Trajectory, reference_band
from gauge_envs.errors import GaugeError
from gauge_envs.experiment import Experiment, experiment
from gauge_envs.jitter import Jitter
from gauge_envs.score import Score, score_trajectory
from gauge_envs.task import find_variant, load_task, variants
from gauge_envs.task_format import Variant
from gauge_envs.wrappers import ScoreEpisode

__all__ = [
    "Experiment",
    "GaugeEnv",
    "GaugeError",
    "Jitter",
    "Score",
    "ScoreEpisode",
    "Trajectory",
    "Variant",
    "experiment",
    "find_variant",
    "load_task",
    "reference_band",
    "register_all",
    "score_trajectory",
    "variants",
]


def register_all() -> None:
    """Register every variant with Gymnasium; importing the package has done so already."""
    for variant in variants():
        if variant.id not in registry:
            register(
                id=variant.id,
                entry_point="gauge_envs.env:GaugeEnv",
                kwargs={"variant": variant.name},
                additional_wrappers=(WrapperSpec("ScoreEpisode", "gauge_envs.wrappers:ScoreEpisode", {}),),
            )


register_all()
