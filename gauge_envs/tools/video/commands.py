"""`gauge video prompts`, `score` and `report`, and `gauge list video-tasks`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    Progress,
    echo,
    json_text,
    message,
    print_document,
)
from gauge_envs.errors import VideoError
from gauge_envs.pages.document import save_file
from gauge_envs.pages.table import Table
from gauge_envs.tools.video import prompts, report
from gauge_envs.tools.video.scoring import VideoScore, score
from gauge_envs.tools.video.tasks import (
    video_task,
)
from gauge_envs.tools.video.track import TRACK_SUFFIXES, save_track


def list_video_tasks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the tasks: motion, size of the object, and results of real trials."""
    table = report.task_table()
    return arguments.matching([table], patterns, kind="video task")


def video_prompts(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="URL or DIR",
            show_default="GitHub",
            help="Copy of the repository.",
        ),
    ] = None,
    out: Annotated[
        Path, arguments.folder("Folder for TASK.png, TASK.txt and a note.")
    ] = Path("world_model_inputs"),
) -> None:
    """Fetch the first frame and the prompt of each task of the benchmark (3 MB).

    Files are written only if all files are complete and have the expected hashes.
    """
    with Progress("inputs", len(prompts.input_files())) as progress:
        names = prompts.fetch_inputs(
            out, source=source or prompts.SOURCE, advance=progress.advance
        )
    echo(out)
    message(f"{len(names)} files written")


def video_score(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="VIDEO",
            help="Videos, or tracks of any tracker: .csv with time, x, y, or .json with the centre of each frame.",
        ),
    ],
    task: Annotated[
        str,
        arguments.option(
            arguments.SCENE,
            "Task; see gauge list video-tasks.",
            "--id",
            metavar="ID",
        ),
    ],
    fps: Annotated[
        float | None,
        arguments.measured(
            "--fps",
            "Hz",
            "Frames per second of the camera; required for a track without times.",
            arguments.SCENE,
            is_positive=True,
            show_default="rate of the video",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        arguments.folder("Folder for tracks, and for pictures of tracks."),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Follow the object in videos, fit the law of the task, and report its metrics.

    Metrics have 95 % intervals. Exit code 1: a track is rejected.
    """
    has_failed = False
    for file in files:
        result = score(file, fps, task)
        print_document(report.score_document(result, video_task(task)), form)
        if out is not None:
            message(save_track(result.track, out / f"{file.stem}.track.csv"))
        if out is not None and file.suffix.lower() not in TRACK_SUFFIXES:
            picture = report.track_picture(result, file)
            message(save_file(out / f"{file.stem}.track.jpg", picture))
        has_failed = has_failed or not result.is_sound
    if has_failed:
        known = video_task(task)
        x_px, y_px = known.centre_px
        message(
            f"A clip of {known.id} begins with the picture of gauge video prompts, the object at "
            f"x {x_px:.0f}, y {y_px:.0f} of 832 x 480 pixels: docs/world_models.md"
        )
    return has_failed


def video_report(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Videos MODEL/TASK.mp4 or MODEL/TASK/seed_1.mp4; a .csv or .json with the same name is the track.",
        ),
    ],
    out: Annotated[
        Path, arguments.folder("Folder for the page and results.json.")
    ] = Path("video_report"),
) -> bool:
    """Score the videos of many models, and write a page with a table and pictures.

    The pictures show the followed object. Exit code 1: a video cannot be judged or a file has another name; the page
    shows the remaining videos.
    """
    videos, misnamed = report.find_videos(folder)
    errors = [
        f"{file}: expected the name MODEL/TASK.mp4 or MODEL/TASK/seed_1.mp4"
        for file in misnamed
    ]
    clips: list[tuple[str, str, Path, VideoScore | None]] = []
    with Progress("videos", len(videos)) as progress:
        for model, task, file in videos:
            progress.show(f"{model}: {task}")
            tracks = map(file.with_suffix, TRACK_SUFFIXES)
            source = next(filter(Path.exists, tracks), file)
            result = None
            try:
                result = score(source, task=task)
                result = replace(result, video=str(file.relative_to(folder)))
            except VideoError as error:
                errors.append(str(error))
            clips.append((model, task, file, result))
            progress.advance(f"{model}: {task}")
    for text in errors:
        message(text, "left out")
    table = report.model_table(clips)
    page = save_file(out / "index.html", report.video_page(clips, table))
    lines = [
        {"model": model, **result.to_dict()} for model, _, _, result in clips if result
    ]
    save_file(out / "results.json", json_text(lines))
    print_document(table, Format.TEXT)
    echo(page)
    return bool(errors)
