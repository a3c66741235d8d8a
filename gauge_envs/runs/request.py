"""The request of a run: one experiment on one engine, once or with repeats."""

from collections.abc import Container
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.errors import ParameterError, ReferenceFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.experiments.variants import find_variant
from gauge_envs.scene.jitter import Jitter, can_scatter


@dataclass(frozen=True, kw_only=True)
class RunRequest(EnvArguments):
    """One experiment on one engine, with the arguments of its environment.

    A name or id becomes its `Variant`, so that requests of the same run are equal.

    Attributes:
        seed: Seed of the first episode, 0 or more; each next repeat has one more.
        repeats: Number of episodes, 1 or more.
        jitter: Standard deviations of the initial state; None is the nominal start.

    Example:
        >>> from gauge_envs.runs.episodes import run_episode
        >>> from gauge_envs.runs.request import RunRequest
        >>> result = run_episode(RunRequest("SlopeSlider-2-wood", settings={"timestep_s": 1 / 1800}))
        >>> round(result.score.rmse_normalized, 2)
        0.41
    """

    seed: int = 0
    repeats: int = 1
    jitter: Jitter | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, minimum in (("seed", 0), ("repeats", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < minimum:
                raise ParameterError(f"{name} is {value!r}, expected {minimum} or more")
        if not isinstance(self.jitter, Jitter | None):
            raise ParameterError(
                f"jitter is {self.jitter!r}, expected None or a gauge_envs.Jitter"
            )
        if isinstance(self.variant, str):
            object.__setattr__(self, "variant", find_variant(self.variant))

    @property
    def seeds(self) -> range:
        """Seeds of the episodes."""
        return range(self.seed, self.seed + self.repeats)

    @property
    def scatter(self) -> Jitter | None:
        """The effective jitter: repeats have the default `Jitter`.

        Repeats of single-trial recordings have recorded initial states, and clamped bodies always start the same.
        """
        if self.jitter is not None or self.repeats == 1:
            return self.jitter
        experiment = self.published_experiment()
        is_nominal = shots_of(experiment) or not can_scatter(experiment.scene)
        return None if is_nominal else Jitter()

    def parts(self, done: Container[int], *, together: bool) -> list[Self]:
        """Return requests of the episodes that are not done.

        Args:
            done: Seeds of the episodes that are done.
            together: Whether consecutive seeds are one request; False gives each seed its own.
        """
        seeds = np.array([seed for seed in self.seeds if seed not in done])
        splits = np.flatnonzero(np.diff(seeds) > int(together)) + 1
        return [
            replace(self, seed=int(part[0]), repeats=len(part))
            for part in np.split(seeds, splits)
            if part.size
        ]

    def published_experiment(self) -> Experiment:
        """Load the experiment with published parameters; it exists even if the parameters or an import are wrong."""
        published = replace(self, parameters="published")
        try:
            return published.experiment()
        except ReferenceFileError:
            published = replace(published, drivers="bundled", reference="bundled")
            return published.experiment()
