"""`gauge video score`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    message,
    print_document,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
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
        result = judged(file, chosen, fps)
        if out is not None:
            overlay = out / f"{file.stem}.overlay.mp4"
            message(save_overlay(FileFrames(file, fps=fps), result, overlay))
            message(save_track(result.track, out / f"{file.stem}.track.csv"))
        print_document(score_document(result, chosen), form)
        has_failed = has_failed or not result.is_sound
    return has_failed


def _is_track(file: Path) -> bool:
    return file.suffix.lower() == ".csv"


def judged(file: Path, task: VideoTask, fps: float | None = None) -> VideoScore:
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
