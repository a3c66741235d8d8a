"""The world-model track in words, on a page and drawn into its videos: tasks, and scores with their intervals."""

import csv
import io
import math
import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy.special import stdtrit

from gauge_envs.errors import VideoError
from gauge_envs.pages.document import Document, Heading, Paragraph, Part
from gauge_envs.pages.figures import OURS, embedded, legend_above, new_figure, tidy_axis
from gauge_envs.pages.html import Html, element, join, listed
from gauge_envs.pages.page import page
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video import (
    METRICS,
    VideoScore,
    VideoTask,
    video_task,
    video_tasks,
)
from gauge_envs.tools.video.agreement import agreement
from gauge_envs.tools.video.frames import FileFrames, Frames, Picture, cv2
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    Measured,
    published_results,
)
from gauge_envs.tools.video.track import GIVEN
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


VERDICT_NOTE = "Of drawn clips of a new kind, 16 of 100 sound tracks were wrong: look at what was followed."
"""How far the verdict of a track can be trusted."""


def task_table(tasks: Iterable[VideoTask]) -> Table:
    """Return the tasks with their object, scale, and the values of the law and of real trials."""
    return Table(
        columns=(
            Column("task", "task"),
            Column("motion", "motion"),
            Column("size_mm", "object", unit="mm", is_number=True),
            Column("size_px", "object", unit="px", is_number=True),
            Column("law", "law"),
            Column("real", "real trials"),
        ),
        rows=[
            {
                "task": task.id,
                "motion": task.motion.value,
                "size_mm": 1000.0 * task.size_m,
                "size_px": task.size_px,
                "law": ", ".join(
                    f"{TITLES[name]} {value:g}" for name, value in task.law.items()
                ),
                "real": ", ".join(
                    f"{TITLES[name]} {measured_text(value)}"
                    for name, value in task.real.items()
                ),
            }
            for task in tasks
        ],
    )


def score_document(result: VideoScore, task: VideoTask) -> Document:
    """Return the result of one video: its grade with the reasons, and each metric with its interval.

    Args:
        result: The result.
        task: Task whose law and real trials stand beside it.
    """
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel of the first frame"
    said = (*result.reasons, *result.findings)
    if result.is_sound and GIVEN not in result.findings:
        said = (VERDICT_NOTE, *said)
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
    table = Table(
        columns=(
            Column("metric", "metric"),
            Column("video", "video", short_text, is_number=True),
            Column("interval", "95 % interval", interval_text),
            Column("law", "law", short_text, is_number=True),
            Column("real", "real trials", measured_text, is_number=True),
        ),
        rows=rows,
    )
    return Document(
        parts=(
            Paragraph(f"{result.video}, {result.task}: {verdict(result)}; {scale}"),
            *(Paragraph(f"  {text}") for text in said),
            *([table] if rows else []),
        ),
        rows=[result.to_dict()],
    )


def verdict(result: VideoScore) -> str:
    """Return whether a track is sound, the frames that a law was fitted to, and how the video lies on the grid."""
    text = f"the track is {'' if result.is_sound else 'not '}sound; "
    span, registration = result.interval_frames, result.track.registration
    text += f"frames {span[0]} to {span[1]} are" if span else "no frame is"
    return f"{text} retained" + (
        f"; registered by {registration.method}" if registration else ""
    )


def short_text(value: float) -> str:
    """Return a value with four digits."""
    return f"{value:.4g}"


def measured_text(value: Measured) -> str:
    """Return the mean and the standard deviation of real trials."""
    return f"{short_text(value.mean)} +- {value.std:.2g}"


def interval_text(interval: tuple[float, float]) -> str:
    """Return both ends of an interval."""
    return f"{interval[0]:.4g} to {interval[1]:.4g}"


# --- page ------------------------------------------------------------------------------------------------------------

VIDEO_SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")
"""Suffixes of videos; a track has `.csv`."""

PICTURES = 6
"""Frames of a video that the page shows."""

PICTURE_WIDTH_PX = 416

VALUES_NOTE = (
    f"{VERDICT_NOTE} "
    "Mean over the clips (seeds) of a model whose track is sound, and their share. Interval of 95 %: of the mean by "
    "Student's t; of one clip, of simulated tracks. Spread: standard deviation over seeds. Metrics in capitals and a: "
    "as the paper defines them. Published: GAUGE, arXiv 2608.05948, Table 3. Law: of the ideal motion with the "
    "calibrated constants, Table 3 again. Real trials: mean of motion-capture trials. Agrees: all values of a clip "
    "within 10 % of the published ones. The paper does not publish its frames: values that hold in frames near those "
    "that are retained here, and not for other clips, say that it took those frames."
)


Results: TypeAlias = Mapping[tuple[str, str], Mapping[Path, VideoScore | None]]
"""Results of the clips by model and task; None for a clip that cannot be judged."""


def find_videos(folder: Path) -> tuple[list[tuple[str, str, Path]], list[Path]]:
    """Return model, task and file of the videos `MODEL/TASK.mp4` and `MODEL/TASK/seed_1.mp4`, and all other files.

    A track has the suffix `.csv`; that of a video lies beside it and is left out.
    """
    tasks = [task.id for task in video_tasks()]
    found, others = [], []
    for file in sorted(folder.rglob("*")):
        if not file.is_file() or file.name.startswith("."):
            continue
        name = file.relative_to(folder).with_suffix("").as_posix()
        parts = re.fullmatch("([^/]+)/([^/]+)(/seed_[0-9]+)?", name)
        is_known = file.suffix.lower() in (*VIDEO_SUFFIXES, ".csv")
        if not parts or parts[2] not in tasks or not is_known:
            others.append(file)
        elif file.suffix != ".csv" or not videos_beside(file):
            found.append((parts[1], parts[2], file))
    if not found:
        raise VideoError(
            f"{folder}: it holds no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    return sorted(found, key=lambda one: (tasks.index(one[1]), one[0])), others


def videos_beside(track: Path) -> list[Path]:
    """Return the videos that have the name of a track."""
    videos = [track.with_suffix(suffix) for suffix in VIDEO_SUFFIXES]
    return [video for video in videos if video.exists()]


def results_table(results: Results) -> Table:
    """Return a row for each model, task and metric: the mean over sound clips, its worth, and the published value."""
    published = published_results()
    shown = {model.replace("-", "_") for model, _ in results}
    tasks = dict.fromkeys(task for _, task in results)
    others = [(m, task) for m in published if m not in shown for task in tasks]
    rows: list[dict[str, Any]] = []
    for model, task in (*results, *others):
        clips = results.get((model, task), {})
        sound = [one for one in clips.values() if one is not None and one.is_sound]
        known = published.get(model.replace("-", "_"), {}).get(task, {})
        law, real = video_task(task).law, video_task(task).real
        text = _agreement(model, task, clips) if known else None
        for name in METRICS:
            values = np.array([one.metrics[name] for one in sound], dtype=float)
            values = values[np.isfinite(values)]
            if not len(values) and name not in law:
                continue
            mean, low, high, spread = _mean(values, name, sound)
            rows.append(
                {
                    "model": model,
                    "task": task,
                    "metric": TITLES[name],
                    "sound": len(sound) / len(clips) if clips else None,
                    "mean": mean,
                    "low": low,
                    "high": high,
                    "spread": spread,
                    "law": law.get(name),
                    "real": real[name].mean if name in real else None,
                    "published": known.get(name),
                    "clips": len(clips) or None,
                    # What is said of all metrics of a clip stands once.
                    "agrees": text,
                }
            )
            text = None
    numbers = ("mean", "low", "high", "spread", "law", "real", "published", "clips")
    titles = {"low": "95 % from", "high": "to", "real": "real trials"}
    columns = (
        Column("model", "model"),
        Column("task", "task"),
        Column("metric", "metric"),
        Column("sound", "sound", "{:.0%}".format, is_number=True),
        *(
            Column(key, titles.get(key, key), short_text, is_number=True)
            for key in numbers
        ),
        Column("agrees", "agrees", place=Place.BELOW),
    )
    return Table(columns=columns, rows=rows, notes=(VALUES_NOTE,))


def table_csv(table: Table) -> str:
    """Return the values with full digits, below the keys of the columns; a missing value is an empty cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([column.key for column in table.columns])
    for row in table.rows:
        writer.writerow([column.value(row) for column in table.columns])
    return stream.getvalue()


def table_latex(table: Table) -> str:
    """Return the table as a LaTeX `tabular`, with all columns."""
    layout = "".join("r" if column.is_number else "l" for column in table.columns)
    rows = [[column.label for column in table.columns]]
    rows += [[column.text(row) for column in table.columns] for row in table.rows]
    lines = [f"\\begin{{tabular}}{{{layout}}}"]
    for cells in rows:
        escaped = [re.sub(r"([&%$#_{}^])", r"\\\1", cell) for cell in cells]
        lines.append(f"{' & '.join(escaped)} \\\\")
    return "\n".join([*lines, "\\end{tabular}\n"])


def _agreement(
    model: str, task: str, clips: Mapping[Path, VideoScore | None]
) -> str | None:
    """Return how the only clip of a published model agrees with its published values; None for several clips."""
    clip = next(iter(clips.values()), None)
    if clip is None or len(clips) > 1:
        return None
    others = {
        name: values.get(task, {}) for name, values in published_results().items()
    }
    known = others.pop(model.replace("-", "_"))
    return agreement(
        clip, video_task(task), known, [one for one in others.values() if one]
    )


def _mean(
    values: FloatArray, name: str, sound: list[VideoScore]
) -> tuple[float | None, float | None, float | None, float | None]:
    """Return the mean of a metric over clips, both ends of its interval, and its spread; None where unknown."""
    if not len(values):
        return None, None, None, None
    mean = float(values.mean())
    if len(values) == 1:
        low, high = sound[0].uncertainty[name] or (None, None)
        return mean, low, high, None
    spread = float(values.std(ddof=1))
    half = float(stdtrit(len(values) - 1, 0.975)) * spread / math.sqrt(len(values))
    return mean, mean - half, mean + half, spread


def video_page(results: Results, table: Table) -> str:
    """Return the page of many videos with the table of their results, without any other file."""
    parts: list[Part] = [table]
    last = ""
    for (model, task), clips in results.items():
        parts += [Heading(task)] if task != last else []
        parts += [
            _clip(model, one, file) for file, one in clips.items() if one is not None
        ]
        last = task
    return page("Videos and the laws of motion", parts, look="full")


def _clip(model: str, result: VideoScore, file: Path) -> Html:
    is_film = file.suffix != ".csv"
    shown = _pictures(result, file) if is_film else ()
    pictures = element("div", *shown, class_="strip")
    name = model if file.stem == result.task else f"{model}, {file.stem}"
    return join(
        [
            element("p", element("b", name), f": {verdict(result)}"),
            listed((*result.reasons, *result.findings)),
            pictures,
            _curve(result),
        ]
    )


def _curve(result: VideoScore) -> Html:
    """Return the way of an object over time, and that of the law where it is released from rest."""
    track, law = result.track, video_task(result.task).law
    figure = new_figure(5.0, 2.8)
    axis = figure.subplots()
    places_mm = 1e3 * result.scale_m_per_px * track.points_px
    first_mm = places_mm[track.is_found][:1]
    if len(first_mm):
        way_mm = np.linalg.norm(places_mm - first_mm, axis=1)
        axis.plot(track.times_s, way_mm, color=OURS[1], label="track")
        release_s = result.details.get("release_s", math.inf)
        since_s = np.maximum(track.times_s - release_s, 0.0)
        lawful_mm = 500.0 * law.get("a", math.nan) * since_s**2
        lawful_mm[lawful_mm > np.nanmax(way_mm)] = np.nan
        axis.plot(track.times_s, lawful_mm, color=OURS[2], ls="--", label="law")
        legend_above(axis)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("way from the first place [mm]")
    tidy_axis(axis)
    return embedded(figure, "way of the object over time")


def _pictures(result: VideoScore, file: Path) -> Iterator[Html]:
    """Yield frames of a video with the track drawn into them."""
    first, last = result.interval_frames or (0, len(result.track.frames) - 1)
    wanted = set(np.linspace(first, last, PICTURES).astype(int).tolist())
    for number, picture in enumerate(
        drawn_frames(FileFrames(file, fps=result.track.fps), result)
    ):
        if number not in wanted:
            continue
        height = round(picture.shape[0] * PICTURE_WIDTH_PX / picture.shape[1])
        small = cv2.resize(
            picture, (PICTURE_WIDTH_PX, height), interpolation=cv2.INTER_AREA
        )
        _, packed = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])
        source = f"data:image/jpeg;base64,{b64encode(packed.tobytes()).decode('ascii')}"
        yield element("img", loading="lazy", alt=f"frame {number}", src=source)


# --- the track in its video ------------------------------------------------------------------------------------------

COUNTED = (80, 200, 80)
DROPPED = (150, 150, 150)
MARKED = (60, 60, 230)
"""Colours in blue, green and red: of retained places, of dropped ones, and of the present place."""


def save_overlay(source: Frames, result: VideoScore, path: Path) -> Path:
    """Write a video with the track, and return its path; its folder is created.

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
    for number, picture in enumerate(source.pictures(result.track.registration)):
        yield _drawn(picture, result, number)


def _drawn(picture: Picture, result: VideoScore, number: int) -> Picture:
    drawn = picture.copy()
    track, span = result.track, result.interval_frames
    # A frame that repeats a picture shows the place of the one before.
    row = max(0, int(np.searchsorted(track.frames, number, side="right")) - 1)
    places = track.shown_px(row)
    for frame, place in zip(track.frames[: row + 1], places, strict=False):
        if np.isfinite(place).all():
            counts = span is not None and span[0] <= frame <= span[1]
            cv2.circle(
                drawn,
                (round(place[0]), round(place[1])),
                2,
                COUNTED if counts else DROPPED,
                -1,
            )
    if np.isfinite(places[row]).all():
        x, y = places[row]
        cv2.drawMarker(drawn, (round(x), round(y)), MARKED, cv2.MARKER_CROSS, 22, 2)
    text = f"frame {number}, confidence {track.confidence[row]:.2f}"
    place = (10, drawn.shape[0] - 10)
    # White letters on black ones that are broader.
    for grey, width in ((0, 3), (255, 1)):
        font, color = cv2.FONT_HERSHEY_SIMPLEX, (grey, grey, grey)
        cv2.putText(drawn, text, place, font, 0.5, color, width, cv2.LINE_AA)
    return drawn
