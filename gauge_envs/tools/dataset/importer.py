"""Import a dataset folder, one variant after another."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.files import json_ready, os_errors
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.references.imported import (
    DriverRecord,
    ImportFacts,
    SpreadRecord,
    write_imported,
)
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.events import event_values
from gauge_envs.tools.dataset.findings import ImportFinding, TrialError
from gauge_envs.tools.dataset.forms import Stated
from gauge_envs.tools.dataset.layout import Layout
from gauge_envs.tools.dataset.lines import BaselineLine
from gauge_envs.tools.dataset.observation import (
    DriverTrack,
    driver_tracks,
    start_quaternions,
    trial_trajectory,
)
from gauge_envs.tools.dataset.statistics import (
    distances_to_mean,
    distances_to_others,
    mean_and_sigma,
    rms_over_frames,
)
from gauge_envs.tools.dataset.trial import Trial, parse_trial

FLAGGED_DIFFERENCE = 0.05
"""Relative difference between own and published baselines above which they are flagged."""

MIN_DOUBLED_CHANGES = 3
"""Least number of changes between pairs of equal frames at which a trial counts as doubled; a body may rest longer."""

MIN_TRIALS = 2
"""Number of trials that scatter needs."""


@dataclass(frozen=True, kw_only=True)
class ImportedTrials:
    """Outcome of the import of one variant.

    Attributes:
        variant: The variant.
        facts: Facts that were stored; None if too few trials could be used.
        used: Number of trials that the band rests on.
        left_out: Number of trial files that were left out.
        frame_count: Number of frames of the band.
        baselines: Own and published baselines.
        findings: Problems of the files.
    """

    variant: Variant
    facts: ImportFacts | None
    used: int
    left_out: int
    frame_count: int
    baselines: Sequence[BaselineLine]
    findings: tuple[ImportFinding, ...]

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
            "drivers": [one.model_dump() for one in facts.drivers] if facts else [],
        }


def baseline_lines(
    own: Mapping[str, SpreadRecord], published: Mapping[str, Baseline]
) -> list[BaselineLine]:
    """Return the baselines of imported trials beside those of the paper (Table 5), one for each metric."""
    lines: list[BaselineLine] = []
    for metric in dict.fromkeys([*own, *published]):
        mine, theirs = own.get(metric), published.get(metric)
        own_mean, own_std = _mean_and_std(mine)
        published_mean, published_std = _mean_and_std(theirs)
        difference = None
        if own_mean is not None and published_mean:
            difference = own_mean / published_mean - 1.0
        lines.append(
            {
                "metric": metric,
                "unit": published[metric].unit if mine is None else mine.unit,
                "own_mean": own_mean,
                "own_std": own_std,
                "own_trial_count": 0 if mine is None else mine.trial_count,
                "published_mean": published_mean,
                "published_std": published_std,
                "difference": difference,
                "flagged": abs(difference or 0.0) > FLAGGED_DIFFERENCE,
            }
        )
    return lines


def _mean_and_std(
    spread: SpreadRecord | Baseline | None,
) -> tuple[float | None, float | None]:
    return (None, None) if spread is None else (spread.mean, spread.std)


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
    seen: dict[str, str] = {}
    for variant, files in layout.files.items():
        importer = _VariantImporter(variant, layout, seen, stated)
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
        # Recorded motion is projected on the motions of the task file, not on those of an earlier import.
        self._experiment = load_experiment(variant)
        self._layout = layout
        self._seen = seen
        self._stated = stated
        self._trials: list[FloatArray] = []
        self._starts: list[FloatArray] = []
        self._tracks: list[DriverTrack] = []
        self._events: list[Mapping[str, float]] = []
        self._files: dict[str, str] = {}
        self._findings: list[ImportFinding] = []

    def read(self, path: Path) -> None:
        """Add one trial file, or a finding that says why it is left out."""
        file = self._layout.relative(path)
        try:
            content = self._content(path)
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
        self._trials.append(trajectory)
        self._starts += starts
        notes = [*self._add_events(trajectory), *self._add_drivers(trial)]
        if _is_doubled(trajectory):
            expected = f"{FRAME_RATE_HZ:g} different frames a second are expected"
            notes.insert(0, TrialError("(file)", "every frame occurs twice", expected))
        self._findings += [note.finding(file, left_out=False) for note in notes]

    def _content(self, path: Path) -> bytes:
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
            return path.read_bytes()

    def _add_events(self, trajectory: FloatArray) -> Iterator[TrialError]:
        """Add the events of a trial, or yield why it has none."""
        missing = np.isnan(trajectory).any(axis=1)
        if not missing.any():
            self._events.append(event_values(self._experiment, trajectory))
        elif any(METRICS[metric].is_event for metric in self._experiment.score.metrics):
            expected = "period and pauses need all samples; the band does not"
            yield TrialError(f"[{missing.argmax()}]", "a sample is missing", expected)

    def _add_drivers(self, trial: Trial) -> Iterator[TrialError]:
        """Add the motion of drivers, or yield why there is none; a trial without it still counts for the band."""
        try:
            self._tracks += driver_tracks(trial, self._experiment)
        except TrialError as error:
            yield error
        # Faults of assets that the experiment does not use are stated too, as of a board that never moves.
        driven = {driver.body for driver in self._experiment.scene.drivers}
        yield from (fault for name, fault in trial.faults.items() if name not in driven)

    def finish(self) -> ImportedTrials:
        """Store the variant."""
        experiment = self._experiment
        used, left_out = (
            len(self._trials),
            sum(finding.left_out for finding in self._findings),
        )
        own: dict[str, SpreadRecord] = {}
        facts = None
        if used:
            trials = np.stack(self._trials)
            mean, sigma = mean_and_sigma(trials)
            own = self._baselines(trials, mean)
            if np.isfinite(sigma).any():
                facts = self._store(trials, mean, sigma, own, left_out)
        if facts is None:
            error = TrialError(
                "(folder)",
                f"{used} of its trials can be used",
                f"{MIN_TRIALS} or more with common frames are needed",
            )
            self._findings.append(error.finding(experiment.name, left_out=True))
        return ImportedTrials(
            variant=experiment.variant,
            facts=facts,
            used=used,
            left_out=left_out,
            frame_count=experiment.frame_count,
            baselines=baseline_lines(own, published_baselines(experiment.name)),
            findings=tuple(self._findings),
        )

    def _baselines(
        self, trials: FloatArray, mean: FloatArray
    ) -> dict[str, SpreadRecord]:
        """Return the spread of each metric over trials."""
        rmse, dtw = distances_to_mean(trials, mean)
        values = {"rmse": rmse, "dtw": dtw}
        for metric in self._events[0] if self._events else ():
            values[metric] = np.array([events[metric] for events in self._events])
        unit = self._experiment.score.observable.unit
        spreads = {
            metric: SpreadRecord.of(found, METRICS[metric].unit_of(unit))
            for metric, found in values.items()
        }
        return {metric: one for metric, one in spreads.items() if one is not None}

    def _store(
        self,
        trials: FloatArray,
        mean: FloatArray,
        sigma: FloatArray,
        own: dict[str, SpreadRecord],
        left_out: int,
    ) -> ImportFacts:
        experiment = self._experiment
        drivers: dict[str, FloatArray] = {}
        records = []
        for driver in experiment.scene.drivers:
            tracks = [track for track in self._tracks if track.body == driver.body]
            found = _driver_mean(driver, tracks) if tracks else None
            if found is not None:
                drivers[driver.body], record = found
                records.append(record)
        hashes = "\n".join(self._files.values())
        facts = ImportFacts(
            variant=experiment.name,
            left_out=left_out,
            revision=self._layout.revision,
            files=tuple(self._files),
            files_sha256=hashlib.sha256(hashes.encode()).hexdigest(),
            task_sha256=experiment.file_sha256,
            metrics=own,
            drivers=tuple(records),
        )
        is_seen = np.isfinite(trials)
        trial_rmse, trial_rmse_aligned = distances_to_others(trials)
        band = Band(
            kind=Kind.TRIALS,
            unit=experiment.score.observable.unit,
            coordinates=experiment.coordinates,
            projection=np.eye(len(experiment.coordinates)),
            mean=mean,
            sigma=sigma,
            measured=(2 * is_seen.sum(axis=0) >= len(trials)).any(axis=1),
            source=facts.origin(len(trials)),
            trial_count=len(trials),
            trials=trials,
            trial_rmse=trial_rmse,
            trial_rmse_aligned=trial_rmse_aligned,
            stated_uncertainty=rms_over_frames(sigma) / np.sqrt(len(trials)),
        )
        starts = np.stack(self._starts) if self._starts else None
        write_imported(band, drivers, facts, starts)
        return facts


def _driver_mean(
    driver: Driver, tracks: Sequence[DriverTrack]
) -> tuple[FloatArray, DriverRecord] | None:
    """Return the mean coordinates of a driven body over trials and their quality; None without two known frames."""
    mean, sigma = mean_and_sigma(np.stack([track.coordinates for track in tracks]))
    if (np.isfinite(mean).sum(axis=0) < 2).any():
        return None
    scatter = np.nan_to_num(sigma).max(axis=0)
    is_length = np.array([motion.kind == "translate" for motion in driver.motions])
    return mean, DriverRecord(
        body=driver.body,
        trial_count=len(tracks),
        residual_mm=_rms([track.residual_mm for track in tracks]) or 0.0,
        residual_deg=_rms([np.degrees(track.residual_rad) for track in tracks]),
        start_offset_mm=float(np.mean([track.start_offset_mm for track in tracks])),
        scatter_mm=_largest(1e3 * scatter[is_length]),
        scatter_deg=_largest(np.degrees(scatter[~is_length])),
    )


def _rms(values: Sequence[FloatArray]) -> float | None:
    """Return the root mean square of known values; None without any."""
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    return float(np.sqrt(np.square(known).mean())) if known.size else None


def _largest(values: FloatArray) -> float | None:
    return float(values.max()) if values.size else None


def _is_doubled(trajectory: FloatArray) -> bool:
    """Return whether every frame of a moving trajectory occurs twice in a row, from the first or the second frame."""
    for first in (0, 1):
        count = (len(trajectory) - first) // 2
        pairs = trajectory[first : first + 2 * count].reshape(count, 2, -1)
        changes = np.nan_to_num(np.diff(pairs[:, 0], axis=0)).any(axis=1).sum()
        is_equal = np.array_equal(pairs[:, 0], pairs[:, 1], equal_nan=True)
        if is_equal and changes >= MIN_DOUBLED_CHANGES:
            return True
    return False
