"""Videos of many models as one HTML page: a table of metrics with intervals, and pictures of what was followed."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from gauge_envs.errors import ResultFileError, VideoError
from gauge_envs.tools.video import METRICS, Grade, VideoScore, video_task, video_tasks
from gauge_envs.tools.video.frames import FileFrames, cv2
from gauge_envs.tools.video.overlay import drawn_frames
from gauge_envs.tools.video.tasks import published_results
from gauge_envs.tools.video.words import TITLES, short_text

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

STYLE = """
:root { color-scheme: light dark; --line: #ccc; --quiet: #666; --page: #fff; }
@media (prefers-color-scheme: dark) { :root { --line: #444; --quiet: #aaa; --page: #161616; }
  body { color: #e8e8e8; } }
body { background: var(--page); font: 16px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif;
  max-width: 76rem; margin: 1.5rem auto; padding: 0 1rem; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
.scroll { overflow-x: auto; overflow-wrap: normal; white-space: nowrap; }
table { border-collapse: collapse; } th, td { border-top: 1px solid var(--line);
  padding: .3rem .6rem; text-align: left; vertical-align: top; } td.n { font-variant-numeric: tabular-nums; }
.quiet { color: var(--quiet); font-size: .9rem; } .invalid, .doubtful { color: var(--quiet); }
tr > :first-child { position: sticky; left: 0; background: var(--page); } th .quiet { font-weight: normal; }
.strip { display: grid; grid-template-columns: repeat(6, 1fr); gap: .3rem; }
@media (max-width: 60rem) { .strip { grid-template-columns: repeat(3, 1fr); } }
@media (max-width: 30rem) { .strip { grid-template-columns: repeat(2, 1fr); } th, td { padding: .3rem; } }
.strip img { width: 100%; height: auto; display: block; }
"""


def find_videos(folder: Path) -> list[tuple[str, str, Path]]:
    """Return the model, the task and the file of each video `<model>/<task>.mp4` in a folder, sorted."""
    tasks = {task.id: order for order, task in enumerate(video_tasks())}
    files = sorted(folder.glob("*/*")) if folder.is_dir() else []
    found = [
        (file.parent.name, file.stem, file) for file in files if file.suffix.lower() in SUFFIXES and file.stem in tasks
    ]
    if not found:
        raise VideoError(
            f"{folder}: it holds no video of a task; expected MODEL/TASK.mp4 with a TASK of {', '.join(tasks)}"
        )
    return sorted(found, key=lambda one: (tasks[one[1]], one[0]))


def save_video_page(
    results: Mapping[tuple[str, str], VideoScore], files: Mapping[tuple[str, str], Path], out: Path
) -> Path:
    """Write the page of many videos into a folder, and return its path.

    Args:
        results: Results by model and task.
        files: Video files by model and task.
        out: Folder of the page; it is made if it does not exist.
    """
    path = out / "index.html"
    try:
        out.mkdir(parents=True, exist_ok=True)
        # The name of a file of a stranger may be no Unicode.
        path.write_text(video_page(results, files), encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def video_page(results: Mapping[tuple[str, str], VideoScore], files: Mapping[tuple[str, str], Path]) -> str:
    """Return the page of many videos, without any other file."""
    models = list(dict.fromkeys(model for model, _ in results))
    tasks = list(dict.fromkeys(task for _, task in results))
    rows = [(task, name) for task in tasks for name in METRICS if name in video_task(task).real]
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">',
        f"<title>Videos and the laws of motion</title><style>{STYLE}</style></head><body>",
        "<h1>Videos and the laws of motion</h1>",
        "<p>Below each value: the interval of 95 % of simulated tracks, and the published value where the folder has "
        "the name of a published model. Bold: nearest to the real value among the valid videos. Grey: doubtful.</p>",
        _table(models, rows, results),
        "<h2>Published models</h2>",
        '<p class="quiet">GAUGE, arXiv 2608.05948, Table 3. "negative" is with the negative prompt.</p>',
        _published_table(rows),
    ]
    for task in tasks:
        parts.append(f"<h2>{escape(task)}</h2>")
        parts += [
            _clip(model, results[model, task], files[model, task]) for model in models if (model, task) in results
        ]
    parts.append("</body></html>")
    return "\n".join(parts)


def _table(
    models: Sequence[str], rows: Sequence[tuple[str, str]], results: Mapping[tuple[str, str], VideoScore]
) -> str:
    published = published_results()
    head = "".join(f"<th>{escape(model)}</th>" for model in models)
    lines = []
    for task, name in rows:
        real = video_task(task).real[name]
        valid = [one for model in models if (one := results.get((model, task))) and one.grade is Grade.VALID]
        away = [abs(value - real) for one in valid if (value := one.metrics[name]) is not None]
        cells = ""
        for model in models:
            known = published.get(model.replace("-", "_"), {})
            cells += _cell(results.get((model, task)), name, known, real, min(away, default=-1.0))
        lines.append(f"<tr>{_title(task, name, f'real {short_text(real)}')}{cells}</tr>")
    return _scrolled(head, lines)


def _title(task: str, name: str, note: str = "") -> str:
    """Return the first cell of a row, which stays in sight while the others scroll."""
    below = "".join(f'<br><span class="quiet">{text}</span>' for text in (escape(TITLES[name]), note) if text)
    return f"<th>{escape(task)}{below}</th>"


def _scrolled(head: str, lines: Sequence[str]) -> str:
    return f'<div class="scroll"><table><tr><th>task</th>{head}</tr>{"".join(lines)}</table></div>'


def _cell(
    result: VideoScore | None,
    name: str,
    published: Mapping[tuple[str, str], float | None],
    real: float,
    least_away: float,
) -> str:
    if result is None:
        return "<td></td>"
    grade = result.grade
    value, interval = result.metrics[name], result.uncertainty[name]
    notes = [] if interval is None else [f"{short_text(interval[0])} to {short_text(interval[1])}"]
    if grade is not Grade.VALID and value is not None:
        notes.append(grade.value)
    if (result.task, name) in published:
        known = published[result.task, name]
        notes.append(f"published {'&ndash;' if known is None else short_text(known)}")
    text = grade.value if value is None else short_text(value)
    if value is not None and grade is Grade.VALID and abs(value - real) <= least_away:
        text = f"<b>{text}</b>"
    below = "".join(f'<br><span class="quiet">{note}</span>' for note in notes)
    return f'<td class="n {grade.value}">{text}{below}</td>'


def _published_table(rows: Sequence[tuple[str, str]]) -> str:
    published = published_results()
    head = "".join(f"<th>{escape(model)}</th>" for model in published)
    lines = []
    for task, name in rows:
        values = (known.get((task, name)) for known in published.values())
        cells = "".join(f"<td class=n>{'&ndash;' if value is None else short_text(value)}</td>" for value in values)
        lines.append(f"<tr>{_title(task, name)}{cells}</tr>")
    return _scrolled(head, lines)


def _clip(model: str, result: VideoScore, file: Path) -> str:
    span = result.interval_frames
    frames = "no frame is retained" if span is None else f"frames {span[0]} to {span[1]} are retained"
    if result.track.registration is not None:
        frames += f"; {LAYOUTS[result.track.registration.method]}"
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in result.reasons)
    return (
        f"<p><b>{escape(model)}</b>: {result.grade.value}; {frames}</p><ul>{reasons}</ul>"
        f'<div class="strip">{"".join(_pictures(result, file))}</div>'
    )


def _pictures(result: VideoScore, file: Path) -> list[str]:
    """Return frames of a video with the track drawn into them, as elements of a page."""
    first, last = result.interval_frames or (0, len(result.track.frames) - 1)
    wanted = set(np.linspace(first, last, PICTURES).astype(int).tolist())
    images = []
    for number, picture in enumerate(drawn_frames(FileFrames(file, fps=result.track.fps), result)):
        if number not in wanted:
            continue
        height = round(picture.shape[0] * PICTURE_WIDTH_PX / picture.shape[1])
        small = cv2.resize(picture, (PICTURE_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        _, packed = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])
        text = b64encode(packed.tobytes()).decode("ascii")
        images.append(f'<img loading="lazy" alt="frame {number}" src="data:image/jpeg;base64,{text}">')
    return images
