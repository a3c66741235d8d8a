"""Import a dataset folder, one variant after another, with one trial in memory at a time."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready, os_errors
from gauge_envs.observables.deformation import (
    STATISTICS,
    marked_solid,
    trial_statistics,
)
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.references.deformation import DeformationReference
from gauge_envs.references.imported import (
    DriverRecord,
    ImportFacts,
    SpreadRecord,
    VariantRecord,
    remove_leftovers,
    write_imported,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import EVENT_METRICS, METRICS
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.score import score_trajectory
from gauge_envs.tools.dataset.findings import ImportFinding, TrialError
from gauge_envs.tools.dataset.forms import Stated
from gauge_envs.tools.dataset.layout import Layout
from gauge_envs.tools.dataset.observation import (
    CoordinateMean,
    DriverTrack,
    TrialSpool,
    TrialStatistics,
    driver_tracks,
    start_quaternions,
    trial_markers_m,
    trial_trajectory,
)
from gauge_envs.tools.dataset.trial import Trial, parse_trial

FLAGGED_DIFFERENCE = 0.05
"""Relative difference between own and published baselines above which they are flagged."""

DOUBLED_CHANGES = 3
"""Least number of changes between pairs of equal frames at which a trial counts as doubled; a body may rest longer."""

LEAST_TRIALS = 2
"""Number of trials that scatter needs."""

MOST_TRIAL_NUMBERS = 4_000_000
"""Largest count of numbers of single trials that an import keeps, 32 MB: 20 trials of 1,000 frames of 200 areas."""


@dataclass(frozen=True, kw_only=True)
class BaselineRow:
    """Baseline of one metric, from the imported trials and from the paper (Table 5).

    Attributes:
        metric: `rmse`, `dtw`, `lsd`, `mte`, `pd` or `el`.
        unit: Unit of the metric.
        imported: Baseline of the imported trials; None if they do not determine it.
        published: Baseline of the paper; None if it prints none.
    """

    metric: str
    unit: str
    imported: SpreadRecord | None
    published: Baseline | None

    @property
    def difference(self) -> float | None:
        """Own over published mean, minus 1; None if one is missing or the published one is 0."""
        if self.imported is None or self.published is None or not self.published.mean:
            return None
        return self.imported.mean / self.published.mean - 1.0

    @property
    def is_flagged(self) -> bool:
        """Whether own and published mean differ by more than 5 %."""
        return self.difference is not None and abs(self.difference) > FLAGGED_DIFFERENCE

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary."""
        return json_ready(
            {
                "metric": self.metric,
                "unit": self.unit,
                "own_mean": self.imported and self.imported.mean,
                "own_std": self.imported and self.imported.std,
                "own_trial_count": self.imported.trial_count if self.imported else 0,
                "published_mean": self.published and self.published.mean,
                "published_std": self.published and self.published.std,
                "difference": self.difference,
                "flagged": self.is_flagged,
            }
        )


@dataclass(frozen=True, kw_only=True)
class ImportedTrials:
    """Outcome of the import of one variant.

    Attributes:
        variant: The variant.
        record: Record that was stored; None if too few trials could be used.
        used: Number of trials that the band rests on.
        left_out: Number of trial files that were left out.
        rows: Own and published baselines.
        findings: Problems of the files.
    """

    variant: Variant
    record: VariantRecord | None
    used: int
    left_out: int
    rows: tuple[BaselineRow, ...]
    findings: tuple[ImportFinding, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary."""
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
            "drivers": [driver.model_dump() for driver in record.drivers]
            if record
            else [],
        }


def import_trials(
    layout: Layout,
    *,
    stated: Stated | None = None,
    advance: Callable[[Path], None] | None = None,
) -> Iterator[ImportedTrials]:
    """Import the trials of a dataset into the user's data folder; each variant is stored before it is yielded.

    Args:
        layout: Result of `find_trials`.
        stated: Unit and rate of files that do not state them.
        advance: Function that is called with each file after it was read.

    Returns:
        Iterator that imports one variant per step. Damaged trials are left out and listed in the findings.
    """
    remove_leftovers()
    seen: dict[str, str] = {}
    for variant, files in layout.files.items():
        importer = _VariantImporter(variant, layout, seen, stated)
        with closing(importer.spool):
            for path in files:
                importer.read(path)
                if advance is not None:
                    advance(path)
            yield importer.finish()


class _VariantImporter:
    """Importer of the trials of one variant.

    Args:
        variant: The variant.
        layout: Files of the dataset.
        seen: Path of each file that was read before, by the hash of its content; `read` adds to it.
        stated: Unit and rate of files that do not state them.
    """

    def __init__(
        self,
        variant: Variant,
        layout: Layout,
        seen: dict[str, str],
        stated: Stated | None,
    ) -> None:
        self._stated = stated
        # Recorded motion is projected on the motions of the task file, not on those of an earlier import.
        self._experiment = load_experiment(variant)
        self._layout = layout
        self._seen = seen
        self._coordinates = self._experiment.coordinates
        self.spool = TrialSpool((self._experiment.frame_count, len(self._coordinates)))
        frame_count, drivers = (
            self._experiment.frame_count,
            self._experiment.scene.drivers,
        )
        self._drivers = {
            driver.body: _DriverMean(driver, frame_count) for driver in drivers
        }
        metrics = self._experiment.score.metrics
        self._events: dict[str, list[float]] = {
            metric: [] for metric in metrics if metric in EVENT_METRICS
        }
        self._solid = marked_solid(self._experiment.scene)
        self._statistics: list[FloatArray] = []
        self._starts: list[FloatArray] = []
        self._files: dict[str, str] = {}
        self._findings: list[ImportFinding] = []

    def read(self, path: Path) -> None:
        """Add one trial file, or a finding that says why it is left out."""
        file = self._layout.relative(path)
        try:
            if not self._layout.holds(path):
                raise TrialError(
                    "(file)",
                    "it links to a file outside of the dataset",
                    "a copy of it is expected",
                )
            with os_errors(
                lambda cause: TrialError(
                    "(file)", f"it cannot be read: {cause}", "a file is expected"
                )
            ):
                content = path.read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            if digest in self._seen:
                raise TrialError(
                    "(file)",
                    f"it is a copy of {self._seen[digest]}",
                    "each trial counts once",
                )
            trial = parse_trial(content, path.suffix.lower(), self._stated)
            trajectory = trial_trajectory(trial, self._experiment)
            is_rigid = self._experiment.score.observable is Observable.POSITION
            starts = [start_quaternions(trial, self._experiment)] if is_rigid else []
        except TrialError as error:
            self._findings.append(error.finding(file, left_out=True))
            return
        self._seen[digest] = file
        self._files[file] = digest
        self.spool.add(trajectory)
        self._starts += starts
        if _is_doubled(trajectory):
            twice = "every frame occurs twice"
            note = TrialError(
                "(file)",
                twice,
                f"{FRAME_RATE_HZ:g} different frames a second are expected",
            )
            self._findings.append(note.finding(file, left_out=False))
        self._add_statistics(trial)
        self._add_events(file, trajectory)
        self._add_drivers(file, trial)

    def finish(self) -> ImportedTrials:
        """Store the variant."""
        used, left_out = (
            len(self.spool),
            sum(finding.left_out for finding in self._findings),
        )
        statistics = self.spool.statistics() if used else None
        rows = self._rows(statistics)
        record = None
        if statistics is not None and used >= LEAST_TRIALS:
            record = self._store(statistics, rows, left_out)
        else:
            error = TrialError(
                "(folder)",
                f"{used} of its trials can be used",
                f"{LEAST_TRIALS} or more are needed",
            )
            self._findings.append(error.finding(self._experiment.name, left_out=True))
        return ImportedTrials(
            variant=self._experiment.variant,
            record=record,
            used=used,
            left_out=left_out,
            rows=rows,
            findings=tuple(self._findings),
        )

    def _add_statistics(self, trial: Trial) -> None:
        """Add the statistics of deformation at the frames of the experiment; rest is the first frame of the trial."""
        if self._solid is None:
            return
        markers_m = trial_markers_m(trial, self._experiment)[
            : self._experiment.frame_count
        ]
        found = trial_statistics(markers_m, self._solid)
        padding = ((0, self._experiment.frame_count - len(found)), (0, 0))
        self._statistics.append(np.pad(found, padding, constant_values=np.nan))

    def _deformation(self) -> DeformationReference | None:
        """Return mean and scatter of the statistics that some frame of at least two trials has."""
        if not self._statistics:
            return None
        mean = CoordinateMean(self._statistics[0].shape)
        for trial in self._statistics:
            mean.add(trial)
        sigma = mean.scatter(self._statistics)
        known = np.flatnonzero(np.isfinite(sigma).any(axis=0))
        if not known.size:
            return None
        return DeformationReference(
            statistics=tuple(STATISTICS[column] for column in known),
            markers=None,
            mean=mean.mean[:, known],
            sigma=sigma[:, known],
            trial_count=len(self._statistics),
            source="import",
        )

    def _add_events(self, file: str, trajectory: FloatArray) -> None:
        if not self._events:
            return
        if np.isnan(trajectory).any():
            frame = int(np.isnan(trajectory).any(axis=1).argmax())
            error = TrialError(
                f"[{frame}]",
                "a sample is missing",
                "period and pauses need all samples; the band does not",
            )
            self._findings.append(error.finding(file, left_out=False))
            return
        times_s = np.arange(len(trajectory)) / FRAME_RATE_HZ
        score = score_trajectory(
            self._experiment, None, times_s=times_s, values=trajectory, is_checked=True
        )
        for metric, values in self._events.items():
            value = getattr(score, METRICS[metric].score_field)
            values.append(np.nan if value is None else value)

    def _add_drivers(self, file: str, trial: Trial) -> None:
        """Add the driver's motion; a trial without it still counts for the band."""
        # Faults of assets that the experiment does not use are stated too, as of a board that never moves.
        unused = [
            error for name, error in trial.faults.items() if name not in self._drivers
        ]
        try:
            for track in driver_tracks(trial, self._experiment):
                self._drivers[track.body].add_track(track)
        except TrialError as error:
            unused.insert(0, error)
        self._findings += [error.finding(file, left_out=False) for error in unused]

    def _rows(self, statistics: TrialStatistics | None) -> tuple[BaselineRow, ...]:
        published = published_baselines(self._experiment.name)
        values = {metric: np.array(found) for metric, found in self._events.items()}
        if statistics is not None:
            values = {"rmse": statistics.rmse, "dtw": statistics.dtw, **values}
        unit = self._experiment.score.observable.unit
        units = {
            metric: METRICS[metric].unit_of(unit) for metric in (*values, *published)
        }
        return tuple(
            BaselineRow(
                metric=metric,
                unit=units[metric],
                imported=SpreadRecord.of(values[metric], units[metric])
                if metric in values
                else None,
                published=published.get(metric),
            )
            for metric in units
        )

    def _store(
        self, statistics: TrialStatistics, rows: tuple[BaselineRow, ...], left_out: int
    ) -> VariantRecord:
        experiment = self._experiment
        # Intervals of scores resample the trials, if they are not too many numbers to keep.
        is_small = (
            len(self.spool) * experiment.frame_count * len(self._coordinates)
            <= MOST_TRIAL_NUMBERS
        )
        band = Band(
            grade=Kind.TRIALS,
            unit=experiment.score.observable.unit,
            coordinates=self._coordinates,
            projection=np.eye(len(self._coordinates)),
            mean=statistics.mean,
            sigma=statistics.sigma,
            measured=statistics.measured,
            trial_count=len(self.spool),
            source="import",
            trials=np.stack(list(self.spool)) if is_small else None,
        )
        drivers = {
            body: driven for body, driven in self._drivers.items() if driven.is_usable
        }
        deformation = self._deformation()
        facts = ImportFacts(
            variant=experiment.name,
            left_out=left_out,
            revision=self._layout.revision,
            files=tuple(self._files),
            files_sha256=hashlib.sha256(
                "\n".join(self._files.values()).encode()
            ).hexdigest(),
            task_sha256=experiment.file_sha256,
            metrics={
                row.metric: row.imported for row in rows if row.imported is not None
            },
            drivers=tuple(driven.record() for driven in drivers.values()),
            statistics=() if deformation is None else deformation.statistics,
        )
        coordinates = {body: driven.mean for body, driven in drivers.items()}
        starts = np.stack(self._starts) if self._starts else None
        return write_imported(band, coordinates, facts, deformation, starts)


class _DriverMean(CoordinateMean):
    """Mean over trials of one driven body's coordinates, and the motion that they do not cover.

    Args:
        driver: Bundled driver of the body.
        frame_count: Frames of the experiment.
    """

    def __init__(self, driver: Driver, frame_count: int) -> None:
        super().__init__((frame_count, len(driver.motions)))
        self._driver = driver
        self._squares = CoordinateMean((frame_count, len(driver.motions)))
        self._offsets_mm: list[float] = []
        self._squares_mm: list[float] = []
        self._squares_rad: list[float] = []

    def add_track(self, track: DriverTrack) -> None:
        """Add one trial."""
        self.add(track.coordinates)
        self._squares.add(np.square(track.coordinates))
        self._offsets_mm.append(track.start_offset_mm)
        self._squares_mm.append(float(np.nanmean(np.square(track.residual_mm))))
        angles = track.residual_rad[~np.isnan(track.residual_rad)]
        if angles.size:
            self._squares_rad.append(float(np.square(angles).mean()))

    @property
    def is_usable(self) -> bool:
        """Whether each motion has at least two known frames."""
        return bool(((self.counts > 0).sum(axis=0) >= 2).all())

    def record(self) -> DriverRecord:
        """Return the record that is stored beside the coordinates."""
        spread = np.where(
            self.counts > 1, self._squares.mean - np.square(self.mean), 0.0
        )
        factor = self.counts / np.maximum(self.counts - 1, 1)
        # The largest standard deviation (n - 1) over frames, shape [motion_count].
        scatter = np.sqrt(np.maximum(factor * spread, 0.0).max(axis=0))
        lengths, angles = (
            scatter[[motion.kind == kind for motion in self._driver.motions]]
            for kind in ("translate", "rotate")
        )
        return DriverRecord(
            body=self._driver.body,
            trial_count=len(self._offsets_mm),
            residual_mm=float(np.sqrt(np.mean(self._squares_mm))),
            residual_deg=float(np.degrees(np.sqrt(np.mean(self._squares_rad))))
            if self._squares_rad
            else None,
            start_offset_mm=float(np.mean(self._offsets_mm)),
            scatter_mm=_largest(1e3 * lengths),
            scatter_deg=_largest(np.degrees(angles)),
        )


def _largest(values: FloatArray) -> float | None:
    return float(values.max()) if values.size else None


def _is_doubled(trajectory: FloatArray) -> bool:
    """Return whether every frame of a moving trajectory occurs twice in a row, from the first or the second frame."""
    for first in (0, 1):
        pairs = trajectory[first : first + (len(trajectory) - first) // 2 * 2].reshape(
            -1, 2, trajectory.shape[1]
        )
        changes = (
            (pairs[1:, 0] != pairs[:-1, 0])
            & ~np.isnan(pairs[1:, 0])
            & ~np.isnan(pairs[:-1, 0])
        )
        if changes.any(axis=1).sum() >= DOUBLED_CHANGES and np.array_equal(
            pairs[:, 0], pairs[:, 1], equal_nan=True
        ):
            return True
    return False
