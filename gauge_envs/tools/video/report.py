"""Report the world-model track: tables of tasks and scores, agreement with published values, a page, and overlays."""

import csv
import io
import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy import stats

from gauge_envs.errors import VideoError
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.figures import embedded, legend_above, new_figure, tidy_axis
from gauge_envs.pages.html import Html, element
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.video.frames import FileFrames, Frames, Picture, cv2
from gauge_envs.tools.video.scoring import METRICS, VideoScore
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    VideoTask,
    published_results,
    video_task,
    video_tasks,
)
from gauge_envs.tools.video.writer import film_writer

TITLES = {
    "a": "a [m/s^2]",
    "qfi": "QFI",
    "r2": "R^2",
    "pd": "PD [s]",
    "mte": "MTE",
    "de": "DE [N]",
    "acceleration_m_s2": "acceleration [m/s^2]",
    "form": "form",
    "size_mm": "object [mm]",
    "size_px": "object [px]",
    "interval": "95 % interval",
    "low": "95 % from",
    "high": "to",
    "real": "real trials",
}
"""Titles of metrics and columns by name."""

VERDICT_NOTE = (
    "On renderers that the rules had not met, about one in ten sound tracks of version 0.3.0 was wrong (77 of 665). "
    "Look at what was followed."
)
"""Reliability of the verdict of a track."""

VALUES_NOTE = (
    f"{VERDICT_NOTE} "
    "Mean over the clips (seeds) of a model whose track is sound, and their share. Interval of 95 %: of the mean by "
    "Student's t; of one clip, of simulated tracks. Spread: standard deviation over seeds. Metrics in capitals and a: "
    "as the paper defines them. Published: GAUGE, arXiv 2608.05948, Table 3. Law: of the ideal motion with the "
    "calibrated constants, Table 3 again. Real trials: mean of motion-capture trials. Agrees: the mean is "
    "within 10 % of the published value. The paper does not publish the frames of its fits."
)

CLOSE = 0.1
"""Largest relative difference with which a value agrees with a published one."""

VIDEO_SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")
"""Suffixes of videos; a track has `.csv`."""

PICTURES, PICTURE_SIZE_PX = 6, (416, 240)
"""Frames of a video that the page shows, and their size."""

RETAINED, DROPPED = (80, 200, 80), (150, 150, 150)
"""Colours in blue, green and red: of retained and of dropped places."""

Clips: TypeAlias = Sequence[tuple[str, str, Path, VideoScore | None]]
"""Model, task, file and result of each clip; no result for a clip that cannot be scored."""


# --- tables ----------------------------------------------------------------------------------------------------------


def _table(rows: list[dict[str, Any]], *notes: str) -> Table:
    """Return a table of rows with the same keys; a number has four digits."""
    columns = []
    for key in rows[0]:
        is_text = any(isinstance(row[key], str) for row in rows)
        form = str if is_text else "{:.4g}".format
        columns.append(Column(key, TITLES.get(key, key), form, is_number=not is_text))
    return Table(columns=tuple(columns), rows=rows, notes=notes)


def _real_text(task: VideoTask, name: str) -> str | None:
    """Return the mean and the standard deviation of real trials; None where there are none."""
    real = task.real.get(name)
    return None if real is None else f"{real.mean:.4g} +- {real.std:.2g}"


def task_table(tasks: Iterable[VideoTask]) -> Table:
    """Return the tasks with their object, scale, and the values of the law and of real trials."""
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
    """Return whether a track is sound, and which frames the law was fitted to."""
    span = result.interval_frames
    frames = f"frames {span[0]} to {span[1]} are" if span else "no frame is"
    return f"the track is {'' if result.is_sound else 'not '}sound; {frames} retained"


def score_document(result: VideoScore, task: VideoTask) -> Document:
    """Return the result of one video: its verdict with the reasons, and each metric with its interval.

    Args:
        result: The result.
        task: Task whose law and real trials are shown too.
    """
    rows = []
    for name, value in result.metrics.items():
        if value is not None:
            interval = result.uncertainty[name]
            row = {
                "metric": TITLES[name],
                "video": value,
                "interval": interval and "{:.4g} to {:.4g}".format(*interval),
                "law": task.law.get(name),
                "real": _real_text(task, name),
            }
            rows.append(row)
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel"
    is_given = any(event.kind == "given" for event in result.track.events)
    notes = [VERDICT_NOTE] if result.is_sound and not is_given else []
    parts: list[Part] = [
        Paragraph(f"{result.video}, {result.task}: {verdict(result)}; {scale}")
    ]
    for text in (*notes, *result.reasons, *result.findings):
        parts.append(Paragraph(f"  {text}"))
    if rows:
        parts.append(_table(rows))
    return Document(parts=parts, rows=[result.to_dict()])


def results_table(clips: Clips) -> Table:
    """Return a row for each model, task and metric: mean over sound clips, interval, and published value."""
    results: dict[tuple[str, str], list[VideoScore | None]] = {}
    for model, task, _, result in clips:
        results.setdefault((model, task), []).append(result)
    rows: list[dict[str, Any]] = []
    for (model, task), seeds in results.items():
        published = published_results().get(model.replace("-", "_"), {}).get(task, {})
        for name in METRICS:
            row = _metric_row(name, video_task(task), seeds, published.get(name))
            if row["mean"] is not None or row["law"] is not None:
                rows.append({"model": model, "task": task, **row})
    return _table(rows, VALUES_NOTE)


def _metric_row(
    name: str,
    task: VideoTask,
    seeds: list[VideoScore | None],
    published: float | None,
) -> dict[str, Any]:
    """Return the mean of a metric over the seeds whose track is sound, and what it is compared with."""
    sound = [seed for seed in seeds if seed is not None and seed.is_sound]
    values = [value for seed in sound if (value := seed.metrics[name]) is not None]
    mean, low, high, spread, agrees = None, None, None, None, None
    if values:
        mean = float(np.mean(values))
        # Of one clip, the interval is that of simulated tracks.
        low, high = sound[0].uncertainty[name] or (None, None)
        if published is not None:
            is_near = abs(mean - published) <= CLOSE * abs(published)
            agrees = "agrees" if is_near else "differs"
    if len(values) > 1:
        half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values)
        low, high = mean - half, mean + half
        spread = np.std(values, ddof=1)
    return {
        "metric": TITLES[name],
        "sound": len(sound) / len(seeds),
        "mean": mean,
        "low": low,
        "high": high,
        "spread": spread,
        "law": task.law.get(name),
        "real": task.real[name].mean if name in task.real else None,
        "published": published,
        "clips": len(seeds),
        "agrees": agrees,
    }


def summary_table(table: Table) -> Table:
    """Return the metrics of the paper as in its Table 3: a row for each task and metric, a column for each model."""
    shown = [row for row in table.rows if row["law"] is not None]
    models = dict.fromkeys(row["model"] for row in shown)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for row in shown:
        task, metric = row["task"], row["metric"]
        empty = {"task": task, "metric": metric, "law": row["law"], **models}
        rows.setdefault((task, metric), empty)[row["model"]] = row["mean"]
    return _table(list(rows.values()), VERDICT_NOTE)


def table_csv(table: Table) -> str:
    """Return the values with full digits, below the keys of the columns; a missing value is an empty cell."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, table.rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(table.rows)
    return stream.getvalue()


def table_latex(table: Table) -> str:
    """Return the table as a LaTeX `tabular`, with all columns."""
    columns = table.columns
    rows = [[column.label for column in columns]]
    rows += [[column.text(row) for column in columns] for row in table.rows]
    text = "\n".join("\t".join(cells) for cells in rows)
    text = re.sub(r"([&%$#_{}])", r"\\\1", text).replace("^2", "$^2$")
    body = text.replace("\t", " & ").replace("\n", " \\\\\n")
    layout = "".join("r" if column.is_number else "l" for column in columns)
    return f"\\begin{{tabular}}{{{layout}}}\n{body} \\\\\n\\end{{tabular}}\n"


# --- page ------------------------------------------------------------------------------------------------------------


def find_videos(folder: Path) -> tuple[list[tuple[str, str, Path]], list[Path]]:
    """Return model, task and file of the videos `MODEL/TASK.mp4` and `MODEL/TASK/seed_1.mp4`, and all other files.

    A track has the suffix `.csv`; the track of a video in the same folder is left out.

    Raises:
        VideoError: There is no such video.
    """
    tasks = [task.id for task in video_tasks()]
    videos, others = [], []
    for file in sorted(filter(Path.is_file, folder.rglob("[!.]*"))):
        names = file.relative_to(folder).with_suffix("").parts
        model, task, *_ = (*names, "")
        if task not in tasks or file.suffix not in (*VIDEO_SUFFIXES, ".csv"):
            others.append(file)
        elif file.suffix != ".csv" or video_of(file) is None:
            videos.append((model, task, file))
    if not videos:
        raise VideoError(
            f"{folder}: it contains no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    return sorted(videos, key=lambda video: tasks.index(video[1])), others


def video_of(track: Path) -> Path | None:
    """Return the video that has the name of a track; None where there is none."""
    videos = (track.with_suffix(suffix) for suffix in VIDEO_SUFFIXES)
    return next(filter(Path.exists, videos), None)


def video_page(clips: Clips, table: Table) -> str:
    """Return the page of many videos: the table, and what was followed in each clip. It needs no other file."""
    parts: list[Part] = [table]
    for model, task, file, result in clips:
        if result is not None:
            parts += [
                Heading(f"{task}, {model}, {file.stem}"),
                Paragraph(verdict(result)),
                Bullets((*result.reasons, *result.findings)),
                element("div", *_pictures(result, file), class_="strip"),
                _curve(result),
            ]
    return page("Videos and the laws of motion", parts, look="full")


def _curve(result: VideoScore) -> Html:
    """Return the displacement of an object over time, and the law where it is released from rest."""
    track, law = result.track, video_task(result.task).law
    figure = new_figure(5.0, 2.8)
    axis = figure.subplots()
    places_mm = 1e3 * result.scale_m_per_px * track.points_px
    away_mm = np.linalg.norm(places_mm - places_mm[track.is_found][:1], axis=1)
    axis.plot(track.times_s, away_mm, label="track")
    axis.set(xlabel="time [s]", ylabel="distance from the first place [mm]")
    if "release_s" in result.details:
        since_s = np.maximum(track.times_s - result.details["release_s"], 0.0)
        law_mm = 500.0 * law["a"] * since_s**2
        # The law may leave the picture.
        axis.set_ylim(axis.get_ylim())
        axis.plot(track.times_s, law_mm, ls="--", label="law")
    legend_above(axis)
    tidy_axis(axis)
    return embedded(figure, "displacement of the object over time")


def _pictures(result: VideoScore, file: Path) -> Iterator[Html]:
    """Yield frames of a video with the track drawn into them; none of a track without its video."""
    if file.suffix == ".csv":
        return
    first, last = result.interval_frames or (0, len(result.track.frames) - 1)
    wanted = np.linspace(first, last, PICTURES).astype(int)
    source = FileFrames(file, fps=result.track.fps)
    for number, picture in enumerate(drawn_frames(source, result)):
        if number in wanted:
            small = cv2.resize(picture, PICTURE_SIZE_PX, interpolation=cv2.INTER_AREA)
            jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
            data = f"data:image/jpeg;base64,{b64encode(jpeg.tobytes()).decode()}"
            yield element("img", loading="lazy", alt=f"frame {number}", src=data)


# --- the track in its video ------------------------------------------------------------------------------------------


def save_overlay(source: Frames, result: VideoScore, path: Path) -> Path:
    """Write a video with the track drawn into it, and return its path; its folder is created.

    Args:
        source: The video that was scored.
        result: Its result.
        path: File to write, MP4.
    """
    with film_writer(path, size=REFERENCE_SIZE_PX, fps=source.fps) as add:
        for picture in drawn_frames(source, result):
            add(picture[:, :, ::-1])
    return path


def drawn_frames(source: Frames, result: VideoScore) -> Iterator[Picture]:
    """Yield the frames of a video on the reference grid, with the track drawn into them and a ring at the object."""
    track = result.track
    first, last = result.interval_frames or (1, 0)
    for number, picture in enumerate(source.pictures(track.registration)):
        drawn = picture.copy()
        # A frame that repeats a picture shows the place of the one before.
        row = max(0, int(np.searchsorted(track.frames, number, side="right")) - 1)
        places_px = track.shown_px(row)
        for past in np.flatnonzero(track.is_found[: row + 1]):
            color = RETAINED if first <= track.frames[past] <= last else DROPPED
            radius_px = 12 if past == row else 2
            cv2.circle(drawn, places_px[past].round().astype(int), radius_px, color, 2)
        text = f"frame {number}, confidence {track.confidence[row]:.2f}"
        cv2.putText(drawn, text, (10, 470), cv2.FONT_HERSHEY_SIMPLEX, 0.5, DROPPED)
        yield drawn
