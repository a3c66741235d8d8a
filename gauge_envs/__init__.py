"""Gymnasium environments that separate errors of engine, settings and constants.

Importing this package registers 75 experiments as `GAUGE/<Family>[-<subtask>]-<material>`:

    import gymnasium as gym
    import gauge_envs

    env = gym.make("GAUGE/SlopeSlider-2-wood")

and 15 control tasks, as `GAUGE/Turntable-Limit-wood`; see `gauge_envs.tools.control`. `beyond_variants` lists
experiments of other sources, which are registered too.

The registration needs only names. Engines, SciPy and pydantic are imported at first use.
"""

import warnings
from typing import TYPE_CHECKING

from gymnasium.envs import registration

from gauge_envs.errors import GaugeError as GaugeError
from gauge_envs.experiments.variants import (
    Variant as Variant,
    all_rows,
    beyond_variants as beyond_variants,
    find_variant as find_variant,
    unreadable_task_files,
    variants as variants,
)
from gauge_envs.registry import lazy_names
from gauge_envs.tools.control import ids

if TYPE_CHECKING:
    from gauge_envs.envs.env import GaugeEnv as GaugeEnv
    from gauge_envs.envs.recording import Trajectory as Trajectory
    from gauge_envs.envs.wrappers import (
        LogScore as LogScore,
        ScoreEpisode as ScoreEpisode,
    )
    from gauge_envs.experiments.experiment import Experiment as Experiment
    from gauge_envs.experiments.resolve import (
        load_experiment as load_experiment,
    )
    from gauge_envs.experiments.task_reader import load_task as load_task
    from gauge_envs.scene.jitter import Jitter as Jitter
    from gauge_envs.scoring.reference import reference_band as reference_band
    from gauge_envs.scoring.score import Score as Score
    from gauge_envs.scoring.trajectory import score_trajectory as score_trajectory
else:
    __getattr__, _LAZY = lazy_names(
        __name__,
        {
            ".envs.env": ["GaugeEnv"],
            ".envs.recording": ["Trajectory"],
            ".envs.wrappers": ["LogScore", "ScoreEpisode"],
            ".experiments.experiment": ["Experiment"],
            ".experiments.resolve": ["load_experiment"],
            ".experiments.task_reader": ["load_task"],
            ".scene.jitter": ["Jitter"],
            ".scoring.reference": ["reference_band"],
            ".scoring.score": ["Score"],
            ".scoring.trajectory": ["score_trajectory"],
        },
    )
    __all__ = sorted(
        [
            "GaugeError",
            "Variant",
            "beyond_variants",
            "find_variant",
            "register_all",
            "variants",
            *_LAZY,
        ]
    )

    def __dir__() -> list[str]:
        """Return all names of the module, including those that are not imported yet."""
        return sorted({*globals(), *__all__})


def register_all() -> None:
    """Register every variant and control task with Gymnasium; `import gauge_envs` calls this.

    Variants of task files that the environment variable `GAUGE_TASKS` names are among them.

    Warns:
        UserWarning: `GAUGE_TASKS` names a file that cannot be used; the message says why.
    """
    for fault in unreadable_task_files():
        warnings.warn(str(fault), stacklevel=2)
    for row in all_rows():
        variant = row.variant
        if variant.id not in registration.registry:
            registration.register(
                id=variant.id,
                entry_point="gauge_envs.envs.wrappers:scored_env",
                vector_entry_point="gauge_envs.envs.vector:scored_vector_env",
                max_episode_steps=row.frame_count - 1,
                kwargs={"variant": variant.name},
            )
    ids.register()


register_all()
