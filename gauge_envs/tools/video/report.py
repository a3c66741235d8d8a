"""Report the world-model track: tables of tasks and scores, agreement with published values, a page, and overlays."""

import csv
import io
import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy import stats

from gauge_envs.errors import VideoError
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.figures import embedded, legend_above, new_figure, tidy_axis
from gauge_envs.pages.html import Html, element
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.tools.video.frames import FileFrames, Frames, Picture, cv2
from gauge_envs.tools.video.scoring import METRICS, VideoScore
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    Measured,
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
}
"""Titles of the metrics by name."""

VERDICT_NOTE = (
    "On renderers that the rules had not met, about one in ten sound tracks was wrong (77 of 665): look at what was "
    "followed."
)
"""Reliability of the verdict of a track."""

VALUES_NOTE = (
    f"{VERDICT_NOTE} "
    "Mean over the clips (seeds) of a model whose track is sound, and their share. Interval of 95 %: of the mean by "
    "Student's t; of one clip, of simulated tracks. Spread: standard deviation over seeds. Metrics in capitals and a: "
    "as the paper defines them. Published: GAUGE, arXiv 2608.05948, Table 3. Law: of the ideal motion with the "
    "calibrated constants, Table 3 again. Real trials: mean of motion-capture trials. Agrees: all values of a clip are "
    "within 10 % of the published ones. The paper does not publish the frames of its fits."
)

CLOSE = 0.1
"""Largest relative difference with which a value agrees with a published one."""

VIDEO_SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")
"""Suffixes of videos; a track has `.csv`."""

PICTURES, PICTURE_SIZE_PX = 6, (416, 240)
"""Frames of a video that the page shows, and their size."""

RETAINED, DROPPED, PRESENT = (80, 200, 80), (150, 150, 150), (60, 60, 230)
"""Colours in blue, green and red: of retained places, of dropped ones, and of the present place."""

Results: TypeAlias = Mapping[tuple[str, str], Mapping[Path, VideoScore | None]]
"""Results of the clips by model and task; None for a clip that cannot be scored."""


# --- tables ----------------------------------------------------------------------------------------------------------


def short_text(value: float) -> str:
    """Return a value with four digits."""
    return f"{value:.4g}"


def measured_text(value: Measured) -> str:
    """Return the mean and the standard deviation of real trials."""
    return f"{value.mean:.4g} +- {value.std:.2g}"


def _number(key: str, title: str = "") -> Column:
    """Return a column of numbers, whose title is the key if none is given."""
    return Column(key, title or key, short_text, is_number=True)


def task_table(tasks: Iterable[VideoTask]) -> Table:
    """Return the tasks with their object, scale, and the values of the law and of real trials."""
    columns = (
        Column("task", "task"),
        Column("motion", "motion"),
        _number("size_mm", "object [mm]"),
        _number("size_px", "object [px]"),
        Column("law", "law"),
        Column("real", "real trials"),
    )
    rows = []
    for task in tasks:
        law = [f"{TITLES[name]} {value:g}" for name, value in task.law.items()]
        real = [f"{TITLES[name]} {measured_text(x)}" for name, x in task.real.items()]
        rows.append(
            {
                "task": task.id,
                "motion": task.motion.value,
                "size_mm": 1000.0 * task.size_m,
                "size_px": task.size_px,
                "law": ", ".join(law),
                "real": ", ".join(real),
            }
        )
    return Table(columns=columns, rows=rows)


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
    rows = [
        {
            "metric": TITLES[name],
            "video": value,
            "interval": result.uncertainty[name],
            "law": task.law.get(name),
            "real": task.real.get(name),
        }
        for name, value in result.metrics.items()
        if value is not None
    ]
    columns = (
        Column("metric", "metric"),
        _number("video"),
        Column("interval", "95 % interval", lambda x: f"{x[0]:.4g} to {x[1]:.4g}"),
        _number("law"),
        Column("real", "real trials", measured_text),
    )
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel"
    texts = [VERDICT_NOTE] * result.is_sound + [*result.reasons, *result.findings]
    parts: list[Part] = [
        Paragraph(f"{result.video}, {result.task}: {verdict(result)}; {scale}"),
        *(Paragraph(f"  {text}") for text in texts),
    ]
    if rows:
        parts.append(Table(columns=columns, rows=rows))
    return Document(parts=tuple(parts), rows=[result.to_dict()])


def agreement(result: VideoScore, published: Mapping[str, float]) -> str:
    """Return whether the metrics of a clip agree with the published ones of the same clip."""
    if not result.is_sound:
        return "track not sound"
    is_close, is_within = True, True
    for name, value in published.items():
        low, high = result.uncertainty[name] or (np.inf, -np.inf)
        is_within = is_within and low <= value <= high
        difference = abs((result.metrics[name] or 0.0) - value)
        is_close = is_close and difference <= CLOSE * abs(value)
    if is_close:
        return "agrees"
    return "within the interval" if is_within else "differs"


def results_table(results: Results) -> Table:
    """Return a row for each model, task and metric: the mean over sound clips, its interval, and the published value.

    The other models of the published table have rows too.
    """
    published = published_results()
    rows: list[dict[str, Any]] = []
    shown = {model.replace("-", "_") for model, _ in results}
    tasks = dict.fromkeys(task for _, task in results)
    others = [(m, task) for m in published if m not in shown for task in tasks]
    for model, task in (*results, *others):
        clips = list(results.get((model, task), {}).values())
        known = published.get(model.replace("-", "_"), {}).get(task, {})
        rows += _metric_rows(model, video_task(task), clips, known)
    columns = (
        Column("model", "model"),
        Column("task", "task"),
        Column("metric", "metric"),
        Column("sound", "sound", "{:.0%}".format, is_number=True),
        _number("mean"),
        _number("low", "95 % from"),
        _number("high", "to"),
        *map(_number, ("spread", "law", "real", "published", "clips")),
        Column("agrees", "agrees", place=Place.BELOW),
    )
    return Table(columns=columns, rows=rows, notes=(VALUES_NOTE,))


def _metric_rows(
    model: str,
    task: VideoTask,
    clips: list[VideoScore | None],
    published: Mapping[str, float],
) -> Iterator[dict[str, Any]]:
    """Yield the row of each metric that clips have or that the law states."""
    sound = [clip for clip in clips if clip is not None and clip.is_sound]
    # The agreement of all metrics of the only clip is in the first row.
    clip = clips[0] if len(clips) == 1 else None
    agrees = agreement(clip, published) if clip and published else None
    for name in METRICS:
        values = [value for clip in sound if (value := clip.metrics[name]) is not None]
        if not values and name not in task.law:
            continue
        row = dict.fromkeys(("mean", "low", "high", "spread"))
        if values:
            row["mean"] = mean = float(np.mean(values))
            row["low"], row["high"] = sound[0].uncertainty[name] or (None, None)
        if len(values) > 1:
            half = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
            row["low"], row["high"] = mean - half, mean + half
            row["spread"] = float(np.std(values, ddof=1))
        yield row | {
            "model": model,
            "task": task.id,
            "metric": TITLES[name],
            "sound": len(sound) / len(clips) if clips else None,
            "law": task.law.get(name),
            "real": task.real[name].mean if name in task.real else None,
            "published": published.get(name),
            "clips": len(clips) or None,
            "agrees": agrees,
        }
        agrees = None


def summary_table(table: Table) -> Table:
    """Return the metrics of the paper as in its Table 3: a row for each task and metric, a column for each model."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for row in table.rows:
        if row["clips"] and row["law"] is not None:
            place = (row["task"], row["metric"])
            rows.setdefault(place, dict(row))[row["model"]] = row["mean"]
    models = dict.fromkeys(row["model"] for row in table.rows if row["clips"])
    columns = [Column("task", "task"), Column("metric", "metric")]
    columns += map(_number, ("law", *models))
    notes = (VERDICT_NOTE,)
    return Table(columns=tuple(columns), rows=list(rows.values()), notes=notes)


def table_csv(table: Table) -> str:
    """Return the values with full digits, below the keys of the columns; a missing value is an empty cell."""
    stream = io.StringIO()
    keys = [column.key for column in table.columns]
    writer = csv.DictWriter(stream, keys, lineterminator="\n")
    writer.writeheader()
    writer.writerows(table.rows)
    return stream.getvalue()


def table_latex(table: Table) -> str:
    """Return the table as a LaTeX `tabular`, with all columns."""
    rows = [[column.label for column in table.columns]]
    rows += [[column.text(row) for column in table.columns] for row in table.rows]
    special = re.compile(r"([&%$#_{}^])")
    lines = [" & ".join(special.sub(r"\\\1", x) for x in cells) for cells in rows]
    body = "\n".join(f"{line} \\\\" for line in lines)
    layout = "".join("r" if column.is_number else "l" for column in table.columns)
    return f"\\begin{{tabular}}{{{layout}}}\n{body}\n\\end{{tabular}}\n"


# --- page ------------------------------------------------------------------------------------------------------------


def find_videos(folder: Path) -> tuple[list[tuple[str, str, Path]], list[Path]]:
    """Return model, task and file of the videos `MODEL/TASK.mp4` and `MODEL/TASK/seed_1.mp4`, and all other files.

    A track has the suffix `.csv`; the track of a video in the same folder is left out.

    Raises:
        VideoError: There is no such video.
    """
    tasks = [task.id for task in video_tasks()]
    suffixes = "|".join((*VIDEO_SUFFIXES, ".csv"))
    pattern = f"([^/]+)/({'|'.join(tasks)})(/seed_[0-9]+)?({suffixes})"
    videos, others = [], []
    for file in sorted(filter(Path.is_file, folder.rglob("[!.]*"))):
        parts = re.fullmatch(pattern, file.relative_to(folder).as_posix())
        if parts is None:
            others.append(file)
        elif parts[4] != ".csv" or video_of(file) is None:
            videos.append((parts[1], parts[2], file))
    if not videos:
        raise VideoError(
            f"{folder}: it contains no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    return sorted(videos, key=lambda video: (tasks.index(video[1]), video[0])), others


def video_of(track: Path) -> Path | None:
    """Return the video that has the name of a track; None where there is none."""
    videos = (track.with_suffix(suffix) for suffix in VIDEO_SUFFIXES)
    return next(filter(Path.exists, videos), None)


def video_page(results: Results, table: Table) -> str:
    """Return the page of many videos: the table, and what was followed in each clip. It needs no other file."""
    parts: list[Part] = [table]
    for (model, task), clips in results.items():
        for file, clip in clips.items():
            if clip is not None:
                parts += [
                    Heading(f"{task}, {model}, {file.stem}"),
                    Paragraph(verdict(clip)),
                    Bullets((*clip.reasons, *clip.findings)),
                    element("div", *_pictures(clip, file), class_="strip"),
                    _curve(clip),
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
    limits = axis.get_ylim()
    if "release_s" in result.details:
        since_s = np.maximum(track.times_s - result.details["release_s"], 0.0)
        law_mm = 500.0 * law["a"] * since_s**2
        axis.plot(track.times_s, law_mm, ls="--", label="law")
    axis.set(
        xlabel="time [s]", ylabel="distance from the first place [mm]", ylim=limits
    )
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
    """Yield the frames of a video on the reference grid, with the track drawn into them."""
    track = result.track
    first, last = result.interval_frames or (1, 0)
    for number, picture in enumerate(source.pictures(track.registration)):
        drawn = picture.copy()
        # A frame that repeats a picture shows the place of the one before.
        row = max(0, int(np.searchsorted(track.frames, number, side="right")) - 1)
        places_px = track.shown_px(row)
        for past in np.flatnonzero(track.is_found[: row + 1]):
            place_px = places_px[past].round().astype(int)
            color = RETAINED if first <= track.frames[past] <= last else DROPPED
            cv2.circle(drawn, place_px, 2, color, -1)
            if past == row:
                cv2.drawMarker(drawn, place_px, PRESENT, cv2.MARKER_CROSS, 22, 2)
        text = f"frame {number}, confidence {track.confidence[row]:.2f}"
        cv2.putText(drawn, text, (10, 470), cv2.FONT_HERSHEY_SIMPLEX, 0.5, PRESENT)
        yield drawn
