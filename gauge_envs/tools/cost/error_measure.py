"""How far two motions of one experiment are apart, and how far reality and its uncertain inputs scatter, in one unit.

The measure is that of the experiment's first score: the root mean square over frames in the coordinates of its band, or
the first event metric where the experiment has no band.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.evaluation.deviation import experiment_sensitivities, sampled_frames
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.swing import swing_metrics
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.runs.result import Result

FloatArray = NDArray[np.float64]

EVENTS = ("pd", "mte", "lsd")
"""Event metrics that measure an experiment without a band, in this order."""

INPUT_KINDS = ("constant", "start", "tilt")
"""Kinds of uncertain inputs that make up the parametric error; the discretization is numerical error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorMeasure:
    """Measure of distances in one experiment.

    Attributes:
        experiment: The experiment, with its parameters.
        band: Band of its score; None without one.
        metric: `rmse`, or the event metric that is compared.
        unit: Unit of all distances.
        scatter: Scatter of real trials: the published mean RMSE of trials, or the standard deviation of the metric.
            None if none is published.
    """

    experiment: Experiment
    band: Band | None
    metric: str
    unit: str
    scatter: float | None

    @classmethod
    def of(cls, experiment: Experiment) -> ErrorMeasure:
        """Return the measure of an experiment."""
        band, baselines = reference_band(experiment), experiment.baselines
        event = next((name for name in EVENTS if name in experiment.score.metrics), None)
        if band is None and event is not None and event in baselines:
            line = baselines[event]
            return cls(experiment=experiment, band=None, metric=event, unit=line.unit, scatter=line.std or None)
        rmse = baselines.get("rmse")
        scatter = None if rmse is None or (band is not None and not band.normalized_by_baseline) else rmse.mean
        return cls(
            experiment=experiment,
            band=band,
            metric="rmse",
            unit=experiment.score.observable.unit,
            scatter=scatter or None,
        )

    def frames(self, result: Result) -> FloatArray | None:
        """Return g(t) of a result at the frames, shape [T, D]; None if it did not run to its end."""
        if result.trajectory is None or result.error is not None or result.diverged:
            return None
        frames = sampled_frames(self.experiment, *result.trajectory.arrays())
        return frames if np.isfinite(frames).all() else None

    def distance(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two motions, each g(t) of shape [T, D]; NaN frames of the second are left out."""
        if self.metric != "rmse":
            return abs(self._event(first) - self._event(second))
        compared = np.isfinite(second).all(axis=1)
        if self.band is not None:
            compared &= np.isfinite(self.band.mean).any(axis=1)
            first, second = self.band.project(first), self.band.project(second)
        return trajectory_rmse(first[compared], second[compared])

    def to_reality(self, result: Result) -> float | None:
        """Return the distance of a result to the mean of real trials: its first score; None without one."""
        score = result.score
        if self.metric != "rmse":
            value = getattr(score, METRICS[self.metric].score_field)
            return None if value is None else abs(value - self.experiment.baselines[self.metric].mean)
        return None if score.primary is None else getattr(score, score.primary)

    def floor(self, backend: str | None) -> tuple[float, str] | None:
        """Return the parametric floor and its origin; None without stored sensitivities.

        It is the root sum of squares, over the uncertain inputs, of the distance by which one standard uncertainty of
        the input moves the simulated motion.
        """
        table = None if self.metric != "rmse" else experiment_sensitivities(self.experiment, backend)
        if table is None:
            return None
        is_law = self.band is not None and self.band.grade is BandGrade.LAW
        # A law keeps the body where it starts, so another start moves simulation and law alike.
        kinds = [kind for kind in INPUT_KINDS if not (is_law and kind == "start")]
        count = self.experiment.frame_count
        changes = [one.change[:count] for one in table.inputs if one.kind in kinds and len(one.change) >= count]
        if not changes:
            return None
        total = math.sqrt(sum(self.distance(change, np.zeros_like(change)) ** 2 for change in changes))
        return total, f"{len(changes)} inputs, sensitivities of {table.backend}"

    def _event(self, frames: FloatArray) -> float:
        return swing_metrics(self.experiment, frames)[self.metric]
