"""Score the motion in a video by the law of its task, with the uncertainty of the track carried into the result."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError, VideoError
from gauge_envs.files import json_ready
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video import laws
from gauge_envs.tools.video.frames import ArrayFrames, FileFrames, Frames
from gauge_envs.tools.video.plane import LEAST_SLOPE, metric_on_grid
from gauge_envs.tools.video.soundness import faults_of, runs_text, short_motion
from gauge_envs.tools.video.tasks import Motion, VideoTask, video_task
from gauge_envs.tools.video.track import Track
from gauge_envs.tools.video.tracker import track_object

Metrics: TypeAlias = dict[str, float]

LEAST_RETAINED = 5
"""Fewest retained frames from which metrics are taken."""

RELEASE_FRAMES = 6.0
"""Frames before and after the first retained one between which rest ends."""

LEAST_PERIODS = 0.5
"""Fewest periods by which both turns of a swing part its period from its damping and equilibrium."""


MOST_GRAVITIES = 1.2
"""Largest gravity that a motion may need, in that of the Earth."""


def findings_of(
    track: Track, task: VideoTask, span: tuple[int, int] | None, metrics: Metrics
) -> list[str]:
    """Return what a clip shows that its metrics do not say."""
    if span is None:
        return [] if short_motion(track, task) else ["the object does not move"]
    found = []
    shown_s = float(np.ptp(track.times_s[list(span)]))
    period_s = metrics.get("pd", 0.0)
    if shown_s < LEAST_PERIODS * period_s:
        found.append(
            f"less than half a period is shown, {shown_s:.2f} s of {period_s:.2f} s: it may be another one"
        )
    gravities = _gravities(task, metrics)
    if gravities > MOST_GRAVITIES:
        found.append(
            f"it moves as under {gravities:.1f} times gravity: the stated rate may be wrong, give --fps"
        )
    if task.motion is Motion.TURN:
        way = way_in_sizes(track, task)
        if way < 1.0:
            found.append(
                f"the object moves by {way:.2f} of its size: a dynamic error of 0 says little"
            )
    if task.motion is Motion.CRADLE:
        swings = [track.frames[one] for one in laws.swings_without_apex(track, task)]
        found += [
            f"the ball swings out in frames {runs_text(one)}, and its apex is not seen"
            for one in swings
        ]
    return found


def way_in_sizes(track: Track, task: VideoTask) -> float:
    """Return how far an object gets from its first place, in its sizes."""
    places = track.points_px[track.is_found]
    return float(np.linalg.norm(places - places[0], axis=1).max()) / task.size_px


def _gravities(task: VideoTask, metrics: Metrics) -> float:
    """Return the gravity that a motion needs at least, in that of the Earth; 0 where it needs none."""
    if task.direction is not None:
        down = max(task.direction[1], LEAST_SLOPE)
        return metrics.get("acceleration_m_s2", 0.0) / down / laws.GRAVITY_M_PER_S2
    if "pd" in metrics and task.pivot_px is not None:
        length_m = math.dist(task.centre_px, task.pivot_px) * task.scale_m_per_px
        rate_rad_s = 2.0 * math.pi / metrics["pd"]
        return rate_rad_s**2 * length_m / laws.GRAVITY_M_PER_S2
    return 0.0


# --- score ------------------------------------------------------------------------------------------------------------

PAPER_METRICS = ("a", "qfi", "r2", "pd", "mte", "de")
"""Metrics of GAUGE's paper under its names: acceleration [m/s^2] and QFI from the first retained frame on, R^2 and
period [s] of a damped oscillation, momentum transfer, and dynamic error [N]."""

METRICS = (*PAPER_METRICS, "acceleration_m_s2", "form")
"""Names of all metrics, in the order of a result. The last two are the package's, of straight motions: acceleration
from a release that is fitted, and the residual of the law in parts of the motion."""

SAMPLES = 200
"""Simulated tracks from which intervals are taken."""

COVERAGE = 0.95
"""Share of the simulated tracks within an interval."""

FRAMING_SIGMA = 0.005
"""Relative standard uncertainty of the pixel scale beside that of the measured length: depth and lens, from the four
edges of the cubes, which differ by 1 %."""

SLOW_NOISE_PX = 0.25
"""Error of a place that stays for some frames [px]: that of a ball that is half hidden by the pendulum's post."""

SLOW_FRAMES = 6
"""Frames for which that error stays."""


@dataclass(frozen=True, kw_only=True)
class VideoScore:
    """Result of one video: whether its track is sound, and the physics of the motion.

    Attributes:
        video: Name of the video or track.
        task: Id of the task.
        is_sound: Whether what was followed is the object, all the time; the law of its motion plays no part.
        reasons: Why the track is not sound, with frame numbers.
        findings: What else the clip shows.
        metrics: Values by name; None where a metric does not apply or there is no motion.
        uncertainty: Interval of each metric that holds 95 % of simulated tracks.
        interval_frames: First and last retained frame; None when there is none.
        scale_m_per_px: Size of a pixel of the reference grid [m].
        details: Further numbers, such as the damping of a swing.
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
    details: dict[str, float] = field(default_factory=dict)
    track: Track

    def to_dict(self) -> dict[str, Any]:
        """Return the result without the track, JSON-ready."""
        values = {
            one.name: getattr(self, one.name)
            for one in fields(self)
            if one.name != "track"
        }
        registration = self.track.registration
        values["registration"] = registration and asdict(registration)
        ready: dict[str, Any] = json_ready(values)
        return ready


def score(
    frames: Path | str | Sequence[NDArray[np.uint8]] | NDArray[np.uint8],
    fps: float | None = None,
    task: str = "",
) -> VideoScore:
    """Track the object of a task through a video, and judge its motion.

    Args:
        frames: A video file, or pictures in red, green and blue of shape [height, width, 3] and type uint8.
        fps: Frames per second; those that the file states if None.
        task: Id of a task, such as `SlopeSlider-2-wood`; see `gauge_envs.tools.video.video_tasks`.

    Raises:
        UnknownNameError: There is no such task.
        VideoError: The video cannot be read, or is out of range.
        MissingExtraError: OpenCV is not installed.
    """
    chosen = video_task(task)
    source: Frames
    if isinstance(frames, str | Path):
        source = FileFrames(Path(frames), fps=fps)
    elif fps is None:
        raise VideoError("frames: state fps, the frames per second")
    else:
        source = ArrayFrames(frames, fps=fps)
    track = track_object(source, chosen)
    return score_track(track, chosen, name=source.name)


def score_track(track: Track, task: VideoTask, *, name: str = "track") -> VideoScore:
    """Judge the motion of a track.

    Args:
        track: The track, on the reference grid or in millimetres.
        task: The task.
        name: Name of the result.
    """
    has_exact_scale = track.is_metric and bool(track.is_found.any())
    if has_exact_scale:
        track, task = metric_on_grid(track, task)
    span = laws.retained(track, task)
    metrics: Metrics = {}
    details: Metrics = {}
    faults = faults_of(track, task, span)
    last_frame = track.frames[-1 if span is None else span[1]]
    findings = [
        one.text
        for one in track.events
        if one.is_note and one.first_frame <= last_frame
    ]
    if span is not None:
        try:
            metrics, details = _metrics(track, task, span, task.scale_m_per_px)
        except ParameterError as error:
            findings.append(str(error))
    findings += findings_of(track, task, span, metrics)
    intervals = (
        {}
        if span is None or not metrics
        else _intervals(
            track, task, span, metrics | details, has_exact_scale=has_exact_scale
        )
    )
    return VideoScore(
        video=name,
        task=task.id,
        is_sound=not faults,
        reasons=tuple(faults),
        findings=tuple(findings),
        metrics={one: metrics.get(one) for one in METRICS},
        uncertainty={one: intervals.get(one) for one in METRICS},
        interval_frames=None
        if span is None
        else (int(track.frames[span[0]]), int(track.frames[span[1]])),
        scale_m_per_px=task.scale_m_per_px,
        details=details,
        track=track,
    )


def _found(track: Track, span: tuple[int, int]) -> NDArray[np.intp]:
    """Return the rows of an interval in which the object was found."""
    rows = np.arange(span[0], span[1] + 1)
    return rows[track.is_found[rows]]


def _metrics(
    track: Track,
    task: VideoTask,
    span: tuple[int, int],
    scale_m_per_px: float,
    guess: tuple[float, float] | None = None,
) -> tuple[Metrics, Metrics]:
    """Return the metrics of a task in an interval, and further numbers."""
    metrics, details = paper_metrics(track, task, span, scale_m_per_px, guess)
    if task.motion in (Motion.SLIDE, Motion.FALL):
        rows = _found(track, span)
        # Rest before the motion belongs to the fit: the release is where rest and law meet.
        early = np.arange(max(0, span[0] - 2 * laws.WINDOW), span[0])
        used = np.r_[early[track.is_found[early]], rows]
        fit = laws.fit_constant_acceleration(
            track.times_s[used],
            laws.displacement_px(track, task)[used] * scale_m_per_px,
            release_within_s=RELEASE_FRAMES / track.fps,
            release_s=float(track.times_s[rows[0]]),
        )
        metrics |= {"acceleration_m_s2": fit.a_m_per_s2, "form": fit.form}
        details["release_s"] = fit.release_s
    return metrics, details


def paper_metrics(
    track: Track,
    task: VideoTask,
    span: tuple[int, int],
    scale_m_per_px: float,
    guess: tuple[float, float] | None = None,
) -> tuple[Metrics, Metrics]:
    """Return the metrics as the paper defines them, and further numbers.

    Args:
        track: The track; its places count in whole pixels, as the paper stores them.
        task: The task.
        span: First and last retained row.
        scale_m_per_px: Size of a pixel [m].
        guess: Damping [1/s] and angular frequency [rad/s] of a swing from which the search starts.
    """
    track = track.in_whole_px()
    rows = _found(track, span)
    times_s = track.times_s[rows]
    if task.motion in (Motion.SLIDE, Motion.FALL):
        along_m = laws.displacement_px(track, task)[rows] * scale_m_per_px
        fit = laws.fit_constant_acceleration(times_s, along_m)
        return {"a": fit.a_m_per_s2, "qfi": fit.qfi}, {}
    if task.motion is Motion.TURN:
        de_n, sizes = laws.dynamic_error(
            times_s,
            track.points_px[rows] * scale_m_per_px,
            mass_kg=task.mass_kg,
            friction=task.friction,
        )
        limit_m_s2 = task.friction * laws.GRAVITY_M_PER_S2
        return {"de": de_n}, {
            "largest_a_m_s2": float(sizes.max()),
            "exceeding_share": float((sizes > limit_m_s2).mean()),
        }
    angles = laws.swing_angles_rad(track, task)[rows]
    if task.motion is Motion.PENDULUM:
        swing = laws.fit_damped_oscillation(times_s, angles, guess=guess)
        return {"r2": swing.r2, "pd": swing.period_s}, {
            "damping_per_s": swing.damping_per_s,
        }
    assert task.rest_px is not None
    events = laws.apices(times_s, angles, 1.0 / track.fps)
    rises_m = (task.rest_px[1] - track.points_px[rows, 1]) * scale_m_per_px
    heights = np.array(
        [laws.peak(times_s[i - 1 : i + 2], rises_m[i - 1 : i + 2]) for i in events]
    )
    # Equations "c5-event-mte" and "c5-mte" of the paper's appendix: outgoing over incoming momentum of equal balls.
    transfers = np.sqrt(np.maximum(heights, 0.0) / task.release_height_m)
    if not len(transfers):
        raise ParameterError("momentum transfer: there is no apex of the outgoing ball")
    return {"mte": float(transfers.mean())}, {
        "event_count": float(len(events)),
        "least_event": float(transfers.min()),
        "largest_event": float(transfers.max()),
    }


def law_share(result: VideoScore, task: VideoTask) -> float:
    """Return how near a clip is to the law of its task, from 0 to 1; 0 for one that is refused.

    Args:
        result: The result.
        task: The task.
    """
    if not result.is_sound:
        return 0.0
    # A cube that stands still needs no force.
    is_still = task.motion is Motion.TURN and way_in_sizes(result.track, task) < 1.0
    shares = []
    for name, law in task.law.items():
        value = result.metrics[name]
        if name == "qfi":
            continue
        if value is None or is_still:
            shares.append(0.0)
        elif name == "de":
            friction_n = task.friction * task.mass_kg * laws.GRAVITY_M_PER_S2
            shares.append(1.0 / (1.0 + value / friction_n))
        elif name == "r2":
            shares.append(max(0.0, value))
        else:
            shares.append(_ratio(value, law))
    return float(np.mean(shares))


def _ratio(value: float, law: float) -> float:
    """Return the smaller ratio of a value and its law, from 0 to 1."""
    ratio = max(0.0, value) / law
    return min(ratio, 1.0 / max(ratio, 1.0))


# --- uncertainty -----------------------------------------------------------------------------------------------------


def _slow_noise(track: Track, rng: np.random.Generator) -> FloatArray:
    """Return errors that stay for some frames [px], shape [frame_count, 2]."""
    count = len(track.frames) // SLOW_FRAMES + 2
    knots = np.arange(count) * SLOW_FRAMES - rng.uniform(0.0, SLOW_FRAMES)
    values = rng.normal(0.0, SLOW_NOISE_PX, (count, 2))
    rows = np.arange(len(track.frames))
    return np.column_stack([np.interp(rows, knots, values[:, axis]) for axis in (0, 1)])


def _swing_of(
    track: Track, task: VideoTask, span: tuple[int, int], nominal: Metrics
) -> laws.OscillationFit | None:
    """Return the fit of a pendulum's swing in fractions of pixels; None for other motions."""
    if task.motion is not Motion.PENDULUM:
        return None
    rows = _found(track, span)
    angles_rad = laws.swing_angles_rad(track, task)[rows]
    guess = (nominal["damping_per_s"], 2.0 * math.pi / nominal["pd"])
    return laws.fit_damped_oscillation(track.times_s[rows], angles_rad, guess=guess)


def _intervals(
    track: Track,
    task: VideoTask,
    span: tuple[int, int],
    nominal: Metrics,
    *,
    has_exact_scale: bool,
) -> dict[str, tuple[float, float]]:
    """Return the interval of each metric, over simulated noise, scales, pivots and choices of the interval."""
    noise, rng = track.noise_px(span), np.random.default_rng(0)
    swing = _swing_of(track, task, span, nominal)
    guess = None if swing is None else swing.guess
    rows = _found(track, span)
    scale_sigma = math.hypot(FRAMING_SIGMA, 0.5 * task.size_sigma_px / task.size_px)
    if has_exact_scale:
        scale_sigma = 0.0
    found: dict[str, list[float]] = {}
    count = SAMPLES if task.motion is not Motion.PENDULUM else SAMPLES // 5
    for _ in range(count):
        points = (
            track.points_px
            + rng.normal(0.0, noise, track.points_px.shape)
            + _slow_noise(track, rng)
        )
        if task.pivot_px is not None and task.motion is not Motion.TURN:
            points = points + rng.normal(0.0, task.pivot_sigma_px, 2)
        if swing is not None:
            # What the law does not explain may come at any other time, with the other sign.
            misfit, sign = swing.residuals_rad, rng.choice([-1.0, 1.0])
            other = sign * np.roll(misfit, rng.integers(len(rows))) - misfit
            offset = points[rows] - np.array(task.pivot_px)
            points[rows] += other[:, None] * offset[:, ::-1] * (1.0, -1.0)
        sample = replace(track, points_px=points)
        first = max(0, span[0] + int(rng.integers(-1, 2)))
        last = min(
            len(track.frames) - 1, max(first + 4, span[1] - int(rng.integers(0, 3)))
        )
        scale = task.scale_m_per_px * (1.0 + rng.normal(0.0, scale_sigma))
        try:
            metrics, _ = _metrics(sample, task, (first, last), scale, guess)
        except ParameterError:
            continue
        for name, value in metrics.items():
            found.setdefault(name, []).append(value)
    tail = 50.0 * (1.0 - COVERAGE)
    intervals = {
        # Noise lengthens accelerations only, so an error of 0 lies below all simulated ones.
        name: (
            min(nominal[name], float(np.percentile(values, tail))),
            max(nominal[name], float(np.percentile(values, 100.0 - tail))),
        )
        for name, values in found.items()
        if len(values) >= count // 2
    }
    if "pd" in intervals:
        # Over less than a period, any noise lengthens it, and that of the track has already: the error has either sign.
        errors = np.abs(np.array(found["pd"]) - nominal["pd"])
        away = float(np.percentile(errors, 100.0 * COVERAGE))
        intervals["pd"] = (max(0.0, nominal["pd"] - away), nominal["pd"] + away)
    if has_exact_scale and "de" in intervals:
        # A track has noise already, which excess counts as force. Simulated noise shows how much; it is reflected.
        high = intervals["de"][1]
        low = max(0.0, min(nominal["de"], 2.0 * nominal["de"] - high))
        intervals["de"] = (low, high)
    return intervals
