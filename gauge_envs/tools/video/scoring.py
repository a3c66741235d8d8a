"""Score the motion in a video by the law of its task, with the uncertainty of the track carried into the result."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError, VideoError
from gauge_envs.files import json_ready
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video import laws
from gauge_envs.tools.video.frames import ArrayFrames, FileFrames, Frames
from gauge_envs.tools.video.plane import PlaneView, frontal_task, frontal_track
from gauge_envs.tools.video.tasks import Motion, VideoTask, video_task
from gauge_envs.tools.video.track import Track
from gauge_envs.tools.video.tracker import track_object

Metrics: TypeAlias = dict[str, float]

LEAST_RETAINED = 5
"""Fewest retained frames of a valid clip."""

MOST_MISSING, FATAL_MISSING = 0.15, 0.5
"""Share of frames without the object in the retained interval: of a valid clip, and of one that can be judged."""

MOST_SIZE_CHANGE = 0.2
"""Largest change of the apparent size of the object in a valid clip."""

LEAST_CONFIDENCE = 0.5
"""Smallest mean confidence of a valid clip, which is the likeness to the object in the first frame."""

RELEASE_FRAMES = 6.0
"""Frames before and after the first retained one between which rest ends."""

MOST_TRIMMED, SAME_FORM = 4, 1.5
"""Most frames at the end that may be left out, and the ratio of residuals up to which they are kept."""

MOST_FORM = {Motion.SLIDE: 0.03, Motion.FALL: 0.03, Motion.PENDULUM: 0.2}
"""Largest residual of the law in travelled distances, or amplitudes, with which its constant says something."""

LEAST_PERIODS = 0.5
"""Fewest periods of a valid clip: both turns of a swing part its period from its damping and equilibrium."""

JUMP = 0.15
"""Change of the step from frame to frame that no law needs, in sizes of the object."""

MOST_M_S2 = 2.0 * laws.GRAVITY_M_PER_S2
"""Largest acceleration of a swing, slide or fall [m/s^2]; friction bounds that on a turntable."""


class Grade(StrEnum):
    """Whether the metrics of a clip can be trusted."""

    VALID = "valid"
    """The object was followed through the motion."""
    DOUBTFUL = "doubtful"
    """Something happened that may change the metrics; the reasons name it."""
    INVALID = "invalid"
    """There is no motion of the task to judge."""


def grade_of(
    track: Track,
    task: VideoTask,
    span: tuple[int, int] | None,
    problem: str,
    metrics: Metrics,
) -> tuple[Grade, tuple[str, ...]]:
    """Return the grade of a clip and its reasons, with frame numbers.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row; None when the object does not move.
        problem: Why the law could not be fitted; empty when it could.
        metrics: Metrics of the clip, with the residual of the law.
    """
    if span is None:
        missing = _runs(track.frames[~track.is_found])
        seen = f"; it was not found in frames {missing}" if missing else ""
        causes = [
            one.text
            for one in track.events
            if one.kind in ("picture", "registration", "file")
        ]
        return Grade.INVALID, (f"the object does not move{seen}", *causes)
    rows = np.arange(span[0], span[1] + 1)
    fatal, doubts = _missing_reasons(track, rows, task)
    if problem:
        fatal.insert(0, problem)
    if len(rows) < LEAST_RETAINED:
        fatal.append(
            f"only {len(rows)} frames are retained; a fit needs {LEAST_RETAINED}"
        )
    found = rows[track.is_found[rows]]
    sizes = track.size_ratio[found]
    known = np.isfinite(sizes)
    usual = float(np.median(sizes[known])) if known.any() else 1.0
    odd = found[known & (np.abs(sizes / usual - 1.0) > MOST_SIZE_CHANGE)]
    if len(odd) > MOST_MISSING * len(rows):
        doubts.append(
            f"the object changes its size by more than 20 % in frames {_runs(track.frames[odd])}"
        )
    confidence = float(track.confidence[found].mean()) if len(found) else 0.0
    if confidence < LEAST_CONFIDENCE:
        doubts.append(
            f"the mean confidence of the track is {confidence:.2f}, below {LEAST_CONFIDENCE:g}"
        )
    form = metrics.get("form", 0.0)
    if form > MOST_FORM.get(task.motion, math.inf):
        doubts.append(
            f"the motion does not follow the law at any constant: its residual is {form:.0%} of the motion"
        )
    shown_s, period_s = (
        float(np.ptp(track.times_s[list(span)])),
        metrics.get("pd_s", 0.0),
    )
    if shown_s < LEAST_PERIODS * period_s:
        doubts.append(
            f"less than half a period is shown, {shown_s:.2f} s of {period_s:.2f} s: it may be another one"
        )
    jumps = _jumps(track, task, found)
    if len(jumps):
        doubts.append(
            f"the object jumps by more than the law allows in frames {_runs(track.frames[jumps])}"
        )
    inside = [one for one in track.events if one.first_frame <= track.frames[span[1]]]
    fatal += [one.text for one in inside if one.is_fatal]
    doubts += [one.text for one in inside if not (one.is_fatal or one.is_note)]
    notes = [one.text for one in inside if one.is_note]
    grade = Grade.INVALID if fatal else Grade.DOUBTFUL if doubts else Grade.VALID
    return grade, (*fatal, *doubts, *notes)


def _jumps(track: Track, task: VideoTask, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return rows at which the step from frame to frame changes by more than the law and the tracker allow."""
    times, points = track.times_s[rows], track.points_px[rows]
    if len(rows) < 3:
        return rows[:0]
    steps = np.diff(times)
    velocities = np.diff(points, axis=0) / steps[:, None]
    # The law bounds the change of the velocity between the middles of two steps.
    between = 0.5 * (steps[1:] + steps[:-1])
    lawful = (
        task.friction * laws.GRAVITY_M_PER_S2
        if task.motion is Motion.TURN
        else MOST_M_S2
    )
    limit = lawful / task.scale_m_per_px * between + JUMP * task.size_px / np.minimum(
        steps[1:], steps[:-1]
    )
    return rows[1:-1][np.linalg.norm(np.diff(velocities, axis=0), axis=1) > limit]


def _missing_reasons(
    track: Track, rows: NDArray[np.intp], task: VideoTask
) -> tuple[list[str], list[str]]:
    # The outgoing ball of a cradle is looked for only where it swings out.
    if task.motion is Motion.CRADLE:
        swings = [track.frames[one] for one in laws.swings_without_apex(track, task)]
        return [], [
            f"the ball swings out in frames {_runs(one)}, and its apex is not seen"
            for one in swings
        ]
    lost = rows[~track.is_found[rows]]
    share = len(lost) / len(rows)
    text = f"the object is lost in {share:.0%} of the retained frames: {_runs(track.frames[lost])}"
    if share > FATAL_MISSING:
        return [text], []
    return [], [text] if share > MOST_MISSING else []


def _runs(frames: NDArray[np.int64]) -> str:
    """Return frame numbers as runs: `3 to 9, 14`."""
    if not len(frames):
        return ""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    texts = [
        f"{part[0]} to {part[-1]}" if len(part) > 1 else f"{part[0]}" for part in parts
    ]
    shown = texts[:4]
    return ", ".join(shown) + (
        f" and {len(texts) - 4} more runs" if len(texts) > 4 else ""
    )


# --- score ------------------------------------------------------------------------------------------------------------

METRICS = ("a_m_s2", "qfi", "r2", "pd_s", "mte", "de_n", "form")
"""Names of all metrics, in the order of a result."""

SAMPLES = 200
"""Simulated tracks from which intervals are taken."""

COVERAGE = 0.95
"""Share of the simulated tracks within an interval."""

FRAMING_SIGMA = 0.005
"""Relative standard uncertainty of the pixel scale beside that of the measured length: depth and lens, from the four
edges of the cubes, which differ by 1 %."""

LEAST_NOISE_PX = 0.1
"""Smallest scatter of a tracker from frame to frame that is assumed [px]."""

SLOW_NOISE_PX = 0.25
"""Error of a place that stays for some frames [px]: that of a ball that is half hidden by the pendulum's post."""

SLOW_FRAMES = 6
"""Frames for which that error stays."""


@dataclass(frozen=True, kw_only=True)
class VideoScore:
    """Result of one video.

    Attributes:
        video: Name of the video or track.
        task: Id of the task.
        grade: Whether the metrics can be trusted.
        reasons: What lowers the grade, with frame numbers.
        metrics: Values by name; None where a metric does not apply or there is no valid motion.
        uncertainty: Interval of each metric that holds 95 % of simulated tracks.
        interval_frames: First and last retained frame; None when there is none.
        scale_m_per_px: Size of a pixel of the reference grid [m].
        details: Further numbers, such as the acceleration with the paper's release frame.
        track: The track.
    """

    video: str
    task: str
    grade: Grade
    reasons: tuple[str, ...]
    metrics: dict[str, float | None]
    uncertainty: dict[str, tuple[float, float] | None]
    interval_frames: tuple[int, int] | None
    scale_m_per_px: float
    details: dict[str, float] = field(default_factory=dict)
    track: Track

    def to_dict(self) -> dict[str, Any]:
        """Return the result without the track, JSON-ready."""
        names = (
            "video",
            "task",
            "grade",
            "reasons",
            "metrics",
            "uncertainty",
            "interval_frames",
            "scale_m_per_px",
        )
        values: dict[str, Any] = json_ready(
            {name: getattr(self, name) for name in (*names, "details")}
        )
        registration = self.track.registration
        return {
            **values,
            "registration": None if registration is None else registration.to_dict(),
        }


def score(
    frames: Path | str | Sequence[NDArray[np.uint8]] | NDArray[np.uint8],
    fps: float | None = None,
    task: str = "",
    *,
    first_frame: Path | None = None,
) -> VideoScore:
    """Track the object of a task through a video, and judge its motion.

    Args:
        frames: A video file, or pictures in red, green and blue of shape [height, width, 3] and type uint8.
        fps: Frames per second; those that the file states if None.
        task: Id of a task, such as `SlopeSlider-2-wood`; see `gauge_envs.tools.video.video_tasks`.
        first_frame: Picture file that the model was given, by which the video is registered.

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
    track = track_object(source, chosen, first_frame=first_frame)
    return score_track(track, chosen, name=source.name)


def score_track(
    track: Track,
    task: VideoTask,
    *,
    name: str = "track",
    seed: int = 0,
    camera: PlaneView | None = None,
) -> VideoScore:
    """Judge the motion of a track.

    Args:
        track: The track, on the reference grid.
        task: The task.
        name: Name of the result.
        seed: Seed of the simulated tracks.
        camera: How the recording sees the plane of the motion; None for the known first frame.

    Raises:
        VideoError: The camera file of a pendulum or a cradle lacks the pivot, or that of a cradle the length.
    """
    view = camera if track.is_found.any() else None
    seen = track
    if view is not None:
        if task.motion in (Motion.PENDULUM, Motion.CRADLE) and view.pivot_m is None:
            what = "the pivot about which it swings"
            raise VideoError(
                f"{name}: {task.id} needs motion.pivot_m in the camera file: {what}"
            )
        if task.motion is Motion.CRADLE and view.length_m is None:
            raise VideoError(
                f"{name}: {task.id} needs motion.length_m in the camera file: from the pivot to the ball"
            )
        task = frontal_task(view, seen, task)
        track = frontal_track(view, seen, task)
    span = _ended(track, task, laws.retained(track, task))
    if task.motion is Motion.CRADLE:
        found = np.flatnonzero(track.is_found)
        span = (int(found[0]), int(found[-1])) if len(found) else None
    metrics: Metrics = {}
    details: Metrics = {}
    problem = ""
    if span is not None:
        try:
            metrics, details = _metrics(track, task, span, task.scale_m_per_px)
        except ParameterError as error:
            problem = str(error)
    grade, reasons = grade_of(track, task, span, problem, metrics)
    swing = None
    if task.motion is Motion.PENDULUM and metrics and span is not None:
        rows, guess = (
            _found(track, span),
            (details["damping_per_s"], 2.0 * math.pi / metrics["pd_s"]),
        )
        swing = laws.fit_damped_oscillation(
            track.times_s[rows], laws.swing_angles_rad(track, task)[rows], guess=guess
        )
    rng = np.random.default_rng(seed)
    intervals = (
        {}
        if span is None or not metrics
        else _intervals(seen, task, span, rng, metrics, swing, view)
    )
    return VideoScore(
        video=name,
        task=task.id,
        grade=grade,
        reasons=reasons,
        metrics={one: metrics.get(one) for one in METRICS},
        uncertainty={one: intervals.get(one) for one in METRICS},
        interval_frames=None
        if span is None
        else (int(track.frames[span[0]]), int(track.frames[span[1]])),
        scale_m_per_px=task.scale_m_per_px,
        details=details,
        track=seen,
    )


def _ended(
    track: Track, task: VideoTask, span: tuple[int, int] | None
) -> tuple[int, int] | None:
    """Return an interval without its last frames if these do not follow the law of the others."""
    if span is None or task.motion not in (Motion.SLIDE, Motion.FALL):
        return span
    found = np.arange(span[0], span[1] + 1)[track.is_found[span[0] : span[1] + 1]]
    ends = [
        int(row)
        for row in found[::-1][: MOST_TRIMMED + 1]
        if np.count_nonzero(found <= row) >= LEAST_RETAINED
    ]
    if not ends:
        return span
    forms = [
        _metrics(track, task, (span[0], end), task.scale_m_per_px)[0]["form"]
        for end in ends
    ]
    return span[0], next(
        end
        for end, form in zip(ends, forms, strict=True)
        if form <= SAME_FORM * min(forms)
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
    rows = _found(track, span)
    times_s = track.times_s[rows]
    if task.motion in (Motion.SLIDE, Motion.FALL):
        # Rest before the motion belongs to the fit: the release is where rest and law meet.
        early = np.arange(max(0, span[0] - 2 * laws.WINDOW), span[0])
        used = np.r_[early[track.is_found[early]], rows]
        along_m = laws.displacement_px(track, task) * scale_m_per_px
        release = {
            "release_within_s": RELEASE_FRAMES / track.fps,
            "release_s": float(times_s[0]),
        }
        fit = laws.fit_constant_acceleration(
            track.times_s[used], along_m[used], **release
        )
        fixed = laws.fit_constant_acceleration(times_s, along_m[rows])
        return {"a_m_s2": fit.a_m_per_s2, "qfi": fit.qfi, "form": fit.form}, {
            "a_at_first_frame_m_s2": fixed.a_m_per_s2,
            "qfi_at_first_frame": fixed.qfi,
            "linear_r2": fit.r2,
            "release_s": fit.release_s,
        }
    if task.motion is Motion.TURN:
        error = laws.dynamic_error(
            times_s,
            track.points_px[rows] * scale_m_per_px,
            mass_kg=task.mass_kg,
            friction=task.friction,
        )
        sizes = error.accelerations_m_per_s2
        form = {}
        if task.pivot_px is not None:
            radii = np.linalg.norm(
                track.points_px[rows] - np.array(task.pivot_px), axis=1
            )
            form["form"] = laws.monotone_misfit(radii, is_rising=True)
        return {"de_n": error.de_n, **form}, {
            "median_a_m_s2": float(np.median(sizes)),
            "p95_a_m_s2": float(np.percentile(sizes, 95)),
            "exceeding_share": float((error.exceedance_n > 0.0).mean()),
        }
    angles = laws.swing_angles_rad(track, task)[rows]
    if task.motion is Motion.PENDULUM:
        swing = laws.fit_damped_oscillation(times_s, angles, guess=guess)
        misfit = (
            math.sqrt(max(0.0, 1.0 - swing.r2))
            * float(angles.std())
            / max(swing.amplitude_rad, 1e-9)
        )
        return {"r2": swing.r2, "pd_s": swing.period_s, "form": misfit}, {
            "damping_per_s": swing.damping_per_s,
            "equilibrium_deg": math.degrees(swing.equilibrium_rad),
            "amplitude_deg": math.degrees(swing.amplitude_rad),
        }
    assert task.rest_px is not None
    events = laws.apices(times_s, angles)
    rises_m = (task.rest_px[1] - track.points_px[rows, 1]) * scale_m_per_px
    heights = np.array(
        [laws.peak(times_s[i - 1 : i + 2], rises_m[i - 1 : i + 2]) for i in events]
    )
    mte = laws.momentum_transfer(task.release_height_m, np.maximum(heights, 0.0))
    return {"mte": mte, "form": laws.monotone_misfit(heights, is_rising=False)}, {
        "event_count": float(len(events)),
        "first_event": float(np.sqrt(max(heights[0], 0.0) / task.release_height_m)),
    }


# --- uncertainty -----------------------------------------------------------------------------------------------------


def noise_px(track: Track, span: tuple[int, int]) -> float:
    """Return the scatter of a track from frame to frame [px], from its third differences: smooth motions have none."""
    points = track.points_px[span[0] : span[1] + 1]
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 8:
        return LEAST_NOISE_PX
    third = np.diff(points, n=3, axis=0)
    scatter = (
        float(np.median(np.abs(third - np.median(third, axis=0))))
        / 0.6745
        / math.sqrt(20.0)
    )
    return max(scatter, LEAST_NOISE_PX)


def _slow_noise(track: Track, rng: np.random.Generator) -> FloatArray:
    """Return errors that stay for some frames [px], shape [frame_count, 2]."""
    count = len(track.frames) // SLOW_FRAMES + 2
    knots = np.arange(count) * SLOW_FRAMES - rng.uniform(0.0, SLOW_FRAMES)
    values = rng.normal(0.0, SLOW_NOISE_PX, (count, 2))
    rows = np.arange(len(track.frames))
    return np.column_stack([np.interp(rows, knots, values[:, axis]) for axis in (0, 1)])


def _intervals(
    track: Track,
    task: VideoTask,
    span: tuple[int, int],
    rng: np.random.Generator,
    nominal: Metrics,
    swing: laws.OscillationFit | None,
    view: PlaneView | None,
) -> dict[str, tuple[float, float]]:
    """Return the interval of each metric, over simulated noise, scales, pivots and choices of the interval."""
    noise = noise_px(track, span)
    guess = (
        None if swing is None else (swing.damping_per_s, 2.0 * math.pi / swing.period_s)
    )
    scale_sigma = math.hypot(FRAMING_SIGMA, 0.5 * task.size_sigma_px / task.size_px)
    found: dict[str, list[float]] = {}
    count = SAMPLES if task.motion is not Motion.PENDULUM else SAMPLES // 5
    for _ in range(count):
        points = (
            track.points_px
            + rng.normal(0.0, noise, track.points_px.shape)
            + _slow_noise(track, rng)
        )
        sample = replace(
            track, points_px=points, size_ratio=np.full(len(points), np.nan)
        )
        judged = task
        if view is not None:
            # Calibration and pivot replace the stated scale: they are drawn anew within their uncertainty.
            drawn = view.drawn(rng)
            judged = frontal_task(
                drawn, sample, task, scale_m_per_px=task.scale_m_per_px
            )
            sample = frontal_track(drawn, sample, judged)
        elif task.pivot_px is not None and task.motion is not Motion.TURN:
            sample = replace(
                sample, points_px=points + rng.normal(0.0, task.pivot_sigma_px, 2)
            )
        if swing is not None and judged.pivot_px is not None:
            # What the law does not explain may come at any other time, with the other sign.
            rows, misfit = _found(track, span), swing.residuals_rad
            other = (
                rng.choice([-1.0, 1.0]) * np.roll(misfit, rng.integers(len(rows)))
                - misfit
            )
            offset = sample.points_px[rows] - np.array(judged.pivot_px)
            sample.points_px[rows] += other[:, None] * offset[:, ::-1] * (1.0, -1.0)
        first = max(0, span[0] + int(rng.integers(-1, 2)))
        last = min(
            len(track.frames) - 1, max(first + 4, span[1] - int(rng.integers(0, 3)))
        )
        scale = judged.scale_m_per_px * (
            1.0 if view is not None else 1.0 + rng.normal(0.0, scale_sigma)
        )
        try:
            metrics, _ = _metrics(sample, judged, (first, last), scale, guess)
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
    if "pd_s" in intervals:
        # Over less than a period, any noise lengthens it, and that of the track has already: the error has either sign.
        away = float(
            np.percentile(
                np.abs(np.array(found["pd_s"]) - nominal["pd_s"]), 100.0 * COVERAGE
            )
        )
        intervals["pd_s"] = (max(0.0, nominal["pd_s"] - away), nominal["pd_s"] + away)
    if view is not None and "de_n" in intervals:
        # A track has noise already, which excess counts as force. Simulated noise shows how much; it is reflected.
        high = intervals["de_n"][1]
        intervals["de_n"] = (
            max(0.0, min(nominal["de_n"], 2.0 * nominal["de_n"] - high)),
            high,
        )
    return intervals
