"""Score one trajectory against reality: every number that is reported for an episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics import (
    band_coverage,
    mean_abs_z,
    release_offset,
    signed_error,
    trajectory_dtw,
    trajectory_rmse,
    z_scores,
)
from gauge_envs.evaluation.swing import EventTime, swing_metrics, swing_notes
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import Baseline
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = ["Score", "score_trajectory"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Score:
    """Distance of an episode from reality. None is a metric that does not apply or has no reference.

    Attributes:
        grade: Grade of the band: `trials`, `recording`, `law` or `none`.
        unit: Unit of `rmse`, `dtw`, `rmse_aligned` and `signed_error`.
        coordinates: Names of the scored coordinates, in the order of `signed_error`.
        rmse: E_RMSE of the paper.
        rmse_normalized: `rmse` over the published baseline mean; below 1 is closer than a typical real trial.
        dtw: E_DTW of the paper.
        dtw_normalized: `dtw` over the published baseline mean.
        release_offset_s: Constant time shift that minimises the RMSE [s]; positive when reality is released later.
        rmse_aligned: RMSE after that shift.
        rmse_aligned_normalized: `rmse_aligned` over the published baseline mean.
        mean_abs_z: Mean |deviation| in units of sigma(t), over measured frames.
        inside_1sigma: Share of measured values within 1 sigma.
        inside_2sigma: Share within 2 sigma.
        signed_error: Mean signed deviation of each scored coordinate.
        lsd_s: Longest stationary duration of the last ball [s].
        lsd_normalized: `lsd_s` over the published mean; 1 is ideal.
        lsd_speed_3d_s: LSD if the speed in space is limited, in place of that of the height [s].
        lsd_speed_3d_normalized: `lsd_speed_3d_s` over the published mean.
        lsd_central_s: LSD if the speed of the height is that of central differences [s].
        lsd_central_normalized: `lsd_central_s` over the published mean.
        lsd_dropped_rests_s: Rests at the first and the last frame, which no LSD counts [s].
        mte: Momentum transfer efficiency, ratio.
        mte_normalized: `mte` over the published mean; 1 is ideal.
        pd_s: Period [s].
        pd_normalized: `pd_s` over the published mean; 1 is ideal.
        pd_fft_s: Period of the strongest bin of the plain Fourier spectrum [s].
        pd_fft_normalized: `pd_fft_s` over the published mean.
        events: Times of the cradle's last ball, simulated and recorded.
        el: Energy loss, ratio; 0 is ideal.
        withheld: Why the band is not used by default; None for a band that is.
        edited: Whether the scene is that of an asset which differs from the calibrated scene.
    """

    grade: str
    unit: str
    coordinates: tuple[str, ...] | None = None
    rmse: float | None = None
    rmse_normalized: float | None = None
    dtw: float | None = None
    dtw_normalized: float | None = None
    release_offset_s: float | None = None
    rmse_aligned: float | None = None
    rmse_aligned_normalized: float | None = None
    mean_abs_z: float | None = None
    inside_1sigma: float | None = None
    inside_2sigma: float | None = None
    signed_error: tuple[float, ...] | None = None
    lsd_s: float | None = None
    lsd_normalized: float | None = None
    lsd_speed_3d_s: float | None = None
    lsd_speed_3d_normalized: float | None = None
    lsd_central_s: float | None = None
    lsd_central_normalized: float | None = None
    lsd_dropped_rests_s: tuple[float, float] | None = None
    mte: float | None = None
    mte_normalized: float | None = None
    pd_s: float | None = None
    pd_normalized: float | None = None
    pd_fft_s: float | None = None
    pd_fft_normalized: float | None = None
    events: tuple[EventTime, ...] | None = None
    el: float | None = None
    withheld: str | None = None
    edited: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary of all fields."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Score:
        """Build a score from `to_dict`; keys of later versions are ignored."""
        known = {f.name for f in fields(cls)}
        given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if k in known}
        if given.get("events") is not None:
            given["events"] = tuple(EventTime(**event) for event in given["events"])
        return cls(**given)


def score_trajectory(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
) -> Score:
    """Score a generalized trajectory.

    Args:
        experiment: Experiment that was simulated.
        band: Reference to score against; None leaves the metrics that need no band.
        times_s: Times of the samples since the first frame [s], strictly increasing, shape [sample_count]. They contain
            the 30 Hz frames; more samples make the release offset more precise.
        values: g(t) at those times, shape [sample_count, coordinate_count].

    Raises:
        ShapeError: A frame is missing, or values are not finite or have the wrong width.
    """
    frames = _frames(experiment, times_s, values)
    baselines = experiment.baselines
    scores: dict[str, Any] = {}
    if band is not None:
        scores |= _band_scores(band, baselines if band.normalized_by_baseline else {}, times_s, values, frames)
    scores |= _metric_fields(swing_metrics(experiment, frames), baselines)
    scores |= swing_notes(experiment, frames, times_s=times_s, values=values)
    # NaN is an event that never happens, or a mean over no measured value. It is reported as None.
    scores = {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in scores.items()}
    return Score(
        grade=(BandGrade.NONE if band is None else band.grade).value,
        unit=experiment.score.observable.unit,
        withheld=None if band is None else band.withheld,
        edited=experiment.edited,
        **scores,
    )


def _frames(experiment: Experiment, times_s: FloatArray, values: FloatArray) -> FloatArray:
    wanted = np.arange(experiment.frame_count) / FRAME_RATE_HZ
    index = np.clip(np.searchsorted(times_s, wanted - 1e-6), 0, len(times_s) - 1)
    missing = np.abs(times_s[index] - wanted) > 1e-4
    if missing.any():
        frame = int(missing.argmax())
        raise ShapeError(
            f"{experiment.name} needs {experiment.frame_count} frames at 30 Hz: "
            f"no sample at frame {frame} (t = {wanted[frame]:.4f} s)"
        )
    return values[index]


def _over(value: float, baselines: Mapping[str, Baseline], metric: str) -> float | None:
    baseline = baselines.get(metric)
    return value / baseline.mean if baseline is not None and baseline.mean else None


def _metric_fields(raw: Mapping[str, float], baselines: Mapping[str, Baseline]) -> dict[str, float | None]:
    """Return the fields of `Score` for raw scores by metric, each with its normalized one."""
    scores: dict[str, float | None] = {}
    for key, value in raw.items():
        metric = METRICS[key]
        scores[metric.score_field] = value
        if metric.normalized_field is not None:
            scores[metric.normalized_field] = _over(value, baselines, key)
    return scores


def _band_scores(
    band: Band, baselines: Mapping[str, Baseline], times_s: FloatArray, values: FloatArray, frames: FloatArray
) -> dict[str, Any]:
    simulated = band.project(frames)
    # A recording may end before the episode. Frames without a mean would be warped onto its last frame.
    known = np.isfinite(band.mean).any(axis=1)
    distances = {
        "rmse": trajectory_rmse(simulated, band.mean),
        "dtw": trajectory_dtw(simulated[known], band.mean[known]),
    }
    # The mean of a law is exact from frame 0 on. A shift of time would only hide a drift.
    offset_s, aligned = None, None
    if band.grade is not BandGrade.LAW:
        offset_s, aligned = release_offset(times_s, band.project(values), band.mean, frame_rate_hz=FRAME_RATE_HZ)
    # Frames that were not measured are extrapolated: their mean is usable, their scatter is no data.
    sigma = np.where(band.measured[:, None], band.sigma, np.nan)
    z = z_scores(simulated, band.mean, sigma)
    return _metric_fields(distances, baselines) | {
        "coordinates": band.coordinates,
        "release_offset_s": offset_s,
        "rmse_aligned": aligned,
        "rmse_aligned_normalized": None if aligned is None else _over(aligned, baselines, "rmse"),
        "mean_abs_z": mean_abs_z(z),
        "inside_1sigma": band_coverage(z, 1.0),
        "inside_2sigma": band_coverage(z, 2.0),
        "signed_error": tuple(signed_error(simulated, band.mean).tolist()),
    }
