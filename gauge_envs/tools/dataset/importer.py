"""Import a dataset folder, one variant after another."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.files import json_ready
from gauge_envs.observables.kinds import Observable, coordinate_names
from gauge_envs.pages.text import counted
from gauge_envs.reading import content_of
from gauge_envs.references.band import Band
from gauge_envs.references.imported import (
    DriverRecord,
    ImportFacts,
    SpreadRecord,
    write_imported,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import (
    PUBLISHED_TRIALS,
    Baseline,
    published_baselines,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.events import event_values
from gauge_envs.scoring.interval import COVERAGE_FACTOR
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.user_file.gate import (
    MIN_RATIO,
    MIN_RATIO_OF_FEW,
    MIN_TRIALS,
    median_motion,
    rms_over_frames,
    trial_faults,
)
from gauge_envs.scoring.user_file.motion_checks import filled
from gauge_envs.text import printable
from gauge_envs.tools.dataset.findings import ImportFinding, TrialError
from gauge_envs.tools.dataset.layout import Layout
from gauge_envs.tools.dataset.observation import (
    DriverTrack,
    driver_track,
    generalized_trajectory,
    point_names,
    reference_motion_mm,
    start_quaternions,
    trial_points,
)
from gauge_envs.tools.dataset.schema import BaselineLine
from gauge_envs.tools.dataset.statistics import (
    baselines_without,
    distances_to_mean,
    leave_one_out_distances,
    mean_and_sigma,
)
from gauge_envs.tools.dataset.trial import parse_trial

FLAGGED_DIFFERENCE = 0.1
"""Relative difference of an imported from a published baseline of the same trials that is flagged.

DTW of the published trials differs by 6 % if their first frames are extrapolated, and by up to 10 % with 1 mm of noise.
"""

MIN_TURN_RAD = math.radians(20.0)
"""Smallest rotation of a start from the other trials that is a fault; exchanged axes turn by more."""


@dataclass(frozen=True, kw_only=True)
class ImportedTrials:
    """Outcome of the import of one variant.

    Attributes:
        variant: The variant.
        facts: Stored facts; None if too few trials are usable.
        used: Number of trials in the band.
        left_out: Number of trial files that are left out.
        frame_count: Number of frames of the band.
        baselines: Imported and published baselines.
        findings: Problems of the files.
    """

    variant: Variant
    facts: ImportFacts | None
    used: int
    left_out: int
    frame_count: int
    baselines: Sequence[BaselineLine]
    findings: Sequence[ImportFinding]

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary."""
        facts = self.facts
        return {
            "id": self.variant.id,
            "imported": facts is not None,
            "trials": self.used,
            "left_out": self.left_out,
            "frames": facts and self.frame_count,
            "revision": facts and facts.revision,
            "sha256": facts and facts.files_sha256,
            "baselines": json_ready(self.baselines),
            "drivers": [] if facts is None else facts.model_dump()["drivers"],
        }


def baseline_lines(
    imported: Mapping[str, SpreadRecord], published: Mapping[str, Baseline]
) -> list[BaselineLine]:
    """Return the baselines of imported trials and of the paper (Table 5), a line for each metric."""
    metrics = dict.fromkeys([*imported, *published])
    return [
        _baseline_line(metric, imported.get(metric), published.get(metric))
        for metric in metrics
    ]


def _baseline_line(
    metric: str, own: SpreadRecord | None, paper: Baseline | None
) -> BaselineLine:
    spread, difference, is_flagged = own or paper, None, False
    if own is not None and paper is not None and paper.mean:
        difference = own.mean / paper.mean - 1.0
        is_flagged = not paper.disputed and abs(difference) > _plausible(own, paper)
    return BaselineLine(
        metric=metric,
        unit=spread.unit if spread else "",
        own_mean=own.mean if own else None,
        own_std=own.std if own else None,
        own_trial_count=own.trial_count if own else 0,
        published_mean=paper.mean if paper else None,
        published_std=paper.std if paper else None,
        difference=difference,
        flagged=is_flagged,
    )


def _plausible(own: SpreadRecord, paper: Baseline) -> float:
    """Return the largest plausible relative difference: more for another number of trials than the published one."""
    missed = math.sqrt(abs(1.0 / own.trial_count - 1.0 / PUBLISHED_TRIALS))
    return (
        FLAGGED_DIFFERENCE + COVERAGE_FACTOR * missed * (paper.std or 0.0) / paper.mean
    )


def import_trials(
    layout: Layout,
    *,
    defaults: Mapping[str, Any] | None = None,
    keep: bool = False,
) -> Iterator[ImportedTrials]:
    """Import the trials of a dataset into the user's data folder; store each variant before yielding it.

    Args:
        layout: Result of `find_trials`.
        defaults: `translation unit` and `FPS` of files without these values.
        keep: Whether trials count that are only too far from the others.

    Returns:
        Iterator that imports a variant per step. Damaged trials are left out and listed in the findings.

    Raises:
        DatasetError: The user's data folder cannot be written.
    """
    file_of: dict[str, str] = {}
    for _, group in groupby(layout.files, _experiment_of):
        read = [_read_all(layout, variant, defaults, file_of) for variant in group]
        motions = {
            experiment.name: median_motion(
                np.stack([sample.points_mm for sample in trials.values()])
            )
            for experiment, trials, _ in read
            if len(trials) >= MIN_TRIALS
        }
        for experiment, trials, findings in read:
            others = _other_motions(experiment.variant, motions)
            findings += _without_faults(experiment, trials, others, keep=keep)
            file_count = len(layout.files[experiment.variant])
            yield _imported(experiment, layout.revision, trials, findings, file_count)


def _experiment_of(variant: Variant) -> tuple[str, str | None]:
    """Return family and subtask, which all materials share."""
    return variant.family, variant.subtask


def _other_motions(
    variant: Variant, motions: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return the motions of the other materials by their names, shape [T, C] each.

    Args:
        variant: The variant.
        motions: Median trials by the names of their variants; a material without one has the motion of its reference.
    """
    found = {}
    for other in variants():
        if other == variant or _experiment_of(other) != _experiment_of(variant):
            continue
        motion = motions.get(other.name)
        if motion is None:
            motion = reference_motion_mm(load_experiment(other))
        if motion is not None:
            found[other.name] = motion
    return found


def _read_all(
    layout: Layout,
    variant: Variant,
    defaults: Mapping[str, Any] | None,
    file_of: dict[str, str],
) -> tuple[Experiment, dict[str, _TrialData], list[ImportFinding]]:
    """Return the experiment, the usable trials by their files, and the problems of the others; see `_read`."""
    # Project recorded motion on the motions of the task file, not of an earlier import.
    experiment = load_experiment(variant)
    trials: dict[str, _TrialData] = {}
    findings: list[ImportFinding] = []
    for path in layout.files[variant]:
        file = printable(path.relative_to(layout.root).as_posix())
        try:
            sample = _read(path, experiment, defaults, file_of)
        except TrialError as error:
            findings.append(error.finding(file))
        else:
            file_of[sample.sha256] = file
            trials[file] = sample
            if sample.fault is not None:
                findings.append(sample.fault.finding(file))
    return experiment, trials, findings


@dataclass(frozen=True, eq=False)
class _TrialData:
    """Data of one trial.

    Attributes:
        sha256: Hash of the file.
        points_mm: Positions of recorded bodies or markers [mm], shape [frame_count, 3 point_count].
        trajectory: g(t), shape [frame_count, coordinate_count].
        start_quaternions: Orientations in the first frames; empty for recorded markers.
        events: Values of event metrics; empty if a sample is missing.
        tracks: Motion of driven bodies.
        fault: Problem of a driven body; the trial stays in the band.
    """

    sha256: str
    points_mm: FloatArray
    trajectory: FloatArray
    start_quaternions: FloatArray
    events: Mapping[str, float]
    tracks: Sequence[DriverTrack]
    fault: TrialError | None


def _read(
    path: Path,
    experiment: Experiment,
    defaults: Mapping[str, Any] | None,
    file_of: Mapping[str, str],
) -> _TrialData:
    """Return the data of a trial file.

    Args:
        path: The file.
        experiment: Experiment of the trial.
        defaults: `translation unit` and `FPS` of files without these values.
        file_of: Files read before, by the hash of their content.

    Raises:
        TrialError: The trial is not usable.
    """
    try:
        content = content_of(path)
    except OSError as error:
        problem = f"it cannot be read: {error.strerror or error}"
        raise TrialError("(file)", problem, "a file is expected") from None
    sha256 = hashlib.sha256(content).hexdigest()
    if sha256 in file_of:
        problem = f"it is a copy of {file_of[sha256]}"
        raise TrialError("(file)", problem, "each trial counts once")
    trial = parse_trial(content, defaults)
    points_mm = trial_points(trial, experiment)
    trajectory = generalized_trajectory(points_mm, experiment)
    quaternions = np.empty(0)
    if experiment.recorded:
        quaternions = start_quaternions(trial, experiment)
    events: Mapping[str, float] = {}
    whole = filled(trajectory)
    if np.isfinite(whole).all():
        events = event_values(experiment, whole)
    tracks: Sequence[DriverTrack] = []
    fault = None
    try:
        drivers = experiment.scene.drivers
        tracks = [driver_track(driver, trial, experiment) for driver in drivers]
    except TrialError as error:
        fault = error
    return _TrialData(sha256, points_mm, trajectory, quaternions, events, tracks, fault)


def _without_faults(
    experiment: Experiment,
    trials: dict[str, _TrialData],
    others: Mapping[str, FloatArray],
    *,
    keep: bool,
) -> Iterator[ImportFinding]:
    """Remove trials and prescribed motions that the gate refuses, and yield why."""
    points = {file: sample.points_mm for file, sample in trials.items()}
    # Prescribed motions may differ from those of the reference.
    law = None if experiment.scene.drivers else reference_band(experiment)
    if law is not None:
        law = law.compared if law.compared.unit == "mm" else None
    if law is None and len(trials) < MIN_TRIALS:
        problem = f"{counted(len(trials), 'trial')}, not compared with each other"
        error = TrialError("(folder)", problem, f"{MIN_TRIALS} are needed")
        yield error.finding(experiment.name, left_out=False)
    names = point_names(experiment)
    for file, fault in trial_faults(names, points, law=law, others=others).items():
        is_kept = keep and fault.is_far
        if not is_kept:
            del trials[file]
        yield TrialError(*fault[:3]).finding(file, left_out=not is_kept)
    yield from _without_turned(experiment, trials, keep=keep)
    for index, driver in enumerate(experiment.scene.drivers):
        points = {
            file: sample.tracks[index].points_mm
            for file, sample in trials.items()
            if sample.tracks
        }
        parts = driver.body, f"{driver.body} (turned)", f"{driver.body} (tilted)"
        names = coordinate_names(Observable.POSITION, recorded=parts, markers=None)
        for file, fault in trial_faults(names, points, may_repeat=True).items():
            is_kept = keep and fault.is_far
            if not is_kept:
                trials[file] = replace(trials[file], tracks=())
            yield TrialError(*fault[:3]).finding(file, left_out=not is_kept)


def _without_turned(
    experiment: Experiment, trials: dict[str, _TrialData], *, keep: bool
) -> Iterator[ImportFinding]:
    """Remove orientations at the start that are too far from those of the other trials, and yield why."""
    for index, body in enumerate(experiment.recorded):
        starts = {
            file: sample.start_quaternions[0, index]
            for file, sample in trials.items()
            if np.isfinite(sample.start_quaternions[0, index]).all()
        }
        if len(starts) < MIN_TRIALS:
            continue
        angles_rad, limit_rad = _turns(np.array([*starts.values()]))
        for file, angle_rad in zip(starts, angles_rad, strict=True):
            if angle_rad <= limit_rad:
                continue
            if not keep:
                quaternions = trials[file].start_quaternions.copy()
                quaternions[:, index] = np.nan
                trials[file] = replace(trials[file], start_quaternions=quaternions)
            problem = f"it starts turned by {np.degrees(angle_rad):.0f} deg from the other trials"
            remedy = (
                "check the order x, y, z, w and the axes; its orientation is left out"
            )
            yield TrialError(f"{body}.q", problem, remedy).finding(
                file, left_out=not keep
            )


def _turns(quaternions: FloatArray) -> tuple[FloatArray, float]:
    """Return the angles [rad] of quaternions, shape [N, 4], from the most central one, and the largest plausible."""
    rotations = Rotation.from_quat(quaternions)
    angles_rad = np.array([(rotations * one.inv()).magnitude() for one in rotations])
    medians_rad = np.median(angles_rad, axis=1)
    ratio = MIN_RATIO + MIN_RATIO_OF_FEW / len(quaternions) ** 2
    limit_rad = max(MIN_TURN_RAD, ratio * float(medians_rad.min()))
    return angles_rad[medians_rad.argmin()], limit_rad


def _imported(
    experiment: Experiment,
    revision: str | None,
    trials: Mapping[str, _TrialData],
    findings: list[ImportFinding],
    file_count: int,
) -> ImportedTrials:
    """Store the trials of a variant, and return the outcome of the import."""
    left_out = file_count - len(trials)
    spreads: dict[str, SpreadRecord] = {}
    facts = None
    if trials:
        trajectories = np.stack([sample.trajectory for sample in trials.values()])
        mean, sigma = mean_and_sigma(trajectories)
        spreads = _spreads(experiment, trials, trajectories, mean)
        if np.isfinite(sigma).any():
            driver_values, records = _mean_drivers(experiment, trials)
            hashes = "\n".join(sample.sha256 for sample in trials.values())
            facts = ImportFacts(
                variant=experiment.name,
                left_out=left_out,
                revision=revision,
                files=tuple(trials),
                files_sha256=hashlib.sha256(hashes.encode()).hexdigest(),
                task_sha256=experiment.file_sha256,
                metrics=spreads,
                drivers=tuple(records),
            )
            band = _band(experiment, trajectories, facts.origin(len(trials)))
            quaternions = None
            if experiment.recorded:
                quaternions = np.stack(
                    [sample.start_quaternions for sample in trials.values()]
                )
            write_imported(band, driver_values, facts, quaternions)
    if facts is None:
        problem = f"usable trials: {len(trials)}"
        expected = "at least 2 with common frames are needed"
        error = TrialError("(folder)", problem, expected)
        findings.append(error.finding(experiment.name))
    return ImportedTrials(
        variant=experiment.variant,
        facts=facts,
        used=len(trials),
        left_out=left_out,
        frame_count=experiment.frame_count,
        baselines=baseline_lines(spreads, published_baselines(experiment.name)),
        findings=findings,
    )


def _spreads(
    experiment: Experiment,
    trials: Mapping[str, _TrialData],
    trajectories: FloatArray,
    mean: FloatArray,
) -> dict[str, SpreadRecord]:
    """Return the spread of each metric over trials."""
    values = dict(
        zip(("rmse", "dtw"), distances_to_mean(trajectories, mean), strict=True)
    )
    events = [sample.events for sample in trials.values() if sample.events]
    for metric in dict.fromkeys(chain.from_iterable(events)):
        values[metric] = np.array([event[metric] for event in events])
    unit = experiment.score.observable.unit
    spreads = {
        metric: SpreadRecord.of(numbers, METRICS[metric].unit_of(unit))
        for metric, numbers in values.items()
    }
    return {metric: spread for metric, spread in spreads.items() if spread is not None}


def _band(experiment: Experiment, trajectories: FloatArray, source: str) -> Band:
    """Return the band of trials of shape [trial_count, frame_count, coordinate_count]."""
    count = len(trajectories)
    mean, sigma = mean_and_sigma(trajectories)
    trial_rmse, trial_rmse_aligned = leave_one_out_distances(trajectories)
    return Band(
        kind=Kind.TRIALS,
        unit=experiment.score.observable.unit,
        coordinates=experiment.coordinates,
        projection=np.eye(len(experiment.coordinates)),
        mean=mean,
        sigma=sigma,
        measured=np.asarray(np.isfinite(mean).any(axis=1)),
        source=source,
        trial_count=count,
        trials=trajectories,
        trial_rmse=trial_rmse,
        trial_rmse_aligned=trial_rmse_aligned,
        baselines_without=baselines_without(trajectories),
        given_uncertainty=rms_over_frames(sigma) / np.sqrt(count),
    )


def _mean_drivers(
    experiment: Experiment, trials: Mapping[str, _TrialData]
) -> tuple[dict[str, FloatArray], list[DriverRecord]]:
    """Return the mean coordinates of recorded driven bodies, and their quality."""
    values, records = {}, []
    for index, driver in enumerate(experiment.scene.drivers):
        tracks = [sample.tracks[index] for sample in trials.values() if sample.tracks]
        if tracks:
            mean, sigma = mean_and_sigma(
                np.stack([track.coordinates for track in tracks])
            )
            # A motion needs two frames.
            if (np.isfinite(mean).sum(axis=0) >= 2).all():
                values[driver.body] = mean
                records.append(_driver_record(driver, tracks, sigma))
    return values, records


def _driver_record(
    driver: Driver, tracks: Sequence[DriverTrack], sigma: FloatArray
) -> DriverRecord:
    scatter = np.nan_to_num(sigma).max(axis=0)
    is_length = np.array([motion.kind == "translate" for motion in driver.motions])
    lengths_mm, angles_deg = 1e3 * scatter[is_length], np.degrees(scatter[~is_length])
    residual_mm = np.concatenate([track.residual_mm for track in tracks])
    residual_deg = np.degrees(np.concatenate([track.residual_rad for track in tracks]))
    return DriverRecord(
        body=driver.body,
        trial_count=len(tracks),
        residual_mm=float(_rms(residual_mm)),
        residual_deg=_summary(_rms, residual_deg),
        start_offset_mm=float(np.mean([track.start_offset_mm for track in tracks])),
        scatter_mm=_summary(np.max, lengths_mm),
        scatter_deg=_summary(np.max, angles_deg),
    )


def _rms(values: FloatArray) -> Any:
    return np.sqrt(np.square(values).mean())


def _summary(reduce: Callable[[FloatArray], Any], values: FloatArray) -> float | None:
    """Return a summary of values; None without any."""
    return float(reduce(values)) if values.size else None
