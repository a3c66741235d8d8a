"""Imports a dataset folder: one variant after another, one trial in memory at a time, whatever single files hold."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.dataset.layout import Layout
from gauge_envs.dataset.observation import DriverTrack, driver_tracks, trial_trajectory
from gauge_envs.dataset.statistics import CoordinateMean, TrialSpool, TrialSpread, TrialStatistics
from gauge_envs.dataset.trial import ImportFinding, Trial, TrialError, parse_trial
from gauge_envs.evaluation.score import score_trajectory
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.references.imported import DriverRecord, ImportFacts, SpreadRecord, VariantRecord, write_imported
from gauge_envs.references.metrics import EVENT_METRICS, METRICS
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "BaselineRow",
    "ImportedTrials",
    "import_trials",
]

FLAGGED_DIFFERENCE = 0.05
"""Own baselines that differ from the published ones by more than this share are flagged."""

LEAST_TRIALS = 2
"""Scatter needs two."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class BaselineRow:
    """One metric of the real trials among themselves, beside the paper's (Table 5).

    Attributes:
        metric: `rmse`, `dtw`, `lsd`, `mte`, `pd` or `el`.
        unit: Its unit.
        own: From the imported trials; None where they do not determine it.
        published: From the paper; None where it prints none.
    """

    metric: str
    unit: str
    own: TrialSpread | None
    published: Baseline | None

    @property
    def difference(self) -> float | None:
        """Own over published mean, less 1; None where one is missing or the published one is 0."""
        if self.own is None or self.published is None or not self.published.mean:
            return None
        return self.own.mean / self.published.mean - 1.0

    @property
    def is_flagged(self) -> bool:
        """Whether the two differ by more than 5 %."""
        return self.difference is not None and abs(self.difference) > FLAGGED_DIFFERENCE

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary."""
        return json_ready(
            {
                "metric": self.metric,
                "unit": self.unit,
                "own_mean": self.own and self.own.mean,
                "own_std": self.own and self.own.std,
                "own_trial_count": self.own.count if self.own else 0,
                "published_mean": self.published and self.published.mean,
                "published_std": self.published and self.published.std,
                "difference": self.difference,
                "flagged": self.is_flagged,
            }
        )


@dataclass(frozen=True, kw_only=True)
class ImportedTrials:
    """What the import of one variant found.

    Attributes:
        variant: Which one.
        record: What was stored; None where too few trials could be used.
        used: Number of trials that its band rests on.
        left_out: Number of trial files that were left out.
        rows: Baselines, own beside published.
        findings: What is wrong with its files.
    """

    variant: Variant
    record: VariantRecord | None
    used: int
    left_out: int
    rows: tuple[BaselineRow, ...]
    findings: tuple[ImportFinding, ...]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary."""
        record = self.record
        return {
            "id": self.variant.id,
            "imported": record is not None,
            "trials": self.used,
            "left_out": self.left_out,
            "frames": record and record.frame_count,
            "revision": record and record.revision,
            "sha256": record and record.files_sha256,
            "baselines": [row.to_dict() for row in self.rows],
            "drivers": [driver.model_dump() for driver in record.drivers] if record else [],
        }


def import_trials(layout: Layout, *, advance: Callable[[Path], None] | None = None) -> Iterator[ImportedTrials]:
    """Import the trials of a dataset into the user's data folder; each variant is stored before it is yielded.

    Args:
        layout: What `find_trials` found.
        advance: Called with each file when it is done.

    Returns:
        Iterator that imports the next variant when asked for it. A damaged trial is in the findings and left out.

    Raises:
        DatasetError: The user's data folder cannot be written.
    """
    seen: dict[str, str] = {}
    for variant, files in layout.files.items():
        importer = _VariantImporter(variant, layout, seen)
        with importer.spool:
            for path in files:
                importer.read(path)
                if advance is not None:
                    advance(path)
            yield importer.finish()


class _VariantImporter:
    """Collects the trials of one variant.

    Args:
        variant: Which one.
        layout: Where its files are.
        seen: Path of each file content that was read before, by its hash; it grows.
    """

    def __init__(self, variant: Variant, layout: Layout, seen: dict[str, str]) -> None:
        # Recorded motion is projected on the task file's motions, whatever was imported before.
        self._experiment = load_experiment(variant)
        self._layout = layout
        self._seen = seen
        self._coordinates = self._experiment.coordinates
        self.spool = TrialSpool(self._experiment.frame_count, len(self._coordinates))
        self._drivers = {driver.body: _DriverMean(driver) for driver in self._experiment.scene.drivers}
        self._events: dict[str, list[float]] = {metric: [] for metric in _event_metrics(self._experiment)}
        self._files: dict[str, str] = {}
        self._findings: list[ImportFinding] = []

    def read(self, path: Path) -> None:
        """Take up one trial file, or say why not."""
        file = self._layout.relative(path)
        try:
            content = _content(path)
            digest = hashlib.sha256(content).hexdigest()
            if digest in self._seen:
                raise TrialError("(file)", f"it is a copy of {self._seen[digest]}", "each trial counts once")
            trial = parse_trial(content)
            trajectory = trial_trajectory(trial, self._experiment)
        except TrialError as error:
            self._add_finding(file, error, left_out=True)
            return
        self._seen[digest] = file
        self._files[file] = digest
        self.spool.add(trajectory)
        self._add_events(file, trajectory)
        self._add_drivers(file, trial)
        self._add_unused_faults(file, trial)

    def finish(self) -> ImportedTrials:
        """Store what was collected."""
        used, left_out = self.spool.trial_count, sum(finding.left_out for finding in self._findings)
        statistics = self.spool.statistics() if used else None
        rows = self._rows(statistics)
        record = None
        if statistics is not None and used >= LEAST_TRIALS:
            record = self._store(statistics, rows, left_out)
        else:
            error = TrialError("(folder)", f"{used} of its trials can be used", f"{LEAST_TRIALS} or more are needed")
            self._add_finding(self._experiment.name, error, left_out=True)
        return ImportedTrials(
            variant=self._experiment.variant,
            record=record,
            used=used,
            left_out=left_out,
            rows=rows,
            findings=tuple(self._findings),
        )

    def _add_finding(self, file: str, error: TrialError, *, left_out: bool) -> None:
        self._findings.append(
            ImportFinding(file=file, key=error.key, what=error.what, right=error.right, left_out=left_out)
        )

    def _add_events(self, file: str, trajectory: FloatArray) -> None:
        if not self._events:
            return
        if np.isnan(trajectory).any():
            frame = int(np.isnan(trajectory).any(axis=1).argmax())
            error = TrialError(f"[{frame}]", "a sample is missing", "period and pauses need all; the band does without")
            self._add_finding(file, error, left_out=False)
            return
        times_s = np.arange(len(trajectory)) / FRAME_RATE_HZ
        score = score_trajectory(self._experiment, None, times_s=times_s, values=trajectory)
        for metric, values in self._events.items():
            value = getattr(score, METRICS[metric].score_field)
            values.append(np.nan if value is None else value)

    def _add_drivers(self, file: str, trial: Trial) -> None:
        """A trial whose driver is unknown still shows what it drove."""
        try:
            tracks = driver_tracks(trial, self._experiment)
        except TrialError as error:
            self._add_finding(file, error, left_out=False)
            return
        for track in tracks:
            self._drivers[track.body].add(track)

    def _add_unused_faults(self, file: str, trial: Trial) -> None:
        """What is wrong with assets that the experiment does not ask for, as a board that never moves."""
        for name, error in trial.faults.items():
            if name not in self._drivers:
                self._add_finding(file, error, left_out=False)

    def _rows(self, statistics: TrialStatistics | None) -> tuple[BaselineRow, ...]:
        published = published_baselines(self._experiment.name)
        own: dict[str, TrialSpread | None] = {}
        if statistics is not None:
            own = {"rmse": TrialSpread.of(statistics.rmse), "dtw": TrialSpread.of(statistics.dtw)}
        own |= {metric: TrialSpread.of(np.array(values)) for metric, values in self._events.items()}
        unit = self._experiment.score.observable.unit
        return tuple(
            BaselineRow(
                metric=metric,
                unit=METRICS[metric].unit_of(unit),
                own=own.get(metric),
                published=published.get(metric),
            )
            for metric in dict.fromkeys([*own, *published])
        )

    def _store(self, statistics: TrialStatistics, rows: tuple[BaselineRow, ...], left_out: int) -> VariantRecord:
        experiment = self._experiment
        band = Band(
            grade=BandGrade.TRIALS,
            unit=experiment.score.observable.unit,
            coordinates=self._coordinates,
            projection=np.eye(len(self._coordinates)),
            mean=statistics.mean,
            sigma=statistics.sigma,
            measured=statistics.measured,
            trial_count=self.spool.trial_count,
            source="import",
        )
        drivers = {body: mean for body, mean in self._drivers.items() if mean.is_usable}
        facts = ImportFacts(
            variant=experiment.name,
            left_out=left_out,
            revision=self._layout.revision,
            files=tuple(self._files),
            files_sha256=hashlib.sha256("\n".join(self._files.values()).encode()).hexdigest(),
            task_sha256=experiment.file_sha256,
            metrics=_spread_records(rows),
            drivers=tuple(mean.record() for mean in drivers.values()),
        )
        return write_imported(band, {body: mean.coordinates for body, mean in drivers.items()}, facts)


@dataclass
class _DriverMean:
    """Mean over trials of one driven body's coordinates, and what they leave out.

    Attributes:
        driver: Its bundled driver.
        sums: Running mean of the coordinates, and of their squares; None before the first trial.
        offsets_mm: Distance of each trial's start from the calibrated one.
        squares_mm: Mean square over each trial's frames of the distance that the coordinates leave out.
        squares_rad: The same of the angle, for trials with orientations.
    """

    driver: Driver
    sums: tuple[CoordinateMean, CoordinateMean] | None = None
    offsets_mm: list[float] = field(default_factory=list)
    squares_mm: list[float] = field(default_factory=list)
    squares_rad: list[float] = field(default_factory=list)

    def add(self, track: DriverTrack) -> None:
        """Add one trial."""
        if self.sums is None:
            self.sums = CoordinateMean(track.coordinates.shape), CoordinateMean(track.coordinates.shape)
        self.sums[0].add(track.coordinates)
        self.sums[1].add(np.square(track.coordinates))
        self.offsets_mm.append(track.start_offset_mm)
        self.squares_mm.append(float(np.nanmean(np.square(track.residual_mm))))
        angles = track.residual_rad[~np.isnan(track.residual_rad)]
        if angles.size:
            self.squares_rad.append(float(np.square(angles).mean()))

    @property
    def coordinates(self) -> FloatArray:
        """Mean coordinates, shape [frame_count, motion_count]."""
        if self.sums is None:
            raise ValueError(f"no trial shows {self.driver.body}")
        return self.sums[0].mean

    @property
    def is_usable(self) -> bool:
        """Whether two frames at least are known, so that there is a motion."""
        return self.sums is not None and bool((np.isfinite(self.coordinates).sum(axis=0) >= 2).all())

    def record(self) -> DriverRecord:
        """What is stored beside the coordinates."""
        scatter = self._scatter()
        lengths, angles = (
            scatter[[motion.kind == kind for motion in self.driver.motions]] for kind in ("translate", "rotate")
        )
        return DriverRecord(
            body=self.driver.body,
            trial_count=len(self.offsets_mm),
            residual_mm=float(np.sqrt(np.mean(self.squares_mm))),
            residual_deg=float(np.degrees(np.sqrt(np.mean(self.squares_rad)))) if self.squares_rad else None,
            start_offset_mm=float(np.mean(self.offsets_mm)),
            scatter_mm=_largest(1e3 * lengths),
            scatter_deg=_largest(np.degrees(angles)),
        )

    def _scatter(self) -> FloatArray:
        """Standard deviation over trials (n - 1), the largest over frames, shape [motion_count]."""
        if self.sums is None:
            raise ValueError(f"no trial shows {self.driver.body}")
        mean, square = self.sums
        spread = np.where(mean.counts > 1, square.mean - np.square(mean.mean), 0.0)
        factor = mean.counts / np.maximum(mean.counts - 1, 1)
        return np.sqrt(np.maximum(factor * spread, 0.0).max(axis=0))


def _largest(values: FloatArray) -> float | None:
    return float(values.max()) if values.size else None


def _event_metrics(experiment: Experiment) -> tuple[str, ...]:
    return tuple(metric for metric in experiment.score.metrics if metric in EVENT_METRICS)


def _spread_records(rows: tuple[BaselineRow, ...]) -> dict[str, SpreadRecord]:
    return {
        row.metric: SpreadRecord(unit=row.unit, mean=row.own.mean, std=row.own.std, trial_count=row.own.count)
        for row in rows
        if row.own is not None
    }


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise TrialError("(file)", f"it cannot be read: {error.strerror or error}", "a file is expected") from None
