"""Videos of many models as one HTML page: a table of metrics with intervals, and pictures of what was followed."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from gauge_envs.errors import ResultFileError, VideoError
from gauge_envs.report.videos import TITLES, short_text
from gauge_envs.video import METRICS, VideoScore, video_task, video_tasks
from gauge_envs.video.frames import FileFrames, opencv
from gauge_envs.video.overlay import drawn_frames
from gauge_envs.video.published import published_results

__all__ = ["find_videos", "save_video_page", "video_page"]

SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")

PICTURES = 6
"""Frames of a video that the page shows."""

PICTURE_WIDTH_PX = 416

STYLE = """
:root { color-scheme: light dark; --line: #ccc; --quiet: #666; }
@media (prefers-color-scheme: dark) { :root { --line: #444; --quiet: #aaa; }
  body { background: #161616; color: #e8e8e8; } }
body { font: 16px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; max-width: 76rem; margin: 1.5rem auto;
  padding: 0 1rem; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
.scroll { overflow-x: auto; overflow-wrap: normal; white-space: nowrap; }
table { border-collapse: collapse; } th, td { border-top: 1px solid var(--line);
  padding: .3rem .6rem; text-align: left; vertical-align: top; } td.n { font-variant-numeric: tabular-nums; }
.quiet { color: var(--quiet); font-size: .9rem; } .invalid, .doubtful { color: var(--quiet); }
.strip { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(13rem, 100%), 1fr)); gap: .3rem; }
.strip img { width: 100%; height: auto; display: block; }
"""


def find_videos(folder: Path) -> list[tuple[str, str, Path]]:
    """Return the model, the task and the file of each video `<model>/<task>.mp4` in a folder, sorted.

    Raises:
        VideoError: There is no such folder, or it has no such file; the message lists the tasks.
    """
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

    Raises:
        ResultFileError: The page cannot be written.
    """
    path = out / "index.html"
    try:
        out.mkdir(parents=True, exist_ok=True)
        path.write_text(video_page(results, files), encoding="utf-8")
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
        "<p>Each value has the interval of 95 % of simulated tracks below it. Values of doubtful clips are grey.</p>",
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
    head = "".join(f"<th>{escape(model)}</th>" for model in models)
    lines = []
    for task, name in rows:
        cells = "".join(_cell(results.get((model, task)), name) for model in models)
        real = short_text(video_task(task).real[name])
        lines.append(f"<tr><td>{escape(task)}</td><td>{escape(TITLES[name])}</td><td class=n>{real}</td>{cells}</tr>")
    body = "".join(lines)
    return f'<div class="scroll"><table><tr><th>task</th><th>metric</th><th>real</th>{head}</tr>{body}</table></div>'


def _cell(result: VideoScore | None, name: str) -> str:
    if result is None:
        return "<td></td>"
    value, interval = result.metrics[name], result.uncertainty[name]
    if value is None:
        return f'<td class="{result.grade.value}">{result.grade.value}</td>'
    span = (
        ""
        if interval is None
        else f'<br><span class="quiet">{short_text(interval[0])} to {short_text(interval[1])}</span>'
    )
    return f'<td class="n {result.grade.value}">{short_text(value)}{span}</td>'


def _published_table(rows: Sequence[tuple[str, str]]) -> str:
    published = published_results()
    head = "".join(f"<th>{escape(model)}</th>" for model in published)
    lines = []
    for task, name in rows:
        values = (known.get((task, name)) for known in published.values())
        cells = "".join(f"<td class=n>{'&ndash;' if value is None else short_text(value)}</td>" for value in values)
        lines.append(f"<tr><td>{escape(task)}</td><td>{escape(TITLES[name])}</td>{cells}</tr>")
    return f'<div class="scroll"><table><tr><th>task</th><th>metric</th>{head}</tr>{"".join(lines)}</table></div>'


def _clip(model: str, result: VideoScore, file: Path) -> str:
    span = result.interval_frames
    frames = "no frame is retained" if span is None else f"frames {span[0]} to {span[1]} are retained"
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in result.reasons)
    return (
        f"<p><b>{escape(model)}</b>: {result.grade.value}; {frames}</p><ul>{reasons}</ul>"
        f'<div class="strip">{"".join(_pictures(result, file))}</div>'
    )


def _pictures(result: VideoScore, file: Path) -> list[str]:
    """Return frames of a video with the track drawn into them, as elements of a page."""
    cv2 = opencv()
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
