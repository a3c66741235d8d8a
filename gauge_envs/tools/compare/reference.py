"""References of the results of one experiment: real trials, a solution, another engine, or the initial state."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.results import ALIGNED
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.rendering.reference_path import reference_words
from gauge_envs.runs.result import RecordedTrajectory, Result, recorded_frames
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, frame_times_s
from gauge_envs.scoring.interval import COVERAGE_FACTOR
from gauge_envs.scoring.metrics import interpolated
from gauge_envs.scoring.reference import reference_band


@dataclass(frozen=True, eq=False, kw_only=True)
class Reference:
    """Reference of the results of one experiment.

    Attributes:
        name: Name, for example `the mean of 20 real trials`.
        band: Mean and spread in the compared coordinates. The kind is `none` for another engine or the initial state.
        scored: Band of the score; `band` is this band or its `points`. None if nothing is scored.
        is_start: Whether each result is compared with its initial state.
    """

    name: str
    band: Band
    scored: Band | None = None
    is_start: bool = False

    @property
    def spread(self) -> FloatArray:
        """Scatter of real trials, or u of the solution, shape [frame_count, C]; 0 without a scored reference."""
        if self.band.kind.is_solution and self.band.uncertainty is not None:
            return self.band.uncertainty
        return self.band.sigma

    @property
    def spread_factor(self) -> float:
        """Half width of the wide shaded area divided by `spread`: two standard deviations, or the 95 % factor of u."""
        if self.band.kind.is_solution:
            return COVERAGE_FACTOR
        return 2.0

    @property
    def end_s(self) -> float:
        """Last time at which the reference is known [s]."""
        last = np.flatnonzero(self.band.known)[-1:]
        return max(last.sum() / FRAME_RATE_HZ, 1e-3)

    @property
    def times_s(self) -> FloatArray:
        """Times of the frames [s], shape [frame_count]."""
        return frame_times_s(len(self.band.mean))

    def lengths(self, values: FloatArray) -> FloatArray:
        """Return the Euclidean length of values at each frame, shape [frame_count]; NaN at unknown frames.

        For markers, it is the root mean square over the markers.
        """
        if self.scored is None:
            scale = self.band.marker_count**-0.5
            return np.asarray(scale * np.linalg.norm(values, axis=1))
        squares = np.where(np.isfinite(self.band.mean), np.square(values), 0.0)
        lengths = np.sqrt(squares.sum(axis=1) / self.band.marker_count)
        return np.where(self.band.known, lengths, np.nan)

    def motion(self, result: Result) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and the compared coordinates, shape [sample_count, C].

        A result with an aligned primary score is shifted by its time offset. Both arrays are empty if the result lacks
        the compared markers or coordinates.
        """
        recorded = recorded_of(result)
        width = len(self.band.coordinates)
        nothing = np.zeros(0), np.zeros((0, width))
        if self.scored is None:
            recorded = recorded.compared
            if recorded.coordinates != list(self.band.coordinates):
                return nothing
            return recorded.arrays()
        if self.scored.points is not None:
            markers_mm = recorded.markers_mm
            if markers_mm.shape[1] != width:
                return nothing
            return frame_times_s(len(markers_mm)), markers_mm
        offset_s = result.score.time_offset_s
        if offset_s is None or not is_aligned(result):
            times_s, samples = recorded.arrays()
            return times_s, self.band.project(samples)
        times_s, samples = recorded.arrays()
        shown_s = times_s[times_s - offset_s <= times_s[-1]]
        projected = self.band.project(samples)
        return shown_s, interpolated(shown_s - offset_s, times_s, projected)

    def deviation(self, result: Result) -> FloatArray:
        """Return a result minus the reference, shape [frame_count, C]; NaN where either is unknown."""
        mean = self.band.mean
        values = np.full(mean.shape, np.nan)
        numbers, rows = recorded_frames(*self.motion(result))
        is_inside = numbers < len(values)
        values[numbers[is_inside]] = rows[is_inside]
        if self.is_start:
            return values - values[:1]
        return values - mean


def choose_reference(
    results: Sequence[Result], band: Band | None, *, labels: Sequence[str] = ()
) -> Reference:
    """Return the reference of results of one experiment.

    Args:
        results: First result of each configuration, one or more.
        band: Reference band of the experiment, if any.
        labels: Label of each configuration.
    """
    if band is not None:
        name = reference_words(band.kind, band.trial_count)
        return Reference(name=name, band=band.compared, scored=band)
    first = recorded_of(results[0]).compared
    numbers, rows = first.frames
    mean = np.full((max(numbers, default=0) + 1, len(first.coordinates)), np.nan)
    mean[numbers] = rows
    plain = Band(
        kind=Kind.NONE,
        unit=first.unit,
        coordinates=tuple(first.coordinates),
        projection=np.eye(mean.shape[1]),
        mean=mean,
        sigma=np.zeros_like(mean),
        measured=np.asarray(np.isfinite(mean).all(axis=1)),
        source="",
    )
    if len(results) > 1:
        return Reference(name=labels[0], band=plain)
    return Reference(name="the initial state", band=plain, is_start=True)


def judging_band(experiment: Experiment, results: Iterable[Result]) -> Band | None:
    """Return the reference band of an experiment; None without one, or if it scores none of the results."""
    if all(result.score.refused is not None for result in results):
        return None
    return reference_band(experiment)


def is_aligned(result: Result) -> bool:
    """Return whether the primary score of a result is the score after release alignment."""
    return result.score.primary == ALIGNED.key


def recorded_of(result: Result) -> RecordedTrajectory:
    """Return the trajectory of a result.

    Raises:
        ShapeError: The result has no trajectory.
    """
    if result.trajectory is None:
        raise ShapeError(f"{result.id} has no trajectory: {result.error}")
    return result.trajectory


def coordinate_words(name: str) -> str:
    """Return a coordinate name in words: `marker 3, z` for `marker-3.z`."""
    plain = name.replace("face_area", "face").replace("line_curvature", "bend")
    return plain.replace("_", " ").replace("-", " ").replace(".", ", ")
