"""Gymnasium environments that measure how far a physics engine is from reality.

Importing this package registers 75 experiments as `GAUGE/<Family>[-<subtask>]-<material>`:

    import gymnasium as gym
    import gauge_envs

    env = gym.make("GAUGE/SlopeSlider-2-wood")

and 15 control tasks, as `GAUGE/Turntable-Limit-wood`; see `gauge_envs.tools.control`. `beyond_variants` lists
experiments of other sources, which are registered too.

The registration needs only names. Engines, SciPy and pydantic are imported at first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

from gauge_envs.errors import GaugeError
from gauge_envs.experiments.variants import Variant, beyond_variants, find_variant, variants
from gauge_envs.tools.control.tasks import register_control_tasks

if TYPE_CHECKING:
    from gauge_envs.envs.env import GaugeEnv
    from gauge_envs.envs.episode import Trajectory
    from gauge_envs.envs.wrappers import ScoreEpisode
    from gauge_envs.evaluation.reference import reference_band
    from gauge_envs.evaluation.score import Score, score_trajectory
    from gauge_envs.experiments.experiment import Experiment
    from gauge_envs.experiments.resolve import load_experiment, load_experiment_from_asset
    from gauge_envs.experiments.task_files import load_task
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
    "beyond_variants",
    "find_variant",
    "load_experiment",
    "load_experiment_file",
    "load_experiment_from_asset",
    "load_task",
    "reference_band",
    "register_all",
    "score_trajectory",
    "variants",
]

_LAZY = {
    "Experiment": "gauge_envs.experiments.experiment",
    "GaugeEnv": "gauge_envs.envs.env",
    "Jitter": "gauge_envs.scene.jitter",
    "Score": "gauge_envs.evaluation.score",
    "ScoreEpisode": "gauge_envs.envs.wrappers",
    "Trajectory": "gauge_envs.envs.episode",
    "load_experiment": "gauge_envs.experiments.resolve",
    "load_experiment_file": "gauge_envs.experiments.user_file",
    "load_experiment_from_asset": "gauge_envs.experiments.resolve",
    "load_task": "gauge_envs.experiments.task_files",
    "reference_band": "gauge_envs.evaluation.reference",
    "score_trajectory": "gauge_envs.evaluation.score",
}
"""Modules of the public names that are imported at first use; the imports for type checkers above list the same."""


if not TYPE_CHECKING:  # With this function, a type checker would accept any name.

    def __getattr__(name: str) -> Any:
        """Return a public name, imported at its first use (PEP 562)."""
        if name not in _LAZY:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(_LAZY[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    """Return all names of the module, including those that are not imported yet."""
    return sorted({*globals(), *__all__})


def register_all() -> None:
    """Register every variant and `GAUGE/Asset` with Gymnasium; `import gauge_envs` calls this."""
    for name in (*(variant.name for variant in (*variants(), *beyond_variants())), "Asset"):
        if f"GAUGE/{name}" not in registry:
            register(
                id=f"GAUGE/{name}",
                entry_point="gauge_envs.envs.wrappers:scored_env",
                vector_entry_point="gauge_envs.envs.vector:scored_vector_env",
                kwargs={"variant": name},
            )


register_all()
register_control_tasks()
