"""Commands that judge videos by the laws of motion."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, ParametersOption, Wide, parsed_parameters, parsed_settings
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    echo,
    plain_text,
    print_document,
    progress_bar,
    stderr_console,
)
from gauge_envs.errors import ParameterError, VideoError
from gauge_envs.pages.document import save_file

if TYPE_CHECKING:
    from gauge_envs.tools.video import PlaneView, Track


video_app = typer.Typer(help="Videos of world models, judged by the laws of motion.", no_args_is_help=True)


@video_app.command("list")
def video_list(json_lines: Json = False, wide: Wide = False) -> None:
    """List the tasks: what moves, how large it is, and what real trials give."""
    from gauge_envs.tools.video import video_tasks
    from gauge_envs.tools.video.words import task_table

    print_document(task_table(video_tasks()), json_lines=json_lines, wide=wide)


@video_app.command("prompts")
def video_prompts(
    out: Annotated[Path, typer.Option(help="Folder for TASK.png, TASK.txt and a note.")] = Path("world_model_inputs"),
    source: Annotated[
        str | None,
        typer.Option(metavar="URL|DIR", help="Copy of the benchmark's repository; by default its address on GitHub."),
    ] = None,
) -> None:
    """Fetch the first frame and the prompt of each task from the benchmark's repository (3 MB).

    Files that are there are checked and kept, so that the same command continues after an error.
    """
    from gauge_envs.tools.video.prompts import SOURCE, fetch_inputs, input_files

    with progress_bar(stderr_console()) as progress:
        bar = progress.add_task("inputs", total=len(input_files()))

        def advance(name: str) -> None:
            progress.update(bar, advance=1, description=name)

        written = fetch_inputs(out, source=source or SOURCE, advance=advance)
    echo(out)
    stderr_console().print(f"{counted(len(written), 'file')} written, {len(input_files()) + 1 - len(written)} kept")


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
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the pictures of a track in pixels, as 832x480.")
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="With --track: TOML or JSON file on how the camera sees the plane."),
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for videos with the track drawn into them.")
    ] = None,
    first_frame: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture that the model was given, to register the videos by it."),
    ] = None,
    json_lines: Json = False,
) -> None:
    """Track the object in videos, fit the law of the task, and report its metrics with intervals.

    Exit code 1 when a video is graded invalid.
    """
    from gauge_envs.tools.video import Grade, read_camera, score_track, video_task
    from gauge_envs.tools.video.frames import FileFrames
    from gauge_envs.tools.video.overlay import save_overlay
    from gauge_envs.tools.video.tracker import track_object
    from gauge_envs.tools.video.words import score_document

    chosen = video_task(task)
    if is_track and (overlay or first_frame):
        raise ParameterError("--overlay and --first-frame need the video, and --track has none: leave out one of both")
    if not is_track and (size or camera):
        raise ParameterError("--size and --camera go with --track; a video shows the first frame and states its size")
    view = None if camera is None else read_camera(camera)
    has_failed = False
    for path in videos:
        if is_track:
            track = _given_track(path, fps, size, view)
        else:
            source = FileFrames(path, fps=fps)
            track = track_object(source, chosen, first_frame=first_frame)
        result = score_track(track, chosen, name=str(path), camera=view)
        if overlay is not None:
            written = save_overlay(source, result, overlay / f"{path.stem}.overlay.mp4")
            stderr_console().print(plain_text(str(written)), soft_wrap=True)
        print_document(score_document(result, chosen.real), json_lines=json_lines)
        has_failed = has_failed or result.grade is Grade.INVALID
    if has_failed:
        raise typer.Exit(EXIT_FAILED)


@video_app.command("report")
def video_report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with videos MODEL/TASK.mp4.")],
    out: Annotated[Path, typer.Option(help="Folder for the page and for results.json.")] = Path("video_report"),
    first_frames: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder with the pictures that the models were given, TASK.png.")
    ] = None,
) -> None:
    """Score the videos of many models, and write a page with a table and pictures of what was followed.

    Exit code 1 when a video cannot be read; the others are on the page.
    """
    import json

    from gauge_envs.tools.video import score_track, video_task
    from gauge_envs.tools.video.frames import FileFrames
    from gauge_envs.tools.video.page import find_videos, video_page
    from gauge_envs.tools.video.tracker import track_object

    videos = find_videos(folder)
    results, files, broken = {}, {}, []
    with progress_bar(stderr_console()) as progress:
        bar = progress.add_task("videos", total=len(videos))
        for model, task, file in videos:
            progress.update(bar, description=f"{model}: {task}")
            try:
                first_frame = None if first_frames is None else first_frames / f"{task}.png"
                track = track_object(FileFrames(file), video_task(task), first_frame=first_frame)
                results[model, task] = score_track(track, video_task(task), name=f"{model}/{file.name}")
                files[model, task] = file
            except VideoError as error:
                broken.append(str(error))
            progress.update(bar, advance=1)
    for text in broken:
        stderr_console().print(plain_text(text), soft_wrap=True)
    if not results:
        raise typer.Exit(EXIT_FAILED)
    page = save_file(out / "index.html", video_page(results, files))
    lines = [json.dumps({"model": model, **result.to_dict()}) for (model, _), result in results.items()]
    save_file(out / "results.json", "\n".join(lines) + "\n")
    echo(page)
    if broken:
        raise typer.Exit(EXIT_FAILED)


@video_app.command("render")
def video_render(
    task: Annotated[str, typer.Argument(metavar="TASK", help="Task, as SlopeSlider-2-wood; see gauge video list.")],
    out: Annotated[Path, typer.Option(help="Video to write, MP4; its exact track goes beside it.")],
    backend: Annotated[str, typer.Option(help="Engine.")] = "mujoco",
    parameters: ParametersOption = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Numerical setting of the engine, as timestep_s=0.0005.")
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames per second; divides 180.")] = 30.0,
    seconds: Annotated[
        float | None, typer.Option(help="Time after the release in s; by default the experiment, at most 8 s.")
    ] = None,
) -> None:
    """Make a video of an engine with the view of the first frame of a task, for gauge video score."""
    from gauge_envs.tools.video.render import film

    filmed = film(
        task,
        backend=backend,
        parameters=parsed_parameters(parameters) or "calibrated",
        settings=parsed_settings(changes or []),
        fps=fps,
        seconds=seconds,
    )
    track = filmed.save(out)
    echo(out)
    echo(track)


def _size(text: str | None) -> tuple[int, int]:
    """Return width and height of `832x480`; the reference grid when nothing is stated."""
    from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

    if text is None:
        return REFERENCE_SIZE_PX
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(re.fullmatch("[1-9][0-9]{0,4}", part) for part in parts):
        raise ParameterError(f"--size {text!r}: give width and height in pixels, as 832x480")
    return int(parts[0]), int(parts[1])


def _given_track(path: Path, fps: float | None, size: str | None, view: PlaneView | None) -> Track:
    """Return the track of a file; its pixels are those of its camera file unless a size is stated."""
    from gauge_envs.tools.video import read_track

    if fps is None:
        raise ParameterError("--track: a track states no frame rate: give it, as --fps 30")
    return read_track(path, fps=fps, size_px=view.size_px if view is not None and size is None else _size(size))
