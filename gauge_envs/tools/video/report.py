"""Report scores of videos: the result of a clip, the table of many models, a page, and pictures of tracks."""

import math
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gauge_envs.errors import VideoError
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.html import element
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.video.frames import FileFrames, Picture, cv2
from gauge_envs.tools.video.scoring import VideoScore
from gauge_envs.tools.video.tasks import (
    MotionKind,
    VideoTask,
    published_models,
    published_values,
    video_tasks,
)
from gauge_envs.tools.video.track import (
    TRACK_SUFFIXES,
    VIDEO_SUFFIXES,
    video_of,
)

TITLES = {
    "a": "a [m/s^2]",
    "qfi": "QFI",
    "r2": "R^2",
    "pd": "PD [s]",
    "mte": "MTE",
    "de": "DE [N]",
    "acceleration_m_s2": "acceleration [m/s^2]",
    "size_mm": "object [mm]",
    "size_px": "object [px]",
    "interval": "95 % interval",
    "real": "real trials",
}
"""Titles of metrics and columns that differ from their names."""

VERDICT_NOTE = (
    "In a test on films of unknown renderers, 9 of 39 accepted tracks were wrong, all by a planted change. "
    "Check which object was followed."
)
"""Reliability of the verdict of a track."""

VALUES_NOTE = (
    f"{VERDICT_NOTE} Mean over the clips (seeds) with accepted tracks, and their number. "
    "Law: ideal motion with the published constants, Table 3 of the paper."
)

ACCELERATION_ERROR = 0.02
"""Largest relative error of accelerations of synthetic clips."""

UNBIASED = {"a": "acceleration_m_s2"}
"""Metric without the bias of a metric of the paper, which only models of the paper show."""

DIFFERENCE = 0.1
"""Relative difference from a published value that is named."""

RETAINED, DROPPED = (80, 200, 80), (150, 150, 150)
"""Colours of retained and of dropped places, in blue, green and red."""

Clips: TypeAlias = Sequence[tuple[str, str, Path, VideoScore | None]]
"""Model, task, file and result of each clip; the result is None if the clip cannot be scored."""

Row: TypeAlias = dict[str, Any]
"""Values of a table row by the key of the column."""


# --- tables ----------------------------------------------------------------------------------------------------------


def _table(rows: Sequence[Row], *notes: str) -> Table:
    """Return a table of rows with the same keys; numbers have four digits."""
    columns = []
    for key in rows[0]:
        is_text = any(isinstance(row[key], str) for row in rows)
        form = str if is_text else "{:.4g}".format
        columns.append(Column(key, TITLES.get(key, key), form, is_number=not is_text))
    return Table(columns=tuple(columns), rows=rows, notes=notes)


def _real_text(task: VideoTask, name: str) -> str | None:
    """Return the mean and the standard deviation of real trials, if any."""
    real = task.real.get(name)
    return real and "{:.4g} +- {:.2g}".format(*real)


def task_table() -> Table:
    """Return the tasks with object, scale, and values of the law and of real trials."""
    rows = []
    for task in video_tasks():
        law = [f"{TITLES[name]} {value:g}" for name, value in task.law.items()]
        real = [f"{TITLES[name]} {_real_text(task, name)}" for name in task.real]
        row = {
            "task": task.id,
            "motion": task.motion.value,
            "size_mm": 1000.0 * task.size_m,
            "size_px": task.size_px,
            "law": ", ".join(law),
            "real": ", ".join(real),
        }
        rows.append(row)
    return _table(rows)


def verdict(result: VideoScore) -> str:
    """Return whether a track is accepted, and the frames of the fit."""
    span = result.interval_frames
    frames = f"frames {span[0]} to {span[1]} are" if span else "no frame is"
    return f"the track is {'accepted' if result.is_sound else 'rejected'}; {frames} retained"


def _acceleration(result: VideoScore, task: VideoTask) -> Iterator[str]:
    """Yield the acceleration of an accepted track, compared with real trials or else with the law."""
    value = result.metrics.get("acceleration_m_s2")
    if value is None or not result.is_sound:
        return
    expected, sigma = task.real.get("a", (task.law["a"], 0.0))
    tolerance = max(2.0 * sigma, ACCELERATION_ERROR * expected)
    low, high = result.uncertainty["acceleration_m_s2"] or (value, value)
    speed = "as fast as it should"
    if low > expected + tolerance:
        speed = "too fast"
    elif high < expected - tolerance:
        speed = "too slow"
    unit = "g" if task.motion is MotionKind.FALL else "of the real acceleration"
    yield f"{task.motion}s with {value / expected:.2f} {unit}: {speed}"


def score_document(result: VideoScore, task: VideoTask) -> Document:
    """Return the result of one video: verdict, reasons, and metrics with intervals.

    Args:
        result: The result.
        task: Task with the law and the real trials.
    """
    rows = []
    paper_names = {better: name for name, better in UNBIASED.items()}
    for name, value in result.metrics.items():
        if value is not None and name not in UNBIASED:
            interval = result.uncertainty[name]
            key = paper_names.get(name, name)
            row = {
                "metric": TITLES.get(name, name),
                "video": value,
                "interval": interval and "{:.4g} to {:.4g}".format(*interval),
                "law": task.law.get(key),
                "real": _real_text(task, key),
            }
            rows.append(row)
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel"
    notes = [VERDICT_NOTE] if result.is_sound else []
    title = Paragraph(f"{result.video}, {result.task}: {verdict(result)}; {scale}")
    remarks = Bullets(
        (*_acceleration(result, task), *notes, *result.reasons, *result.findings)
    )
    tables = [_table(rows)] if rows else []
    return Document(parts=(title, remarks, *tables), rows=[result.to_dict()])


def model_table(clips: Clips) -> Table:
    """Return Table 3 of the paper: a row for each task and metric, a column for each model.

    A model of the paper, as `cosmos3_nano_negative`, has its published values beside. A note names those that differ.
    """
    results: dict[tuple[str, str], list[VideoScore | None]] = {}
    for model, task, _, result in clips:
        results.setdefault((model, task), []).append(result)
    models = dict.fromkeys(model for model, _ in results)
    is_new = not any(model in published_models() for model in models)
    scored = {task for _, task in results}
    rows: list[Row] = []
    is_near: dict[str, bool] = {}
    for shown in video_tasks():
        if shown.id not in scored:
            continue
        for paper_name, law in shown.law.items():
            name = UNBIASED.get(paper_name, paper_name) if is_new else paper_name
            row: Row = {"task": shown.id, "metric": TITLES[name], "law": law}
            for model in models:
                of_model = results.get((model, shown.id), [])
                values = _sound_values(name, of_model)
                row[model] = _mean_text(values, len(of_model))
                if model not in published_models():
                    continue
                paper = published_values()[shown.id, name].get(model)
                row[f"{model}, paper"] = paper
                if paper is not None and values:
                    near = math.isclose(np.mean(values), paper, rel_tol=DIFFERENCE)
                    is_near[f"{model} {shown.id} {TITLES[name]}"] = near
            rows.append(row)
    return _table(rows, VALUES_NOTE, *_differences(is_near))


def _differences(is_near: Mapping[str, bool]) -> Iterator[str]:
    """Yield a sentence on the values that differ from the published ones, if any was published."""
    far = [name for name, near in is_near.items() if not near]
    if is_near:
        names = ": " + ", ".join(far) if far else ""
        yield (
            f"{len(far)} of {len(is_near)} values differ from those of the paper by more than "
            f"{100 * DIFFERENCE:.0f} %{names}."
        )


def _mean_text(values: Sequence[float], count: int) -> str | None:
    """Return the mean over accepted tracks, and their number of all clips; None without clips."""
    if not count:
        return None
    mean = f"{np.mean(values):.4g} " if values else ""
    return f"{mean}({len(values)} of {count})"


def _sound_values(name: str, clips: Sequence[VideoScore | None]) -> list[float]:
    """Return a metric of the clips with accepted tracks."""
    sound = [clip.metrics[name] for clip in clips if clip and clip.is_sound]
    return [value for value in sound if value is not None]


# --- page ------------------------------------------------------------------------------------------------------------


def find_videos(folder: Path) -> tuple[list[tuple[str, str, Path]], list[Path]]:
    """Return model, task and file of videos `MODEL/TASK.mp4` and `MODEL/TASK/seed_1.mp4`, and all misnamed files.

    The track of a video in the same folder is left out.

    Raises:
        VideoError: The folder has no such video.
    """
    tasks = [task.id for task in video_tasks()]
    videos, misnamed = [], []
    for file in sorted(filter(Path.is_file, folder.rglob("[!.]*"))):
        model, task, *_ = (*file.relative_to(folder).with_suffix("").parts, "")
        if task not in tasks or file.suffix not in (*VIDEO_SUFFIXES, *TRACK_SUFFIXES):
            misnamed.append(file)
        elif file.suffix not in TRACK_SUFFIXES or video_of(file) is None:
            videos.append((model, task, file))
    if not videos:
        raise VideoError(
            f"{folder}: no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    return sorted(videos, key=lambda video: tasks.index(video[1])), misnamed


def video_page(clips: Clips, table: Table) -> str:
    """Return a self-contained page of many videos: the table, and the followed object in each clip."""
    parts: list[Part] = [table]
    for model, task, file, result in clips:
        if result is not None:
            parts += [
                Heading(f"{task}, {model}, {file.stem}"),
                Paragraph(verdict(result)),
                Bullets((*result.reasons, *result.findings)),
            ]
            if file.suffix not in TRACK_SUFFIXES:
                data = b64encode(track_picture(result, file)).decode()
                source = f"data:image/jpeg;base64,{data}"
                parts.append(element("img", alt="the track", src=source))
    return page("Videos and the laws of motion", parts, look="full")


def track_picture(result: VideoScore, file: Path) -> bytes:
    """Return the last retained frame of a video on the reference grid, with the track and a ring, as JPEG."""
    track = result.track
    first, last = result.interval_frames or (0, int(track.frames[-1]))
    picture: Picture = next(islice(FileFrames(file), last, None))
    drawn = track.registration.applied(picture)
    for row in np.flatnonzero(track.is_found & (track.frames <= last)):
        color = RETAINED if track.frames[row] >= first else DROPPED
        place_px = track.points_px[row].round().astype(int)
        radius_px = 12 if track.frames[row] == last else 2
        cv2.circle(drawn, place_px, radius_px, color, 2)
    content: bytes = cv2.imencode(".jpg", drawn)[1].tobytes()
    return content
