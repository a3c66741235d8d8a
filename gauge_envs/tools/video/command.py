"""`gauge video`: videos judged by the laws of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from gauge_envs.errors import ParameterError, VideoError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.tools.video import VideoScore, VideoTask


RateOption = Annotated[
    float | None,
    arguments.measured(
        "--fps",
        "Hz",
        "Frames per second of the camera; needed for a track without times.",
        arguments.SCENE,
        is_positive=True,
        show_default="that of the video",
    ),
]


def list_video_tasks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the tasks: what moves, how large it is, and what real trials give."""
    from gauge_envs.tools.video import video_tasks
    from gauge_envs.tools.video.words import task_table

    return arguments.matching([task_table(video_tasks())], patterns, kind="video task")


def video_prompts(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="URL or DIR",
            show_default="that on GitHub",
            help="Copy of the repository.",
        ),
    ] = None,
    out: Annotated[
        Path, arguments.folder("Folder for TASK.png, TASK.txt and a note.")
    ] = Path("world_model_inputs"),
) -> None:
    """Fetch the first frame and the prompt of each task of the benchmark (3 MB).

    Nothing is written unless all files are there and have their hashes.
    """
    from gauge_envs.tools.video.prompts import SOURCE, fetch_inputs, input_files

    with Progress("inputs", len(input_files())) as progress:
        names = fetch_inputs(out, source=source or SOURCE, advance=progress.advance)
    echo(out)
    message(f"{len(names)} files written")


def video_score(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="VIDEO",
            help="Videos, or tracks of any tracker: .csv with time, x, y.",
        ),
    ],
    task: Annotated[
        str,
        arguments.option(
            arguments.SCENE,
            "Task, see gauge list video-tasks.",
            "--id",
            metavar="ID",
        ),
    ],
    fps: RateOption = None,
    out: Annotated[
        Path | None,
        arguments.folder("Folder for tracks, and videos with them drawn in."),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Follow the object in videos, fit the law of the task, and report its metrics.

    They have intervals. Exit code 1 when a track is not sound.
    """
    from gauge_envs.tools.video import save_track, video_task
    from gauge_envs.tools.video.frames import FileFrames
    from gauge_envs.tools.video.words import save_overlay, score_document

    if out is not None and any(map(_is_track, files)):
        raise ParameterError(
            "--out needs the video, and a track has none: leave out one of both"
        )
    chosen = video_task(task)
    has_failed = False
    for file in files:
        result = _judged(file, chosen, fps)
        if out is not None:
            overlay = out / f"{file.stem}.overlay.mp4"
            message(save_overlay(FileFrames(file, fps=fps), result, overlay))
            message(save_track(result.track, out / f"{file.stem}.track.csv"))
        print_document(score_document(result, chosen), form)
        has_failed = has_failed or not result.is_sound
    return has_failed


def video_report(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Videos MODEL/TASK.mp4 or MODEL/TASK/seed_1.mp4; a .csv of the same name is its track.",
        ),
    ],
    out: Annotated[
        Path, arguments.folder("Folder for page, results.json and tables.")
    ] = Path("video_report"),
) -> bool:
    """Score the videos of many models, and write a page with a table and pictures.

    The pictures show what was followed; table.csv and table.tex hold the table. Exit code 1 when a video cannot be
    judged or a file is named otherwise; the others are on the page.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.video import video_task
    from gauge_envs.tools.video.words import (
        find_videos,
        results_table,
        table_csv,
        table_latex,
        video_page,
    )

    videos, others = find_videos(folder)
    results: dict[tuple[str, str], dict[Path, VideoScore | None]] = {}
    broken = [
        f"{file}: it is named otherwise than MODEL/TASK.mp4 or MODEL/TASK/seed_1.mp4"
        for file in others
    ]
    with Progress("videos", len(videos)) as progress:
        for model, task, file in videos:
            progress.show(f"{model}: {task}")
            clips = results.setdefault((model, task), {})
            clips[file] = None
            given = file.with_suffix(".csv")
            try:
                one = _judged(given if given.exists() else file, video_task(task))
                clips[file] = replace(one, video=str(file.relative_to(folder)))
            except VideoError as error:
                broken.append(str(error))
            progress.advance(f"{model}: {task}")
    for text in broken:
        message(text, "left out")
    table = results_table(results)
    page = save_file(out / "index.html", video_page(results, table))
    rows = [
        {"model": key[0], **one.to_dict()}
        for key, clips in results.items()
        for one in clips.values()
        if one
    ]
    save_file(out / "results.json", json_text(rows))
    save_file(out / "table.csv", table_csv(table))
    save_file(out / "table.tex", table_latex(table))
    print_document(table, Format.TEXT)
    echo(page)
    return bool(broken)


def _is_track(file: Path) -> bool:
    return file.suffix.lower() == ".csv"


def _judged(file: Path, task: VideoTask, fps: float | None = None) -> VideoScore:
    """Score a video, or a track in pixels of the video beside it, or else of the known first frame."""
    from gauge_envs.tools.video import read_track, score, score_track
    from gauge_envs.tools.video.frames import FileFrames
    from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX
    from gauge_envs.tools.video.words import videos_beside

    if not _is_track(file):
        return score(file, fps, task.id)
    sizes = [FileFrames(video).size_px for video in videos_beside(file)]
    track = read_track(file, fps=fps, size_px=(*sizes, REFERENCE_SIZE_PX)[0])
    return score_track(track, task, name=str(file))
