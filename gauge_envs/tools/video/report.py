"""Report scores of videos: tables with published values, a page, and overlays."""

import csv
import io
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy import stats

from gauge_envs.errors import VideoError, needs_extra
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.html import element
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.video.frames import FileFrames, Picture, cv2
from gauge_envs.tools.video.scoring import METRICS, VideoScore
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    VideoTask,
    published_results,
    video_task,
    video_tasks,
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
    "low": "95 % from",
    "high": "to",
    "real": "real trials",
}
"""Titles of metrics and columns that differ from their names."""

VERDICT_NOTE = (
    "On unknown renderers, about one in ten sound tracks of version 0.3.0 was wrong (77 of 665). Check which object "
    "was followed."
)
"""Reliability of the verdict of a track."""

VALUES_NOTE = (
    f"{VERDICT_NOTE} "
    "Mean over the clips (seeds) with sound tracks, and their share. Interval of 95 %: Student's t for the mean; "
    "simulated tracks for a single clip. The paper defines a and the metrics in capitals. Published: GAUGE, arXiv "
    "2608.05948, Table 3. Law: ideal motion with the calibrated constants, Table 3. The paper does not publish the "
    "frames of its fits."
)

VIDEO_SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")
"""Suffixes of videos; tracks have `.csv`."""

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
    return None if real is None else f"{real.mean:.4g} +- {real.std:.2g}"


def task_table(tasks: Iterable[VideoTask]) -> Table:
    """Return the tasks with object, scale, and values of the law and of real trials."""
    rows = []
    for task in tasks:
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
    """Return whether a track is sound, and the frames of the fit."""
    span = result.interval_frames
    frames = f"frames {span[0]} to {span[1]} are" if span else "no frame is"
    return f"the track is {'' if result.is_sound else 'not '}sound; {frames} retained"


def score_document(result: VideoScore, task: VideoTask) -> Document:
    """Return the result of one video: verdict, reasons, and metrics with intervals.

    Args:
        result: The result.
        task: Task with the law and the real trials.
    """
    rows = []
    for name, value in result.metrics.items():
        if value is not None:
            interval = result.uncertainty[name]
            row = {
                "metric": TITLES.get(name, name),
                "video": value,
                "interval": interval and "{:.4g} to {:.4g}".format(*interval),
                "law": task.law.get(name),
                "real": _real_text(task, name),
            }
            rows.append(row)
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel"
    notes = [VERDICT_NOTE] if result.is_sound else []
    parts: list[Part] = [
        Paragraph(f"{result.video}, {result.task}: {verdict(result)}; {scale}")
    ]
    for text in (*notes, *result.reasons, *result.findings):
        parts.append(Paragraph(f"  {text}"))
    if rows:
        parts.append(_table(rows))
    return Document(parts=parts, rows=[result.to_dict()])


def results_table(clips: Clips) -> Table:
    """Return a row for each model, task and metric: mean over sound clips, interval, published value."""
    seeds: dict[tuple[str, str], list[VideoScore | None]] = {}
    for model, task, _, result in clips:
        seeds.setdefault((model, task), []).append(result)
    rows = []
    for (model, task), results in seeds.items():
        published = published_results().get(model.replace("-", "_"), {}).get(task, {})
        for name in METRICS:
            row = _metric_row(name, video_task(task), results)
            if row["mean"] is not None or row["law"] is not None:
                first = {"model": model, "task": task}
                rows.append(first | row | {"published": published.get(name)})
    return _table(rows, VALUES_NOTE)


def _metric_row(name: str, task: VideoTask, seeds: list[VideoScore | None]) -> Row:
    """Return the mean of a metric over the seeds with sound tracks, and the value of the law."""
    sound = [seed for seed in seeds if seed is not None and seed.is_sound]
    values = [value for seed in sound if (value := seed.metrics[name]) is not None]
    mean = float(np.mean(values)) if values else None
    low, high = None, None
    if len(values) > 1:
        half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values)
        low, high = mean - half, mean + half
    elif values:
        # The interval of a single clip comes from simulated tracks.
        low, high = sound[0].uncertainty[name] or (None, None)
    return {
        "metric": TITLES.get(name, name),
        "clips": len(seeds),
        "sound": len(sound) / len(seeds),
        "mean": mean,
        "low": low,
        "high": high,
        "law": task.law.get(name),
    }


def summary_table(table: Table) -> Table:
    """Return Table 3 of the paper: a row for each task and metric, a column for each model."""
    shown = [row for row in table.rows if row["law"] is not None]
    models: Row = dict.fromkeys(row["model"] for row in shown)
    rows: dict[tuple[str, str], Row] = {}
    for row in shown:
        key = row["task"], row["metric"]
        empty = {"task": key[0], "metric": key[1], "law": row["law"], **models}
        rows.setdefault(key, empty)[row["model"]] = row["mean"]
    return _table([*rows.values()], VERDICT_NOTE)


def table_csv(table: Table) -> str:
    """Return the table as CSV with all digits; missing values are empty cells."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, table.rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(table.rows)
    return stream.getvalue()


# --- page ------------------------------------------------------------------------------------------------------------


def find_videos(folder: Path) -> tuple[list[tuple[str, str, Path]], list[Path]]:
    """Return model, task and file of videos `MODEL/TASK.mp4` and `MODEL/TASK/seed_1.mp4`, and all misnamed files.

    Tracks have the suffix `.csv`. The track of a video in the same folder is left out.

    Raises:
        VideoError: The folder has no such video.
    """
    tasks = [task.id for task in video_tasks()]
    videos, misnamed = [], []
    for file in sorted(filter(Path.is_file, folder.rglob("[!.]*"))):
        model, task, *_ = (*file.relative_to(folder).with_suffix("").parts, "")
        if task not in tasks or file.suffix not in (*VIDEO_SUFFIXES, ".csv"):
            misnamed.append(file)
        elif file.suffix != ".csv" or video_of(file) is None:
            videos.append((model, task, file))
    if not videos:
        raise VideoError(
            f"{folder}: no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    return sorted(videos, key=lambda video: tasks.index(video[1])), misnamed


def video_of(track: Path) -> Path | None:
    """Return the video with the name of a track, if any."""
    videos = (track.with_suffix(suffix) for suffix in VIDEO_SUFFIXES)
    return next(filter(Path.exists, videos), None)


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
            if file.suffix != ".csv":
                parts.append(_picture(result, file))
    return page("Videos and the laws of motion", parts, look="full")


def _picture(result: VideoScore, file: Path) -> Part:
    """Return the last relevant frame of a video with the drawn track."""
    last = (result.interval_frames or result.track.frames)[-1]
    *_, drawn = islice(drawn_frames(FileFrames(file), result), int(last) + 1)
    jpeg = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
    data = f"data:image/jpeg;base64,{b64encode(jpeg.tobytes()).decode()}"
    return element("img", alt=f"frame {last} with the track", src=data)


# --- the track in its video ------------------------------------------------------------------------------------------


def save_overlay(source: FileFrames, result: VideoScore, path: Path) -> Path:
    """Write a video with the drawn track, and return its path.

    Args:
        source: The scored video.
        result: Result of the video.
        path: File to write, MP4.
    """
    with needs_extra("a film", "video"):
        import imageio_ffmpeg
    writer = imageio_ffmpeg.write_frames(
        str(path), REFERENCE_SIZE_PX, fps=source.fps, ffmpeg_log_level="error"
    )
    writer.send(None)
    for picture in drawn_frames(source, result):
        writer.send(np.ascontiguousarray(picture[:, :, ::-1]))
    writer.close()
    return path


def drawn_frames(source: FileFrames, result: VideoScore) -> Iterator[Picture]:
    """Yield the frames of a video on the reference grid, with the drawn track and a ring at the object."""
    track = result.track
    first, last = result.interval_frames or (1, 0)
    for number, picture in enumerate(source):
        drawn = track.registration.applied(picture)
        # A track may leave frames out.
        row = max(0, int(np.searchsorted(track.frames, number, side="right")) - 1)
        for past in np.flatnonzero(track.is_found[: row + 1]):
            color = RETAINED if first <= track.frames[past] <= last else DROPPED
            place_px = track.points_px[past].round().astype(int)
            cv2.circle(drawn, place_px, 12 if past == row else 2, color, 2)
        yield drawn
