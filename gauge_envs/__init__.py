"""Gymnasium environments that measure how far a physics engine is from reality.

Importing this package registers 75 experiments as `GAUGE/<Family>[-<subtask>]-<material>`:

    import gymnasium as gym
    import gauge_envs

    env = gym.make("GAUGE/SlopeSlider-2-wood")

and extra to them seven control tasks, as `GAUGE/Turntable-Limit-wood`; see `gauge_envs.envs.control`.
"""

from gymnasium.envs.registration import register, registry

from gauge_envs.envs.control.tasks import register_control_tasks
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.episode import Trajectory
from gauge_envs.envs.wrappers import ScoreEpisode
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score, score_trajectory
from gauge_envs.experiments.experiment import ASSET_NAME, Experiment
from gauge_envs.experiments.resolve import load_experiment, load_experiment_from_asset
from gauge_envs.experiments.task_files import find_variant, load_task, variants
from gauge_envs.experiments.task_format import Variant
from gauge_envs.experiments.user_file import load_experiment_file
from gauge_envs.scene.jitter import Jitter

__all__ = [
    "Experiment",
    "GaugeEnv",
    "GaugeError",
    "Jitter",
    "Score",
    "ScoreEpisode",
    "Trajectory",
    "Variant",
    "load_experiment",
    "load_experiment_file",
    "load_experiment_from_asset",
    "find_variant",
    "load_task",
    "reference_band",
    "register_all",
    "score_trajectory",
    "variants",
]


def register_all() -> None:
    """Register every variant, and `GAUGE/Asset`, with Gymnasium; importing the package has done so already."""
    for name in (*(variant.name for variant in variants()), ASSET_NAME):
        if f"GAUGE/{name}" not in registry:
            register(
                id=f"GAUGE/{name}",
                entry_point="gauge_envs.envs.wrappers:scored_env",
                vector_entry_point="gauge_envs.envs.vector:scored_vector_env",
                kwargs={"variant": name},
            )


register_all()
register_control_tasks()
