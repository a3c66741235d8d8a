"""Score the motion in a video by the law of its task, and propagate the uncertainty of the track."""

import math
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.files import json_ready
from gauge_envs.scene.geometry import IntArray
from gauge_envs.tools.video import laws
from gauge_envs.tools.video.frames import FileFrames
from gauge_envs.tools.video.soundness import faults_of
from gauge_envs.tools.video.tasks import MotionKind, VideoTask, task_scene, video_task
from gauge_envs.tools.video.track import TRACK_SUFFIXES, Track, read_track
from gauge_envs.tools.video.tracker import track_object

Metrics: TypeAlias = dict[str, float]

METRICS = ("a", "qfi", "r2", "pd", "mte", "de", "acceleration_m_s2", "form")
"""Names of all metrics, in the order of a result.

GAUGE's paper defines the first six: acceleration [m/s^2] and QFI from the first retained frame; R^2 and period [s] of a
damped oscillation; momentum transfer; dynamic error [N]. This package adds two metrics of straight motions:
acceleration with a fitted release, and the residual of the law relative to the displacement.
"""

RELEASE_FRAMES = 6.0
"""Search interval for the release, in frames before and after the first retained frame."""

MIN_DISPLACEMENT = 1.0
"""Smallest displacement of a cube on a turntable for a meaningful dynamic error, in its sizes."""

SAMPLES = 200
"""Number of simulated tracks for intervals."""

SCALE_SIGMA = 0.0065
"""Relative standard uncertainty of the scale: 0.5 px of the measured length, and 0.5 % by depth and lens."""

SLOW_NOISE_PX = 0.25
"""Error of a place that persists for `SLOW_FRAMES` [px]: the post of the pendulum half hides the ball."""

SLOW_FRAMES = 6

PIVOT_SIGMA_PX = 1.0
"""Standard uncertainty of each coordinate of a pivot [px], which was read by eye."""


@dataclass(frozen=True, kw_only=True)
class VideoScore:
    """Result of one video: whether its track is accepted, and the physics of the motion.

    Attributes:
        video: Name of the video or track.
        task: Id of the task.
        is_sound: Whether the track always follows the object, independent of the law of the motion.
        reasons: Why the track is rejected, with frame numbers.
        findings: More observations.
        metrics: Values by name; None without motion or if a metric does not apply.
        uncertainty: Interval of each metric that contains 95 % of simulated tracks.
        interval_frames: First and last retained frame; None without motion.
        scale_m_per_px: Size of a pixel of the reference grid [m].
        details: Extra numbers, such as the damping of a swing.
        track: The track.
    """

    video: str
    task: str
    is_sound: bool
    reasons: tuple[str, ...]
    findings: tuple[str, ...]
    metrics: dict[str, float | None]
    uncertainty: dict[str, tuple[float, float] | None]
    interval_frames: tuple[int, int] | None
    scale_m_per_px: float
    details: dict[str, float]
    track: Track

    def to_dict(self) -> dict[str, Any]:
        """Return the result with the registration instead of the track, JSON-ready."""
        values = vars(self) | {"registration": asdict(self.track.registration)}
        del values["track"]
        ready: dict[str, Any] = json_ready(values)
        return ready


def score(path: Path | str, fps: float | None = None, task: str = "") -> VideoScore:
    """Track the object of a task through a video, or read its track, and score its motion.

    Args:
        path: The video, or the file of a track.
        fps: Frames per second; the rate of the file if None.
        task: Id of a task, such as `SlopeSlider-2-wood`; see `gauge_envs.tools.video.video_tasks`.

    Raises:
        UnknownNameError: The task does not exist.
        VideoError: The file cannot be read or is out of range.
        MissingExtraError: OpenCV is not installed.
    """
    chosen, path = video_task(task), Path(path)
    if path.suffix.lower() in TRACK_SUFFIXES:
        track = read_track(path, fps=fps)
    else:
        track = track_object(FileFrames(path, fps=fps), chosen)
    return score_track(track, chosen, name=str(path))


def score_track(track: Track, task: VideoTask, *, name: str = "track") -> VideoScore:
    """Score the motion of a track.

    Args:
        track: The track, on the reference grid.
        task: The task.
        name: Name of the result.
    """
    span = laws.retained(track, task)
    faults = faults_of(track, task, span)
    findings = [*track.notes]
    values: Metrics = {}
    intervals: dict[str, tuple[float, float]] = {}
    if span is None:
        findings.append("no motion is detected")
    else:
        try:
            values = measure(track, task, span)
            intervals = _intervals(track, task, span, values)
            displacement = values.get("displacement_in_sizes", 1.0)
            if displacement < MIN_DISPLACEMENT:
                findings.append(
                    f"the object moves by only {displacement:.2f} of its size: a dynamic error of 0 is not significant"
                )
        except ParameterError as error:
            findings.append(str(error))
    return VideoScore(
        video=name,
        task=task.id,
        is_sound=not faults,
        reasons=tuple(faults),
        findings=tuple(findings),
        metrics={metric: values.get(metric) for metric in METRICS},
        uncertainty={metric: intervals.get(metric) for metric in METRICS},
        interval_frames=span and tuple(track.frames[list(span)].tolist()),
        scale_m_per_px=task.scale_m_per_px,
        details={key: values[key] for key in values if key not in METRICS},
        track=track,
    )


# --- metrics ---------------------------------------------------------------------------------------------------------


def measure(track: Track, task: VideoTask, span: tuple[int, int]) -> Metrics:
    """Return the metrics of a task, and extra numbers, between two rows.

    Args:
        track: The track; metrics of the paper use places in whole pixels.
        task: The task.
        span: First and last retained row.

    Raises:
        ParameterError: The track has too few frames, or a cradle has no apex.
    """
    rows = _visible_rows(track, *span)
    min_count = 8 if task.motion is MotionKind.PENDULUM else 4
    if len(rows) < min_count:
        raise ParameterError(f"the fit needs {min_count} frames, got {len(rows)}")
    if task.direction is not None:
        return _straight_metrics(track, task, rows)
    whole = track.in_whole_px()
    times_s = track.times_s[rows]
    places_m = whole.points_px[rows] * task.scale_m_per_px
    if task.motion is MotionKind.TURN:
        away_m = np.linalg.norm(places_m - places_m[0], axis=1)
        scene = task_scene(task.id)
        de_n = laws.dynamic_error(
            times_s,
            places_m,
            mass_kg=scene.body("cube").mass_kg,
            # The first contact is that of the cube with the plate.
            friction=scene.contacts[0].friction,
        )
        return {
            "de": de_n,
            "displacement_in_sizes": float(away_m.max()) / task.size_m,
        }
    angles_rad = laws.swing_angles_rad(whole, task)[rows]
    if task.rest_px is None:
        fit = laws.fit_damped_oscillation(times_s, angles_rad)
        return {"r2": fit.r2, "pd": fit.period_s, "damping_per_s": fit.damping_per_s}
    # Equations "c5-event-mte" and "c5-mte" of the paper's appendix: outgoing over incoming momentum of equal balls.
    rises_m = task.rest_px[1] * task.scale_m_per_px - places_m[:, 1]
    transfers = []
    for apex in laws.apices(track.frames[rows], angles_rad, track.fps):
        around = slice(apex - 1, apex + 2)
        height_m = max(0.0, laws.peak(times_s[around], rises_m[around]))
        transfers.append(math.sqrt(height_m / task.release_height_m))
    if not transfers:
        raise ParameterError("momentum transfer: the outgoing ball has no apex")
    return {"mte": float(np.mean(transfers))}


def _straight_metrics(track: Track, task: VideoTask, rows: IntArray) -> Metrics:
    """Return the metrics of a slide or a fall by the fit of the paper and by a fit of the release."""
    times_s, scale = track.times_s, task.scale_m_per_px
    whole_m = laws.displacement_px(track.in_whole_px(), task) * scale
    paper = laws.fit_constant_acceleration(times_s[rows], whole_m[rows])
    # The fit includes rest before the motion, because the release is between rest and law.
    early = max(0, rows[0] - 2 * laws.WINDOW)
    used = _visible_rows(track, early, rows[-1])
    fit = laws.fit_constant_acceleration(
        times_s[used],
        laws.displacement_px(track, task)[used] * scale,
        release_s=float(times_s[rows[0]]),
        release_within_s=RELEASE_FRAMES / track.fps,
    )
    return {
        "a": paper.a_m_per_s2,
        "qfi": paper.qfi,
        "acceleration_m_s2": fit.a_m_per_s2,
        "form": fit.form,
        "release_s": fit.release_s,
    }


def _visible_rows(track: Track, first: int, last: int) -> IntArray:
    """Return the rows with the object between two rows, both included."""
    return first + np.flatnonzero(track.is_found[first : last + 1])


# --- uncertainty -----------------------------------------------------------------------------------------------------


def _intervals(
    track: Track, task: VideoTask, span: tuple[int, int], nominal: Metrics
) -> dict[str, tuple[float, float]]:
    """Return the 95 % interval of each metric over simulated errors of places, scale, pivot and span."""
    rng = np.random.default_rng(0)
    noise_px = track.noise_px(span)
    count = len(track.frames)
    samples = []
    for _ in range(SAMPLES):
        errors_px = rng.normal(0.0, noise_px, (count, 2))
        slow_px = rng.normal(0.0, SLOW_NOISE_PX, (count // SLOW_FRAMES + 1, 2))
        errors_px += np.repeat(slow_px, SLOW_FRAMES, axis=0)[:count]
        if task.motion is not MotionKind.TURN:
            errors_px += rng.normal(0.0, PIVOT_SIGMA_PX, 2)
        size_px = task.size_px * (1.0 + rng.normal(0.0, SCALE_SIGMA))
        first = max(0, span[0] + int(rng.integers(-1, 2)))
        last = max(first + 4, span[1] - int(rng.integers(0, 3)))
        sample = replace(track, points_px=track.points_px + errors_px)
        with suppress(ParameterError):
            scaled = replace(task, size_px=size_px)
            samples.append(measure(sample, scaled, (first, last)))
    intervals = {}
    for name, value in nominal.items():
        values = [value, *(sample[name] for sample in samples)]
        low, high = np.percentile(values, [2.5, 97.5]).tolist()
        # Noise only increases accelerations, so the true value may be below all simulated ones.
        intervals[name] = (min(value, low), max(value, high))
    return intervals
