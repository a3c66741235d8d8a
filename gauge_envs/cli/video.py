"""Commands that judge videos by the laws of motion."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide
from gauge_envs.cli.output import (
    EXIT_FAILED,
    echo,
    plain_text,
    print_json_lines,
    print_table,
    progress_bar,
    stderr_console,
    stdout_console,
)
from gauge_envs.errors import ParameterError, VideoError

if TYPE_CHECKING:
    from gauge_envs.video import Start

__all__ = ["video_app", "video_list", "video_report", "video_score"]

video_app = typer.Typer(help="Videos of world models, judged by the laws of motion.", no_args_is_help=True)


@video_app.command("list")
def video_list(json_lines: Json = False, wide: Wide = False) -> None:
    """List the tasks: what moves, how large it is, and what real trials give."""
    from gauge_envs.report.videos import task_rows, task_table
    from gauge_envs.video import video_tasks

    print_table(task_table(task_rows(video_tasks())), json_lines=json_lines, wide=wide)


@video_app.command("score")
def video_score(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO...", help="Video files, or tracks with --track.")],
    task: Annotated[str, typer.Option(help="Task that the videos show, as SlopeSlider-2-wood; see gauge video list.")],
    is_track: Annotated[
        bool, typer.Option("--track", help="The files are tracks: CSV with the columns frame, x, y and confidence.")
    ] = False,
    fps: Annotated[
        float | None, typer.Option(help="Frames per second, instead of the rate that a file states.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the pictures of a track [px], as 832x480.")
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="TOML or JSON file: how a recording of your own sees the plane of the motion."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y[,SIZE]", help="Centre of the object in the first frame of such a video, its size [px]."
        ),
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for videos with the track drawn into them.")
    ] = None,
    json_lines: Json = False,
) -> None:
    """Track the object in videos, fit the law of the task, and report its metrics with intervals.

    Exit code 1 when a video is graded invalid.
    """
    from gauge_envs.report.videos import score_view
    from gauge_envs.video import Grade, read_camera, read_track, score_track, video_task
    from gauge_envs.video.frames import FileFrames
    from gauge_envs.video.overlay import save_overlay
    from gauge_envs.video.tracker import track_object

    chosen = video_task(task)
    if is_track and fps is None:
        raise ParameterError("--track: a track states no frame rate: give it, as --fps 30")
    if is_track and overlay is not None:
        raise ParameterError("--overlay needs the video, and --track gives a track alone: leave out one of the two")
    if size is not None and not is_track:
        raise ParameterError("--size goes with --track; a video states its own size")
    if is_track and start is not None:
        raise ParameterError("--start is where the object of a video is, and --track has its track: leave out one")
    view = None if camera is None else read_camera(camera)
    beginning = None if start is None else _start(start)
    has_failed = False
    for path in videos:
        if is_track:
            assert fps is not None
            # Pixels of a track are those of its camera file unless --size states others.
            size_px = view.size_px if view is not None and size is None else _size(size)
            result = score_track(read_track(path, fps=fps, size_px=size_px), chosen, name=str(path), camera=view)
        else:
            source = FileFrames(path, fps=fps)
            track = track_object(source, chosen, camera=view, start=beginning)
            result = score_track(track, chosen, name=str(path), camera=view)
            if overlay is not None:
                overlay.mkdir(parents=True, exist_ok=True)
                written = save_overlay(source, result, overlay / f"{path.stem}.overlay.mp4")
                stderr_console().print(plain_text(str(written)), soft_wrap=True)
        if json_lines:
            print_json_lines([result.to_dict()])
        else:
            stdout_console().print(score_view(result, chosen.real), soft_wrap=True)
        has_failed = has_failed or result.grade is Grade.INVALID
    if has_failed:
        raise typer.Exit(EXIT_FAILED)


@video_app.command("report")
def video_report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with videos MODEL/TASK.mp4.")],
    out: Annotated[Path, typer.Option(help="Folder for the page and for results.json.")] = Path("video_report"),
) -> None:
    """Score the videos of many models, and write a page with a table and pictures of what was followed.

    Exit code 1 when a video cannot be read; the others are on the page.
    """
    import json

    from gauge_envs.report.video_page import find_videos, save_video_page
    from gauge_envs.video import score_track, video_task
    from gauge_envs.video.frames import FileFrames
    from gauge_envs.video.tracker import track_object

    videos = find_videos(folder)
    results, files, broken = {}, {}, []
    with progress_bar(stderr_console()) as progress:
        bar = progress.add_task("videos", total=len(videos))
        for model, task, file in videos:
            progress.update(bar, description=f"{model}: {task}")
            try:
                track = track_object(FileFrames(file), video_task(task))
                results[model, task] = score_track(track, video_task(task), name=f"{model}/{file.name}")
                files[model, task] = file
            except VideoError as error:
                broken.append(str(error))
            progress.update(bar, advance=1)
    for text in broken:
        stderr_console().print(plain_text(text), soft_wrap=True)
    if not results:
        raise typer.Exit(EXIT_FAILED)
    page = save_video_page(results, files, out)
    lines = [json.dumps({"model": model, **result.to_dict()}) for (model, _), result in results.items()]
    (out / "results.json").write_text("\n".join(lines) + "\n", encoding="utf-8")
    echo(page)
    if broken:
        raise typer.Exit(EXIT_FAILED)


def _start(text: str) -> Start:
    """Return the place and size of `640,360,25`."""
    from gauge_envs.video import Start

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(math.isfinite(value) for value in values):
        raise ParameterError(f"--start {text!r}: give the centre and perhaps the size in pixels, as 640,360,25")
    return Start(x_px=values[0], y_px=values[1], size_px=values[2] if len(values) == 3 else None)


def _size(text: str | None) -> tuple[int, int]:
    """Return width and height of `832x480`; the reference grid when nothing is stated."""
    from gauge_envs.video.tasks import REFERENCE_SIZE_PX

    if text is None:
        return REFERENCE_SIZE_PX
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise ParameterError(f"--size {text!r}: give width and height in pixels, as 832x480")
    return int(parts[0]), int(parts[1])
