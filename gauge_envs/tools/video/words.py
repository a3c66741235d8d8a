"""The world-model track in words, on a page and drawn into its videos: tasks, and scores with their intervals."""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from gauge_envs.errors import VideoError
from gauge_envs.pages.document import Document, Heading, Paragraph, Part, page
from gauge_envs.pages.html import Html, below, element, join, listed
from gauge_envs.pages.table import Column, Table, grid
from gauge_envs.tools.video import METRICS, Grade, VideoScore, VideoTask, video_task, video_tasks
from gauge_envs.tools.video.frames import FileFrames, Frames, Picture, cv2, write_mp4
from gauge_envs.tools.video.tasks import published_results

TITLES = {
    "a_m_s2": "acceleration [m/s^2]",
    "qfi": "QFI",
    "r2": "R^2",
    "pd_s": "period [s]",
    "mte": "momentum transfer",
    "de_n": "dynamic error [N]",
    "form": "form",
}
"""Titles of the metrics by name."""


def task_table(tasks: Iterable[VideoTask]) -> Table:
    """Return the tasks with their object, scale and real values."""
    return Table(
        columns=(
            Column("task", "task"),
            Column("motion", "motion"),
            Column("size_mm", "object", unit="mm", is_number=True),
            Column("size_px", "object", unit="px", is_number=True),
            Column("metrics", "real values"),
        ),
        rows=[
            {
                "task": task.id,
                "motion": task.motion.value,
                "size_mm": 1000.0 * task.size_m,
                "size_px": task.size_px,
                "metrics": ", ".join(f"{TITLES[name]} {value:g}" for name, value in task.real.items()),
            }
            for task in tasks
        ],
    )


def score_document(result: VideoScore, real: Mapping[str, float]) -> Document:
    """Return the result of one video: its grade with the reasons, and each metric with its interval.

    Args:
        result: The result.
        real: Real values by the name of the metric.
    """
    scale = f"{1000.0 * result.scale_m_per_px:.3f} mm a pixel of the first frame"
    if result.track.registration is not None:
        scale += f"; registered by {result.track.registration.method}"
    known = [name for name in METRICS if result.metrics[name] is not None]
    table = Table(
        columns=(
            Column("", "metric", TITLES.__getitem__),
            Column("", "video", lambda name: short_text(result.metrics[name]), is_number=True),
            Column("", "95 % interval", lambda name: interval_text(result.uncertainty[name])),
            Column("", "real", lambda name: short_text(real[name]) if name in real else "-", is_number=True),
        ),
        rows=known,
    )
    return Document(
        parts=(
            Paragraph(f"{result.video}: {result.grade.value} for {result.task}; {span_text(result)}; {scale}"),
            *(Paragraph(f"  {reason}") for reason in result.reasons),
            *([table] if known else []),
        ),
        rows=[result.to_dict()],
    )


def span_text(result: VideoScore) -> str:
    """Return the frames that a law was fitted to."""
    span = result.interval_frames
    return "no frame is retained" if span is None else f"frames {span[0]} to {span[1]} are retained"


def short_text(value: float | None) -> str:
    """Return a value with four digits; a dash for None."""
    return "\u2013" if value is None else f"{value:.4g}"


def interval_text(interval: tuple[float, float] | None) -> str:
    """Return both ends of an interval; empty for None."""
    return "" if interval is None else f"{short_text(interval[0])} to {short_text(interval[1])}"


# --- page ------------------------------------------------------------------------------------------------------------

SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")

PICTURES = 6
"""Frames of a video that the page shows."""

PICTURE_WIDTH_PX = 416

LAYOUTS = {
    "stretch": "width and height scaled each on its own",
    "crop": "a crop of the first frame",
    "pad": "the first frame with a border",
    "first frame": "registered by points of the first frame",
}
"""How a video lies on the grid of the first frames, by the method of its registration."""

VALUES_NOTE = (
    "Below each value: the interval of 95 % of simulated tracks, and the published value where the folder has the name "
    "of a published model. Bold: nearest to the real value among the valid videos. Grey: doubtful."
)

PUBLISHED_NOTE = 'GAUGE, arXiv 2608.05948, Table 3. "negative" is with the negative prompt.'

Results = Mapping[tuple[str, str], VideoScore]
"""Results by model and task."""


def find_videos(folder: Path) -> tuple[list[tuple[str, str, Path]], list[Path]]:
    """Return the model, the task and the file of each video `<model>/<task>.mp4` in a folder, and the other videos."""
    tasks = {task.id: order for order, task in enumerate(video_tasks())}
    files = [file for file in sorted(folder.rglob("*")) if file.suffix.lower() in SUFFIXES]
    found = [
        (file.parent.name, file.stem, file) for file in files if file.parent.parent == folder and file.stem in tasks
    ]
    if not found:
        raise VideoError(
            f"{folder}: it holds no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    used = {file for *_, file in found}
    return sorted(found, key=lambda one: (tasks[one[1]], one[0])), [file for file in files if file not in used]


def video_page(results: Results, files: Mapping[tuple[str, str], Path]) -> str:
    """Return the page of many videos, without any other file.

    Args:
        results: Results by model and task.
        files: Video files by model and task.
    """
    models = list(dict.fromkeys(model for model, _ in results))
    tasks = list(dict.fromkeys(task for _, task in results))
    rows = [(task, name) for task in tasks for name in METRICS if name in video_task(task).real]
    parts: list[Part] = [
        element("p", VALUES_NOTE),
        _values_table(models, rows, results),
        Heading("Published models"),
        element("p", PUBLISHED_NOTE, class_="quiet"),
        _published_table(rows),
    ]
    for task in tasks:
        parts.append(Heading(task))
        parts += [
            _clip(model, results[model, task], files[model, task]) for model in models if (model, task) in results
        ]
    return page("Videos and the laws of motion", parts)


def _values_table(models: Sequence[str], rows: Sequence[tuple[str, str]], results: Results) -> Table:
    lines = []
    for task, name in rows:
        real = video_task(task).real[name]
        found = [results.get((model, task)) for model in models]
        valid = [one.metrics[name] for one in found if one is not None and one.grade is Grade.VALID]
        nearest = min(
            (value for value in valid if value is not None), key=lambda value: abs(value - real), default=None
        )
        cells = (_cell(model, one, name, nearest) for model, one in zip(models, found, strict=True))
        lines.append([join([task, below(TITLES[name]), below(f"real {short_text(real)}")]), *cells])
    return grid(("task", *models), lines, look="matrix")


def _cell(model: str, result: VideoScore | None, name: str, nearest: float | None) -> Html:
    if result is None:
        return Html("")
    grade, value, interval = result.grade, result.metrics[name], result.uncertainty[name]
    notes = [] if interval is None else [interval_text(interval)]
    if grade is not Grade.VALID and value is not None:
        notes.append(grade.value)
    known = published_results().get(model.replace("-", "_"), {})
    if (result.task, name) in known:
        notes.append(f"published {short_text(known[result.task, name])}")
    # The form improvement grows with the precision of the tracker, so it is no rank.
    is_best = grade is Grade.VALID and value is not None and value == nearest and name != "qfi"
    text = grade.value if value is None else short_text(value)
    return element("span", element("b", text) if is_best else text, *map(below, notes), class_=grade.value)


def _published_table(rows: Sequence[tuple[str, str]]) -> Table:
    published = published_results()
    lines = [
        [join([task, below(TITLES[name])]), *(short_text(known.get((task, name))) for known in published.values())]
        for task, name in rows
    ]
    return grid(("task", *published), lines, look="matrix")


def _clip(model: str, result: VideoScore, file: Path) -> Html:
    text = f": {result.grade.value}; {span_text(result)}"
    if result.track.registration is not None:
        text += f"; {LAYOUTS[result.track.registration.method]}"
    pictures = element("div", *_pictures(result, file), class_="strip")
    return join([element("p", element("b", model), text), listed(result.reasons), pictures])


def _pictures(result: VideoScore, file: Path) -> Iterator[Html]:
    """Yield frames of a video with the track drawn into them."""
    first, last = result.interval_frames or (0, len(result.track.frames) - 1)
    wanted = set(np.linspace(first, last, PICTURES).astype(int).tolist())
    for number, picture in enumerate(drawn_frames(FileFrames(file, fps=result.track.fps), result)):
        if number not in wanted:
            continue
        height = round(picture.shape[0] * PICTURE_WIDTH_PX / picture.shape[1])
        small = cv2.resize(picture, (PICTURE_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        _, packed = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])
        source = f"data:image/jpeg;base64,{b64encode(packed.tobytes()).decode('ascii')}"
        yield element("img", loading="lazy", alt=f"frame {number}", src=source)


# --- the track in its video ------------------------------------------------------------------------------------------

COUNTED = (80, 200, 80)
DROPPED = (150, 150, 150)
MARKED = (60, 60, 230)
"""Colours in blue, green and red: of retained places, of dropped ones, and of the present place."""


def save_overlay(source: FileFrames, result: VideoScore, path: Path) -> Path:
    """Write a video with the track, and return its path; its folder is created.

    Args:
        source: The video that was scored.
        result: Its result.
        path: File to write, MP4.
    """
    write_mp4(path, drawn_frames(source, result), source.fps)
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
    for frame, place in zip(track.frames[: row + 1], track.points_px[: row + 1], strict=True):
        if np.isfinite(place).all():
            counts = span is not None and span[0] <= frame <= span[1]
            cv2.circle(drawn, (round(place[0]), round(place[1])), 2, COUNTED if counts else DROPPED, -1)
    if np.isfinite(track.points_px[row]).all():
        x, y = track.points_px[row]
        cv2.drawMarker(drawn, (round(x), round(y)), MARKED, cv2.MARKER_CROSS, 22, 2)
    values = [f"{name} {value:.3g}" for name, value in result.metrics.items() if value is not None]
    is_counted = span is not None and span[0] <= number <= span[1]
    state = "counted" if is_counted else "dropped"
    seen = f"frame {number}, {state}, confidence {track.confidence[row]:.2f}"
    lines = [seen, f"{result.grade.value}: {', '.join(values)}"]
    for line, text in enumerate(lines):
        place = (10, drawn.shape[0] - 30 + 20 * line)
        cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return drawn
