"""Score one trajectory: every number that is reported for an episode.

A score answers one of two questions. Validation: is the motion like reality? The distance from real trials or a
recording is divided by the scatter of real trials. Verification: does the engine solve its scene? The distance from a
law or a solved model is divided by what the solution leaves open. An event is compared with its published real value
under any grade.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cache
from typing import Any

import numpy as np
from pydantic import TypeAdapter, model_validator

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.models import solved_model
from gauge_envs.references.published import Baseline
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scoring.deviation import (
    Deviation,
    Deviations,
    band_deviations,
    normalizing_baselines,
    percentile_among,
    percentile_interval,
    sampled_frames,
    trial_distances,
)
from gauge_envs.scoring.implied import ImpliedParameter, implied_parameters
from gauge_envs.scoring.likely_mistakes import value_mistake
from gauge_envs.scoring.metrics.trajectory import (
    band_coverage,
    dtw_path,
    mean_abs_z,
    signed_error,
    trajectory_rmse,
    z_scores,
)
from gauge_envs.scoring.reference import reference_loads
from gauge_envs.scoring.swing import (
    EventTime,
    event_intervals,
    swing_metrics,
    swing_notes,
)
from gauge_envs.scoring.verification import Verification, verify, verify_loads

VERIFICATION = "verification"
"""Value of `Score.primary` for a law and a solved model."""


@dataclass(frozen=True, kw_only=True)
class Validation:
    """How far an episode is from reality, over the scatter of real trials. None is a number that the trials lack.

    Attributes:
        rmse_normalized: `rmse` of the score over the published baseline mean; 1 is the mean of real trials, and not
            their median.
        rmse_normalized_95: 95 % interval of `rmse_normalized`, low and high (`scoring.uncertainty`).
        rmse_95: 95 % interval of `rmse`, in the unit of the score.
        rmse_aligned_normalized: `rmse_aligned` over the mean of that of the real trials, each aligned to the mean of
            the others. None without single trials.
        rmse_aligned_normalized_95: 95 % interval of `rmse_aligned_normalized`.
        rmse_aligned_95: 95 % interval of `rmse_aligned`.
        dtw_normalized: `dtw` over the published baseline mean.
        dtw_normalized_95: 95 % interval of `dtw_normalized`.
        trial_count: Number of single real trials that percentiles are of; None without single trials.
        percentile: Percentage of the real trials that are closer to the mean of the others than the simulation is to
            the mean, by RMSE; None without single trials.
        percentile_95: 95 % interval of the percentage of all such trials, also unseen ones.
        percentile_aligned: As `percentile`, with the simulation and each trial aligned.
        percentile_aligned_95: 95 % interval of the percentage of all such trials.
        mean_abs_z: Mean |deviation| in units of sigma(t), over measured frames.
        inside_1sigma: Share of measured values within 1 sigma.
        inside_2sigma: Share within 2 sigma.
        refused: Intervals that the trials do not support, each with its reason, as `rmse_95: 2 trials: ...`.
    """

    rmse_normalized: float | None = None
    rmse_normalized_95: tuple[float, float] | None = None
    rmse_95: tuple[float, float] | None = None
    rmse_aligned_normalized: float | None = None
    rmse_aligned_normalized_95: tuple[float, float] | None = None
    rmse_aligned_95: tuple[float, float] | None = None
    dtw_normalized: float | None = None
    dtw_normalized_95: tuple[float, float] | None = None
    trial_count: int | None = None
    percentile: float | None = None
    percentile_95: tuple[float, float] | None = None
    percentile_aligned: float | None = None
    percentile_aligned_95: tuple[float, float] | None = None
    mean_abs_z: float | None = None
    inside_1sigma: float | None = None
    inside_2sigma: float | None = None
    refused: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Score:
    """Distance of an episode from its reference. None is a metric that does not apply or has no reference.

    The grade says which question is answered, and one of two fields has the answer: `validation` for `trials` and
    `recording`, `verification` for `law` and `model`. `rmse`, `dtw` and `rmse_aligned` are distances of g(t) from the
    reference in its unit, under any grade. Events have their published real values under any grade.

    Attributes:
        grade: Grade of the band: `trials`, `recording`, `law`, `model` or `none`.
        unit: Unit of `rmse`, `dtw`, `rmse_aligned` and `signed_error`.
        primary: Field with the score that reports show first: `verification` for a law and a solved model,
            `rmse_aligned` for an experiment that starts with a release, else `rmse`; None without a band.
        validation: How far the episode is from reality, over the scatter of real trials; None for other grades than
            `trials` and `recording`.
        verification: How far the episode is from the solution of its scene; None for other grades than `law` and
            `model`, and where a model is compared by markers whose positions are not known.
        also_verified: The same of further quantities, as the force on a rod; empty where the engine or the file does
            not state them. Ranks are by `verification`.
        coordinates: Names of the scored coordinates, in the order of `signed_error`.
        rmse: E_RMSE of the paper, the root mean square distance from the mean of the reference.
        dtw: E_DTW of the paper.
        release_offset_s: Constant time shift that minimises the RMSE [s]; positive when reality is released later.
        rmse_aligned: RMSE after that shift.
        compared_frames: Number of frames with a mean.
        measured_frames: Number of those that at least half of the trials show; the others are extrapolated.
        extrapolated_share: Share of the squared error, without alignment, in extrapolated frames.
        signed_error: Mean signed deviation of each scored coordinate.
        lsd_s: Longest stationary duration of the last ball [s].
        lsd_normalized: `lsd_s` over the published mean; 1 is ideal.
        lsd_normalized_95: 95 % interval of `lsd_normalized`.
        lsd_speed_3d_s: LSD if the speed in space is limited, in place of that of the height [s].
        lsd_speed_3d_normalized: `lsd_speed_3d_s` over the published mean.
        lsd_central_s: LSD if the speed of the height is that of central differences [s].
        lsd_central_normalized: `lsd_central_s` over the published mean.
        lsd_dropped_rests_s: Rests at the first and the last frame, which no LSD counts [s].
        mte: Momentum transfer efficiency, ratio.
        mte_normalized: `mte` over the published mean; 1 is ideal.
        mte_normalized_95: 95 % interval of `mte_normalized`.
        pd_s: Period [s].
        pd_normalized: `pd_s` over the published mean; 1 is ideal.
        pd_normalized_95: 95 % interval of `pd_normalized`.
        pd_fft_s: Period of the strongest bin of the plain Fourier spectrum [s].
        pd_fft_normalized: `pd_fft_s` over the published mean.
        events: Times of the cradle's last ball, simulated and recorded.
        el: Energy loss, ratio; 0 is ideal.
        implied: Physical parameters that the trajectory implies, beside those of the real trials.
        rmse_without: RMSE to the mean of the solutions without one engine, by that engine, of the engines that made a
            reference of grade `model`; empty for other grades. That of the simulated engine is free of its own part.
        withheld: Why the band is not used by default; None for a band that is.
        edited: Whether the scene is that of an asset which differs from the calibrated scene.

    Raises:
        ValueError: Both questions are answered, or that of another grade.
    """

    grade: str
    unit: str
    primary: str | None = None
    validation: Validation | None = None
    verification: Verification | None = None
    also_verified: tuple[Verification, ...] = ()
    coordinates: tuple[str, ...] | None = None
    rmse: float | None = None
    dtw: float | None = None
    release_offset_s: float | None = None
    rmse_aligned: float | None = None
    compared_frames: int | None = None
    measured_frames: int | None = None
    extrapolated_share: float | None = None
    signed_error: tuple[float, ...] | None = None
    lsd_s: float | None = None
    lsd_normalized: float | None = None
    lsd_normalized_95: tuple[float, float] | None = None
    lsd_speed_3d_s: float | None = None
    lsd_speed_3d_normalized: float | None = None
    lsd_central_s: float | None = None
    lsd_central_normalized: float | None = None
    lsd_dropped_rests_s: tuple[float, float] | None = None
    mte: float | None = None
    mte_normalized: float | None = None
    mte_normalized_95: tuple[float, float] | None = None
    pd_s: float | None = None
    pd_normalized: float | None = None
    pd_normalized_95: tuple[float, float] | None = None
    pd_fft_s: float | None = None
    pd_fft_normalized: float | None = None
    events: tuple[EventTime, ...] | None = None
    el: float | None = None
    implied: tuple[ImpliedParameter, ...] = ()
    rmse_without: Mapping[str, float] = field(default_factory=dict, hash=False)
    withheld: str | None = None
    edited: bool = False

    def __post_init__(self) -> None:
        """Check that the score answers the question of its grade alone."""
        is_solved = self.grade in (BandGrade.LAW, BandGrade.MODEL)
        other = self.validation if is_solved else self.verification
        if other is not None:
            name = type(other).__name__.lower()
            raise ValueError(f"a score of grade {self.grade!r} has no {name}")

    @model_validator(mode="before")
    @classmethod
    def _of_earlier_versions(cls, values: Any) -> Any:
        """Return the keys of this version.

        gauge-envs 0.2 and earlier had no `validation`: its fields stood in the score. For a law and a model they were
        divided by the scatter of real trials, and are left out.
        """
        if not isinstance(values, dict) or "validation" in values:
            return values
        grade, primary = values.get("grade"), values.get("primary")
        if grade in (BandGrade.LAW, BandGrade.MODEL):
            return values | {"primary": primary and VERIFICATION}
        if primary is None:
            return values
        names = [one.name for one in fields(Validation) if one.name in values]
        return values | {"validation": {name: values[name] for name in names}}

    @property
    def verifications(self) -> tuple[Verification, ...]:
        """The distances of all verified quantities."""
        first = () if self.verification is None else (self.verification,)
        return (*first, *self.also_verified)

    @property
    def primary_normalized(self) -> float | None:
        """The score that reports show first, over its scale.

        That is the mean distance of real trials, or u of a solution; an exact solution leaves it in its unit.
        """
        if self.verification is not None:
            return self.verification.scaled
        if self.validation is None:
            return None
        value: float | None = getattr(self.validation, f"{self.primary}_normalized")
        return value

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary of all fields."""
        return {
            k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Score:
        """Build a score from `to_dict`, also that of an earlier version; keys of later versions are ignored.

        Raises:
            pydantic.ValidationError: A value has the wrong type.
        """
        return _score_adapter().validate_python(dict(values))


@cache
def _score_adapter() -> TypeAdapter[Score]:
    """Return what validates scores; it is slow to build."""
    return TypeAdapter(Score)


def score_trajectory(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
    markers_m: FloatArray | None = None,
    wrenches: FloatArray | None = None,
    is_checked: bool = False,
) -> Score:
    """Score a generalized trajectory.

    Args:
        experiment: Experiment that was simulated.
        band: Reference to score against; None leaves the metrics that need no band.
        times_s: Times of the samples since the first frame [s], strictly increasing, shape [sample_count]. They contain
            the 30 Hz frames; more samples make the release offset more precise. Samples after the last frame let the
            simulation be shifted to earlier times.
        values: g(t) at those times, shape [sample_count, coordinate_count].
        markers_m: Positions of the markers at the frames [m], shape [frame_count, marker_count, 3], which solved models
            of cloth and foam are compared by; None if they are not known.
        wrenches: Wrenches of the scene's `holders` in the mean over each frame, shape [frame_count, holder_count, 6];
            None if they are not known.
        is_checked: Whether unit and start are known to be right, as those of an episode.

    Raises:
        ShapeError: A frame is missing, or values are not finite or have the wrong width; or they have another unit
            than the observable, or start elsewhere than the scene.
    """
    frames = sampled_frames(experiment, times_s, values)
    if not is_checked and np.isfinite(frames[0]).all():
        fault = value_mistake(experiment, frames, band=band)
        if fault is not None:
            raise ShapeError(f"{experiment.name}: {fault}")
    baselines = experiment.baselines
    scores: dict[str, Any] = {}
    if band is not None:
        scores |= _band_scores(experiment, band, times_s, values, frames)
    scores["implied"] = implied_parameters(
        experiment,
        band,
        times_s=times_s,
        values=values,
        release_offset_s=scores.get("release_offset_s"),
    )
    events = swing_metrics(experiment, frames)
    notes = swing_notes(experiment, frames, times_s=times_s, values=values)
    scores |= (
        _event_fields(events, baselines)
        | notes
        | event_intervals(events, notes, baselines)
    )
    scores = {
        key: _known(value) if isinstance(value, float) else value
        for key, value in scores.items()
    }
    return Score(
        grade=(BandGrade.NONE if band is None else band.grade).value,
        unit=experiment.score.observable.unit,
        withheld=None if band is None else band.withheld,
        edited=experiment.edited,
        verification=verify(band, frames=frames, markers_m=markers_m),
        also_verified=verify_loads(
            reference_loads(experiment, band),
            band,
            holders=experiment.scene.holders,
            wrenches=wrenches,
        ),
        **scores,
    )


def _over(value: float, baselines: Mapping[str, Baseline], metric: str) -> float | None:
    baseline = baselines.get(metric)
    return value / baseline.mean if baseline is not None and baseline.mean else None


def _event_fields(
    raw: Mapping[str, float], baselines: Mapping[str, Baseline]
) -> dict[str, float | None]:
    """Return the fields of `Score` for events by metric, each with its normalized one."""
    scores: dict[str, float | None] = {}
    for key, value in raw.items():
        metric = METRICS[key]
        scores[metric.score_field] = value
        if metric.normalized_field is not None:
            scores[metric.normalized_field] = _over(value, baselines, key)
    return scores


def _band_scores(
    experiment: Experiment,
    band: Band,
    times_s: FloatArray,
    values: FloatArray,
    frames: FloatArray,
) -> dict[str, Any]:
    """Return the distances of g(t) from a band, and what its grade says of them."""
    simulated = band.project(frames)
    deviations = band_deviations(experiment, band, times_s=times_s, values=values)
    # A recording may end before the episode. Frames without a mean would be warped onto its last frame.
    known = np.isfinite(band.mean).any(axis=1)
    cost, path = dtw_path(simulated[known], band.mean[known])
    aligned = deviations.aligned
    squares = np.nansum(np.square(deviations.raw.values), axis=1)
    scores: dict[str, Any] = {
        "primary": VERIFICATION if band.grade.is_solution else deviations.primary,
        "rmse": deviations.raw.rmse,
        "dtw": cost / len(path),
        "release_offset_s": deviations.release_offset_s,
        "rmse_aligned": None if aligned is None else aligned.rmse,
        "coordinates": band.coordinates,
        "compared_frames": int(known.sum()),
        "measured_frames": int((known & band.measured).sum()),
        "extrapolated_share": float(squares[~band.measured].sum() / squares.sum())
        if squares.any()
        else 0.0,
        "signed_error": tuple(signed_error(simulated, band.mean).tolist()),
    }
    if not band.grade.is_solution:
        scores["validation"] = _validation(
            band,
            deviations,
            simulated,
            np.flatnonzero(known)[path],
            dtw=scores["dtw"],
            baselines=normalizing_baselines(experiment, band),
        )
    elif band.grade is BandGrade.MODEL and (solved := solved_model(experiment.name)):
        scores["rmse_without"] = {
            name: trajectory_rmse(simulated, mean)
            for name, mean in solved.others.items()
        }
    return scores


def _validation(
    band: Band,
    deviations: Deviations,
    simulated: FloatArray,
    path_frames: IntArray,
    *,
    dtw: float,
    baselines: Mapping[str, Baseline],
) -> Validation:
    """Return what real trials say of deviations from their mean.

    Args:
        band: Reference of grade `trials` or `recording`.
        deviations: The deviations.
        simulated: Band coordinates of the simulation at the frames, shape [T, C].
        path_frames: Frames (simulated, real) of the cells of the warping path, shape [cell_count, 2].
        dtw: E_DTW of the simulation, in the unit of the band.
        baselines: Published scores of real trials that distances are divided by, by metric.
    """
    # Frames that were not measured are extrapolated: their mean is usable, their scatter is no data.
    sigma = np.where(band.measured[:, None], band.sigma, np.nan)
    z = z_scores(simulated, band.mean, sigma)
    raw, aligned = deviations.raw, deviations.aligned
    trials = trial_distances(band)
    found: dict[str, Any] = {
        "rmse_normalized": _over(raw.rmse, baselines, "rmse"),
        "rmse_normalized_95": raw.normalized_interval,
        "rmse_95": raw.interval,
        "dtw_normalized": _over(dtw, baselines, "dtw"),
        "mean_abs_z": _known(mean_abs_z(z)),
        "inside_1sigma": _known(band_coverage(z, 1.0)),
        "inside_2sigma": _known(band_coverage(z, 2.0)),
        "refused": tuple(_refused(deviations)),
    }
    if aligned is not None:
        found |= {
            "rmse_aligned_normalized": aligned.normalized,
            "rmse_aligned_normalized_95": aligned.normalized_interval,
            "rmse_aligned_95": aligned.interval,
        }
    if trials is not None:
        found["trial_count"] = len(trials.raw)
        found |= _percentiles("percentile", trials.raw, raw)
        if aligned is not None:
            found |= _percentiles("percentile_aligned", trials.aligned, aligned)
    dtw_baseline = baselines.get("dtw")
    if raw.baseline is not None and dtw_baseline is not None and dtw_baseline.mean:
        ends = raw.errors.path_interval(path_frames, simulated, band.mean)
        if ends is not None:
            low, high = ends
            found["dtw_normalized_95"] = (
                low / dtw_baseline.mean,
                high / dtw_baseline.mean,
            )
    return Validation(**found)


def _known(value: float) -> float | None:
    """Return a value; None for NaN, as of an event that never happens, or a mean over no measured value."""
    return None if math.isnan(value) else value


def _percentiles(
    field: str, distances: FloatArray, deviation: Deviation
) -> dict[str, Any]:
    return {
        field: percentile_among(distances, deviation.rmse),
        f"{field}_95": percentile_interval(
            distances, deviation.rmse, deviation.interval
        ),
    }


def _refused(deviations: Deviations) -> Iterator[str]:
    for name, one in (("rmse", deviations.raw), ("rmse_aligned", deviations.aligned)):
        refusals = (None, None) if one is None else one.refusals
        for end, reason in zip(("", "normalized_"), refusals, strict=True):
            if reason is not None:
                yield f"{name}_{end}95: {reason}"
