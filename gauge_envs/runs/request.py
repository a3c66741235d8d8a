"""What is run: one experiment on one engine, once or repeatedly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import resolve_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.scene_source import is_experiment_file
from gauge_envs.experiments.variants import Variant, find_variant
from gauge_envs.observables.observer import checked_proxy
from gauge_envs.references.imported import DataSource
from gauge_envs.scene.jitter import Jitter

__all__ = ["RunRequest"]


@dataclass(frozen=True)
class RunRequest:
    """One experiment on one engine.

    Args:
        subject: Variant, its name, or its Gymnasium id; or the path of an experiment file, as `crate.toml`.
        backend: Name of an installed physics engine.
        parameters: Name of a parameter set, or overrides keyed `body.constant`.
        settings: Numerical settings of the backend that replace its defaults.
        marker_proxy: Marker proxy of deformable bodies, `node` or `material`; see `GaugeEnv`.
        drivers: `bundled` or `imported`; see `load_experiment`.
        reference: `bundled` or `imported`; see `load_experiment`.
        use_withheld: Score also on a band that is withheld by default.
        asset: File that the scene is from, instead of the task file; see `GaugeEnv`.
        seed: Seed of the first episode, 0 or more; each next repeat has one more.
        repeats: Number of episodes, 1 or more.
        jitter: Scatter of the start poses; None starts each episode as calibrated.

    Raises:
        UnknownNameError: No such variant.
        ParameterError: A value is out of range.

    Example:
        >>> from gauge_envs.runs.episodes import run_episode
        >>> from gauge_envs.runs.request import RunRequest
        >>> result = run_episode(RunRequest("SlopeSlider-2-wood", settings={"timestep_s": 1 / 1800}))
        >>> round(result.score.rmse_normalized, 2)
        0.41
    """

    subject: str | Variant
    _: KW_ONLY
    backend: str = "mujoco"
    parameters: Parameters = "calibrated"
    settings: Mapping[str, Any] | None = None
    marker_proxy: str = "node"
    drivers: DataSource | str = DataSource.BUNDLED
    reference: DataSource | str = DataSource.BUNDLED
    use_withheld: bool = False
    asset: str | PathLike[str] | None = None
    seed: int = 0
    repeats: int = 1
    jitter: Jitter | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ParameterError(f"seed is {self.seed}, expected 0 or more")
        if self.repeats < 1:
            raise ParameterError(f"repeats is {self.repeats}, expected 1 or more")
        checked_proxy(self.marker_proxy)
        if isinstance(self.subject, str) and not is_experiment_file(Path(self.subject)):
            object.__setattr__(self, "subject", find_variant(self.subject))

    def experiment(self) -> Experiment:
        """Load the experiment.

        Raises:
            GaugeError: As of `resolve_experiment`.
        """
        return resolve_experiment(
            self.subject, self.parameters, drivers=self.drivers, reference=self.reference, asset=self.asset
        )

    def calibrated_experiment(self) -> Experiment:
        """Load the experiment with calibrated parameters: what is known of it where the parameters are wrong.

        Raises:
            GaugeError: As of `resolve_experiment`.
        """
        return resolve_experiment(self.subject, drivers=self.drivers, reference=self.reference, asset=self.asset)
