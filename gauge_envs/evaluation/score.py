"""One trajectory against reality: every number that is reported of an episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics import (
    band_coverage,
    energy_loss,
    longest_stationary_duration,
    mean_abs_z,
    momentum_transfer_efficiency,
    oscillation_period,
    release_offset,
    signed_error,
    trajectory_dtw,
    trajectory_rmse,
    z_scores,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.scene import Hinge
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "Score",
    "score_trajectory",
]


@dataclass(frozen=True, kw_only=True)
class Score:
    """How far an episode is from reality. None where a metric does not apply or has no reference.

    Attributes:
        grade: Grade of the band: `trials`, `recording`, `law` or `none`.
        unit: Unit of `rmse`, `dtw`, `rmse_aligned` and `signed_error`.
        coordinates: Names of the scored coordinates, in the order of `signed_error`.
        rmse: E_RMSE of the paper.
        rmse_normalized: `rmse` over the published baseline mean; below 1 is closer than a typical real trial.
        dtw: E_DTW of the paper.
        dtw_normalized: `dtw` over the published baseline mean.
        release_offset_s: Constant time shift that minimises the RMSE [s]; positive: reality is released later.
        rmse_aligned: RMSE left after that shift.
        rmse_aligned_normalized: `rmse_aligned` over the published baseline mean.
        mean_abs_z: Mean |deviation| in units of sigma(t), over measured frames.
        inside_1sigma: Share of measured values within 1 sigma.
        inside_2sigma: Share within 2 sigma.
        signed_error: Mean signed deviation of each scored coordinate.
        lsd_s: Longest stationary duration of the last ball [s].
        lsd_normalized: Over the published mean; 1 is ideal.
        mte: Momentum transfer efficiency, ratio.
        mte_normalized: Over the published mean; 1 is ideal.
        pd_s: Period [s].
        pd_normalized: Over the published mean; 1 is ideal.
        el: Energy loss, ratio; 0 is ideal.
        withheld: Why nothing is scored on this band unless it is asked for; None where it is scored on.
        edited: Whether the scene was that of an asset which differs from the calibrated one.
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
    mte: float | None = None
    mte_normalized: float | None = None
    pd_s: float | None = None
    pd_normalized: float | None = None
    el: float | None = None
    withheld: str | None = None
    edited: bool = False

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary, every field present."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Score:
        """Inverse of `to_dict`; keys of later versions are ignored."""
        known = {f.name for f in fields(cls)}
        given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if k in known}
        return cls(**given)


def score_trajectory(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: NDArray[np.float64],
    values: NDArray[np.float64],
) -> Score:
    """Score a generalized trajectory.

    Args:
        experiment: The experiment that it is of.
        band: Reference to score it against; None scores only what needs no band.
        times_s: Times of the samples from the first frame on [s], strictly increasing, shape [sample_count]; they must
            contain the 30 Hz frames, and more samples make the release alignment sharper.
        values: g(t) at those times, shape [sample_count, coordinate_count].

    Raises:
        ShapeError: A frame is missing, or values are not finite or have the wrong width.
    """
    frames = _frames(experiment, times_s, values)
    baselines = experiment.baselines
    scores: dict[str, Any] = {}
    if band is not None:
        scores |= _band_scores(band, baselines, times_s, values, frames)
    scores |= _event_scores(experiment, baselines, frames)
    # An event that never happens, or a scale that nothing was measured on, is NaN: no number, and so none reported.
    scores = {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in scores.items()}
    grade = band.grade if band is not None else BandGrade.NONE
    withheld = None if band is None else band.withheld
    return Score(
        grade=grade.value,
        unit=experiment.score.observable.unit,
        withheld=withheld,
        edited=experiment.edited,
        **scores,
    )


def _frames(experiment: Experiment, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
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


def _over(value: float, baselines: Mapping[str, Any], metric: str) -> float | None:
    baseline = baselines.get(metric)
    return value / baseline.mean if baseline is not None and baseline.mean else None


def _band_scores(
    band: Band,
    baselines: Mapping[str, Any],
    times_s: NDArray[np.float64],
    values: NDArray[np.float64],
    frames: NDArray[np.float64],
) -> dict[str, Any]:
    simulated = band.project(frames)
    rmse = trajectory_rmse(simulated, band.mean)
    # Warping would else hold what comes after the end of a recording against the recording's last frame.
    known = np.isfinite(band.mean).any(axis=1)
    dtw = trajectory_dtw(simulated[known], band.mean[known])
    # A law has no release: its mean is exact from frame 0 on, and a shift would only hide a drift.
    offset_s, aligned = None, None
    if band.grade is not BandGrade.LAW:
        offset_s, aligned = release_offset(times_s, band.project(values), band.mean, frame_rate_hz=FRAME_RATE_HZ)
    # Frames before the first measurement are extrapolated: good enough for a mean, but their scatter is not data.
    sigma = np.where(band.measured[:, None], band.sigma, np.nan)
    z = z_scores(simulated, band.mean, sigma)
    return {
        "coordinates": band.coordinates,
        "rmse": rmse,
        "rmse_normalized": _over(rmse, baselines, "rmse"),
        "dtw": dtw,
        "dtw_normalized": _over(dtw, baselines, "dtw"),
        "release_offset_s": offset_s,
        "rmse_aligned": aligned,
        "rmse_aligned_normalized": None if aligned is None else _over(aligned, baselines, "rmse"),
        "mean_abs_z": mean_abs_z(z),
        "inside_1sigma": band_coverage(z, 1.0),
        "inside_2sigma": band_coverage(z, 2.0),
        "signed_error": tuple(signed_error(simulated, band.mean).tolist()),
    }


def _event_scores(
    experiment: Experiment, baselines: Mapping[str, Any], frames: NDArray[np.float64]
) -> dict[str, float | None]:
    """LSD and MTE of a cradle's last ball, period and energy loss of a pendulum, where the task file asks for them."""
    wanted = experiment.score.metrics
    scores: dict[str, float | None] = {}
    if not {"lsd", "mte", "pd", "el"} & set(wanted):
        return scores
    body = experiment.recorded[0]
    hinge = next(j for j in experiment.scene.joints if isinstance(j, Hinge) and j.body == body)
    arm_m = float(np.linalg.norm(np.subtract(experiment.scene.body(body).pose.position_m, hinge.anchor_m)))
    rest_height_mm = 1e3 * (hinge.anchor_m[2] - arm_m)
    height_mm = frames[:, 2]
    if "lsd" in wanted:
        lsd_s = longest_stationary_duration(height_mm, frame_rate_hz=FRAME_RATE_HZ)
        scores |= {"lsd_s": lsd_s, "lsd_normalized": _over(lsd_s, baselines, "lsd")}
    if "mte" in wanted:
        highest = max(experiment.scene.body(j.body).pose.position_m[2] for j in experiment.scene.joints)
        mte = momentum_transfer_efficiency(
            height_mm, drop_height_mm=1e3 * highest - rest_height_mm, rest_height_mm=rest_height_mm
        )
        scores |= {"mte": mte, "mte_normalized": _over(mte, baselines, "mte")}
    if "pd" in wanted:
        axis = "xyz".index(experiment.score.period_axis or "x")
        count = baselines["pd"].frames if "pd" in baselines else len(frames)
        pd_s = oscillation_period(frames[:count, axis], frame_rate_hz=FRAME_RATE_HZ)
        scores |= {"pd_s": pd_s, "pd_normalized": _over(pd_s, baselines, "pd")}
    if "el" in wanted:
        scores["el"] = energy_loss(height_mm, rest_height_mm=rest_height_mm)
    return scores
