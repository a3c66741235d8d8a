"""What the results of one experiment are drawn against: real trials, a solution, another engine, or their start."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.results import ALIGNED
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.runs.result import RecordedTrajectory, Result, recorded_frames
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics import interpolated
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import COVERAGE_FACTOR


@dataclass(frozen=True, eq=False, kw_only=True)
class Yardstick:
    """What results are drawn against.

    Attributes:
        name: Its name in words, as `the mean of 20 real trials`.
        band: Mean and spread in the coordinates that are compared. Its kind is `none` for another engine or the start.
        reference: Reference of the score; None without one. Its `points`, if any, are `band`.
        of_start: Whether it is the start of each result itself.
    """

    name: str
    band: Band
    reference: Band | None
    of_start: bool = False

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the markers or bodies whose x, y and z are compared, in order; empty for other coordinates."""
        return point_names(self.band.coordinates)

    @property
    def unit(self) -> str:
        """Unit of the compared coordinates."""
        return self.band.unit

    @property
    def spread(self) -> FloatArray:
        """Scatter of real trials or u of the solution, shape [frame_count, C]; 0 without one."""
        stated = self.band.uncertainty if self.band.kind.is_solution else None
        return self.band.sigma if stated is None else stated

    @property
    def reach(self) -> float:
        """What a shaded area ends at, in units of `spread`: two standard deviations, or the end of 95 % of u."""
        return COVERAGE_FACTOR if self.band.kind.is_solution else 2.0

    def trial_distance(self, *, aligned: bool) -> float | None:
        """Return the mean distance of the real trials, each from the mean of the others; None without trials.

        Args:
            aligned: Whether each is aligned to the release of the others.
        """
        if self.reference is None:
            return None
        every = (
            self.reference.trial_rmse_aligned if aligned else self.reference.trial_rmse
        )
        return None if every is None else float(every.mean())

    @property
    def spread_words(self) -> tuple[str, str]:
        """Names of the spread, and of what the wider shaded area ends at."""
        if self.band.kind.is_solution:
            return "u: uncertainty of the solution", f"up to {self.reach} u is inside"
        return "scatter of real trials (1 standard deviation)", "twice that"

    @property
    def end_s(self) -> float:
        """Last time at which it is known [s]."""
        known = np.flatnonzero(self.band.known)
        last = int(known[-1]) if len(known) else 0
        return max(last / FRAME_RATE_HZ, 1e-3)

    @property
    def times_s(self) -> FloatArray:
        """Times of the frames [s]."""
        return np.arange(len(self.band.mean)) / FRAME_RATE_HZ

    def lengths(self, values: FloatArray) -> FloatArray:
        """Return the length of values at each frame, shape [frame_count].

        It is over known coordinates, NaN without any, and the root mean square over markers.
        """
        if self.reference is None:
            count = len(self.points) if self.of_start and self.points else 1
            return np.asarray(np.linalg.norm(values, axis=1)) / np.sqrt(count)
        squares = np.where(np.isfinite(self.band.mean), np.square(values), 0.0)
        lengths = np.sqrt(squares.sum(axis=1) / self.band.marker_count)
        return np.where(self.band.known, lengths, np.nan)

    def motion(
        self, result: Result, *, aligned: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and the compared coordinates, shape [sample_count, C].

        Args:
            result: A result of the experiment.
            aligned: Whether to shift it by its time offset, if it has one.

        Returns:
            Markers at the frames, where these are compared, else all samples of g(t). Both are empty where markers are
            compared and not recorded.
        """
        recorded = recorded_of(result)
        if self.reference is not None and self.band is not self.reference:
            markers = recorded.markers_m()
            width = len(self.band.coordinates)
            if markers is None or 3 * markers.shape[1] != width:
                return np.zeros(0), np.zeros((0, width))
            return np.arange(len(markers)) / FRAME_RATE_HZ, 1e3 * markers.reshape(
                len(markers), -1
            )
        if self.reference is None and recorded.coordinates != [*self.band.coordinates]:
            return np.zeros(0), np.zeros((0, len(self.band.coordinates)))
        offset_s = result.score.time_offset_s if aligned else None
        times_s, samples = recorded.arrays(later=offset_s is not None)
        values = samples if self.reference is None else self.band.project(samples)
        if offset_s is None:
            return times_s, values
        shown_s = np.array(recorded.times_s)
        return shown_s, interpolated(shown_s - offset_s, times_s, values)

    def deviation(self, result: Result, *, aligned: bool) -> FloatArray:
        """Return a result minus the yardstick at each frame, shape [frame_count, C]; NaN where one is not known.

        Args:
            result: A result of the experiment.
            aligned: Whether to shift it by its time offset, if it has one.
        """
        times_s, values = self.motion(result, aligned=aligned)
        mean = self.band.mean
        whole = np.full(mean.shape, np.nan)
        # A trajectory of a file may have the frames alone.
        numbers, rows = recorded_frames(times_s, values)
        inside = numbers < len(whole)
        whole[numbers[inside]] = rows[inside]
        return whole - (whole[:1] if self.of_start else mean)

    def shares(self, deviations: Sequence[FloatArray]) -> FloatArray:
        """Return the share of each coordinate in the squared distance, mean over results, shape [C]; 0 without any."""
        squares = [np.nansum(np.square(one), axis=0) for one in deviations]
        known = [one / one.sum() for one in squares if 0.0 < one.sum() < np.inf]
        return np.mean(known or [np.zeros(len(self.band.coordinates))], axis=0)


def choose_yardstick(
    results: Sequence[Result], band: Band | None, *, names: Sequence[str]
) -> Yardstick:
    """Return what results of one experiment are drawn against.

    Args:
        results: First result of each configuration, one or more.
        band: Reference of the experiment, if it has one.
        names: Label of each configuration.
    """
    if band is not None:
        return Yardstick(
            name=_band_words(band), band=band.points or band, reference=band
        )
    first = recorded_of(results[0])
    numbers, rows = first.frames
    mean = np.full(
        (int(numbers[-1]) + 1 if len(numbers) else 1, len(first.coordinates)), np.nan
    )
    mean[numbers] = rows
    plain = Band(
        kind=Kind.NONE,
        unit=first.unit,
        coordinates=tuple(first.coordinates),
        projection=np.eye(mean.shape[1]),
        mean=mean,
        sigma=np.zeros_like(mean),
        measured=np.isfinite(mean).all(axis=1),
        source="",
    )
    # Without a reference, how far the engines are apart is all there is to see.
    if len(results) > 1:
        return Yardstick(name=names[0], band=plain, reference=None)
    return Yardstick(name="the start", band=plain, reference=None, of_start=True)


def judging_band(experiment: Experiment, results: Iterable[Result]) -> Band | None:
    """Return the reference of an experiment; None without one, or if it refuses to score each of the results."""
    refused = all(one.score.refused is not None for one in results)
    return None if refused else reference_band(experiment)


def is_aligned(result: Result) -> bool:
    """Return whether the score that reports show first is that of the result after release alignment."""
    return result.score.primary == ALIGNED.key


def recorded_of(result: Result) -> RecordedTrajectory:
    """Return the trajectory of a result that ran."""
    if result.trajectory is None:
        raise ShapeError(
            f"{result.id} did not run, there is nothing to draw: {result.error}"
        )
    return result.trajectory


def points_words(points: Sequence[str]) -> str:
    """Return how many points there are, as `63 markers`."""
    stems = {name.rpartition("-")[0] for name in points}
    return f"{len(points)} {f'{stems.pop()}s' if len(stems) == 1 else 'bodies'}"


def point_names(coordinates: Sequence[str]) -> tuple[str, ...]:
    """Return the points whose x, y and z the coordinates are, as `marker-0`; empty for others, and for one point."""
    stems = [name.rpartition(".")[0] for name in coordinates[::3]]
    expected = [f"{stem}.{axis}" for stem in stems for axis in "xyz"]
    is_of_points = all(stems) and list(coordinates) == expected
    return tuple(stems) if is_of_points and len(stems) > 1 else ()


def coordinate_words(name: str) -> str:
    """Return the name of a coordinate as people write it: `marker 3, z` for `marker-3.z`."""
    stem, dot, axis = name.rpartition(".")
    plain = (
        (stem or name).replace("face_area", "face").replace("line_curvature", "bend")
    )
    text = plain.replace("_", " ").replace("-", " ")
    return f"{text}, {axis}" if dot else text


def _band_words(band: Band) -> str:
    if band.kind is Kind.ANALYTIC:
        return "the closed form"
    if band.kind is Kind.NUMERICAL:
        return "the numerical solution"
    if band.kind is Kind.RECORDING:
        return "the one recorded real trial"
    if band.trial_count is None:
        return "the mean of real trials"
    if band.trial_count == 1:
        return "the real trial"
    return f"the mean of {band.trial_count} real trials"
