"""The result of one episode and its file, which holds all that is needed to judge, plot or repeat the episode."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import AssetKind, Experiment
from gauge_envs.files import json_ready, versions
from gauge_envs.references.imported import BUNDLED_DATA

__all__ = [
    "Outcome",
    "RecordedTrajectory",
    "Result",
    "parameters_record",
]


BULKY = ("scene", "experiment")
"""Parts of a result's asset that only reading it back needs."""


class Outcome(StrEnum):
    """How an episode ended."""

    FINISHED = "finished"
    """It ran to its last frame."""
    DIVERGED = "diverged"
    """The simulation left what is physically possible; there is no score."""
    DECLINED = "declined"
    """Not run: the backend cannot build the scene, or the experiment lacks the parameters that were asked for."""
    FAILED = "failed"
    """Not run to the end because of an error."""


@dataclass(frozen=True, kw_only=True)
class RecordedTrajectory:
    """What an episode did, dense enough to plot and to score again.

    Attributes:
        unit: Unit of the samples.
        coordinates: Names of the coordinates, as `cube.x`.
        times_s: Times [s], 180 a second, shape [sample_count].
        samples: g(t) at those times, shape [sample_count, coordinate_count]; None where a diverged one was not finite.
    """

    unit: str
    coordinates: list[str]
    times_s: list[float]
    samples: list[list[float | None]]

    def __post_init__(self) -> None:
        if len(self.samples) != len(self.times_s):
            raise ValueError(f"{len(self.times_s)} times but {len(self.samples)} samples")
        if any(len(row) != len(self.coordinates) for row in self.samples):
            raise ValueError(f"a sample has not {len(self.coordinates)} coordinates")

    @classmethod
    def of(
        cls, experiment: Experiment, times_s: NDArray[np.float64], samples: NDArray[np.float64]
    ) -> RecordedTrajectory:
        """Record of a generalized trajectory.

        Args:
            experiment: The experiment that it is of.
            times_s: Times [s], shape [sample_count].
            samples: g(t) at those times in the unit of the observable, shape [sample_count, coordinate_count].
        """
        return cls(
            unit=experiment.score.observable.unit,
            coordinates=list(experiment.coordinates),
            times_s=times_s.tolist(),
            samples=json_ready(samples.tolist()),
        )

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times [s], shape [sample_count], and g(t), shape [sample_count, coordinate_count], NaN for None."""
        samples = np.array(self.samples, dtype=np.float64)
        return np.array(self.times_s), samples.reshape(len(self.times_s), len(self.coordinates))


@dataclass(frozen=True, kw_only=True)
class Result:
    """One episode, or one trajectory that a user brought (then `backend`, `seed` and `wall_s` are None).

    Attributes:
        id: Gymnasium id.
        outcome: How the episode ended.
        backend: Name of the physics engine.
        parameters: Name of the parameter set, or the overrides.
        frames: Frames that there are, the first included.
        diverged: Whether the simulation left what is physically possible.
        diverged_reason: How it did.
        wall_s: Time that reset and steps took [s], building the scene not included; for one of several that ran
            together, its share.
        sim_s: Simulated time [s].
        settings: Every numerical setting of the engine that was in force.
        settings_given: Those of them that the caller gave.
        versions: Versions of the engine, gauge-envs, gymnasium, numpy and python.
        seed: Seed of the reset and of the jitter.
        jitter: How far the start was moved at random, as standard deviations; empty where it was not.
        score: Distance to reality; metrics are None where they do not apply.
        task_sha256: Hash of the task file that the episode was built from; of an experiment file and all that it names.
        marker_proxy: What stood for a marker on a deformable body: `node` or `material`.
        driver_provenance: Where the driven motion is from; None where nothing is driven.
        dataset: Where driven motion (`drivers`) and band (`reference`) are from, `bundled` or `imported`; where one of
            them is imported, also `revision` of the dataset and `sha256` over the imported trials.
        asset: File that the scene was from: its name `file`, `kind`, `sha256`, whether it is `edited` and in which
            `changes`; with the `scene` as text of a USD layer where the package does not have it, and the
            `experiment` of an experiment file. Empty where the task file stated the scene.
        created: When, ISO 8601, UTC.
        error: Why it was declined or failed.
        trajectory: What it did; None when it did not run.
    """

    id: str
    outcome: Outcome
    parameters: str | dict[str, Any]
    score: Score
    task_sha256: str
    backend: str | None = None
    frames: int = 0
    diverged: bool = False
    diverged_reason: str | None = None
    wall_s: float | None = None
    sim_s: float = 0.0
    settings: dict[str, Any] = field(default_factory=dict)
    settings_given: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    seed: int | None = None
    jitter: dict[str, float] = field(default_factory=dict)
    marker_proxy: str = "node"
    driver_provenance: str | None = None
    dataset: dict[str, str] = field(default_factory=BUNDLED_DATA.copy)
    asset: dict[str, Any] = field(default_factory=dict)
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    error: str | None = None
    trajectory: RecordedTrajectory | None = None

    @property
    def is_edited(self) -> bool:
        """Whether the scene was that of an asset which differs from the calibrated one."""
        return bool(self.asset.get("edited"))

    @property
    def has_experiment_file(self) -> bool:
        """Whether it is of an experiment that a user's file states, which the package does not have."""
        return self.asset.get("kind") == AssetKind.EXPERIMENT

    def to_dict(self, *, trajectory: bool = True) -> dict[str, Any]:
        """JSON-ready dictionary, every field present; without the bulky trajectory and scene on request."""
        kept = self if trajectory else replace(self, trajectory=None)
        values = json_ready(asdict(kept)) | {"score": json_ready(self.score.to_dict())}
        if not trajectory:
            del values["trajectory"]
            values["asset"] = {key: value for key, value in values["asset"].items() if key not in BULKY}
        return values


def parameters_record(experiment: Experiment) -> str | dict[str, Any]:
    """Parameters of an experiment as a result keeps them: the name of the set, or the overrides."""
    return json_ready(experiment.overrides) if experiment.parameters == "custom" else experiment.parameters
