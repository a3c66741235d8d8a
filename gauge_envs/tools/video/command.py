"""`gauge video`: videos judged by the laws of motion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    from gauge_envs.tools.video import PlaneView, Track


def list_video_tasks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the tasks: what moves, how large it is, and what real trials give."""
    from gauge_envs.tools.video import video_tasks
    from gauge_envs.tools.video.words import task_table

    return arguments.matching([task_table(video_tasks())], patterns, kind="video task")


def video_prompts(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[URL or DIR]",
            help="Copy of the repository; that on GitHub by default.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for TASK.png, TASK.txt and a note.")
    ] = Path("world_model_inputs"),
) -> None:
    """Fetch the first frame and the prompt of each task of the benchmark (3 MB).

    Files that are there are checked and kept, so that the same command continues after an error.
    """
    from gauge_envs.pages.text import counted
    from gauge_envs.tools.video.prompts import SOURCE, fetch_inputs, input_files

    total = len(input_files())
    with Progress("inputs", total) as progress:
        written = fetch_inputs(out, source=source or SOURCE, advance=progress.advance)
    echo(out)
    message(f"{counted(len(written), 'file')} written, {total + 1 - len(written)} kept")


def video_score(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="VIDEO... [NAME=VALUE]...",
            help="Videos, or tracks: .csv with frame, x, y, confidence.",
        ),
    ],
    task: Annotated[
        str,
        typer.Option(
            "--id",
            metavar="ID",
            help="Task, see gauge list video-tasks; own films: slide, fall, pendulum.",
        ),
    ],
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="How the camera sees the plane, TOML or JSON; a board in the film.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for videos with the track drawn in."),
    ] = None,
    first_frame: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture that the model was given, to register the videos by.",
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Follow the object in videos, fit the law of the task, and report its metrics.

    They have intervals. Details: fps=, frames per second, instead of the rate that a video states; size=832x480, of the
    pictures of a track in pixels. Films of one's own, with --camera: object=612,300,40,40, left, top, width and height
    of a box around the object in the first frame; angle_deg=, slope of a slide or roll. They give friction, rolling
    resistance, restitution or damping too; --out also gets the log of a swing, for gauge recipe joint. Exit code 1 when
    a video is graded invalid.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.video import Grade, read_camera, score_track, video_task
    from gauge_envs.tools.video.frames import FileFrames, Frames
    from gauge_envs.tools.video.phone_films import (
        MOTIONS,
        FrontalFilm,
        score_phone_film,
        swing_log,
    )
    from gauge_envs.tools.video.tracker import track_object
    from gauge_envs.tools.video.words import save_overlay, score_document

    names, details = arguments.split_details(
        words, fps=float, size=_size, object=_box, angle_deg=float
    )
    are_tracks = {Path(name): name.lower().endswith(".csv") for name in names}
    if any(are_tracks.values()) and (out or first_frame):
        raise ParameterError(
            "--out and --first-frame need the video, and a track has none: leave out one of both"
        )
    if not all(are_tracks.values()) and (
        "size" in details or (camera is None) != ("object" not in details)
    ):
        raise ParameterError(
            "a video states its size; a film of one's own needs --camera and object="
        )
    view = None if camera is None else read_camera(camera)
    if task in MOTIONS and (view is None or any(are_tracks.values())):
        raise ParameterError(
            f"--id {task} is for films of one's own, with --camera and object="
        )
    has_failed = False
    for file, is_track in are_tracks.items():
        source: Frames | None = (
            None if is_track else FileFrames(file, fps=details.get("fps"))
        )
        if source is not None and view is not None:
            source = FrontalFilm(source, view)
            result = score_phone_film(
                source, task, details["object"], angle_deg=details.get("angle_deg")
            )
        else:
            chosen = video_task(task)
            track = (
                _given_track(file, details, view)
                if source is None
                else track_object(source, chosen, first_frame=first_frame)
            )
            result = score_track(track, chosen, name=str(file), camera=view)
        if out is not None and source is not None:
            message(save_overlay(source, result, out / f"{file.stem}.overlay.mp4"))
            if isinstance(source, FrontalFilm) and task == "pendulum":
                message(
                    save_file(out / f"{file.stem}.swing.csv", swing_log(source, result))
                )
        print_document(
            score_document(result, {} if task in MOTIONS else video_task(task).real),
            form,
        )
        has_failed = has_failed or result.grade is Grade.INVALID
    return has_failed


def _box(text: str) -> tuple[float, ...]:
    """Return left, top, width and height of `612,300,40,40`."""
    found = re.fullmatch(",".join([r"(\d+(?:\.\d*)?)"] * 4), text)
    if found is None or not float(found[3]) * float(found[4]):
        raise ParameterError(
            f"object={text}: give left, top, width and height of the box in pixels, as 612,300,40,40"
        )
    return tuple(map(float, found.groups()))


def _size(text: str) -> tuple[int, int]:
    """Return width and height of `832x480`."""
    found = re.fullmatch("([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", text.lower())
    if found is None:
        raise ParameterError(
            f"size={text}: give width and height in pixels, as 832x480"
        )
    return int(found[1]), int(found[2])


def _given_track(
    file: Path, details: Mapping[str, Any], view: PlaneView | None
) -> Track:
    """Return the track of a file; its pixels are those of its camera file unless a size is stated."""
    from gauge_envs.tools.video import read_track
    from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

    if "fps" not in details:
        raise ParameterError(
            f"{file}: a track states no frame rate: give it, as fps=30"
        )
    size_px = details.get("size", REFERENCE_SIZE_PX if view is None else view.size_px)
    return read_track(file, fps=details["fps"], size_px=size_px)


def video_report(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Videos MODEL/TASK.mp4 or MODEL/TASK/seed_1.mp4."
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for page, results.json and tables.")
    ] = Path("video_report"),
    first_frame: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder with the pictures that models were given, TASK.png.",
        ),
    ] = None,
) -> bool:
    """Score the videos of many models, and write a page with a table and pictures.

    The pictures show what was followed; table.csv and table.tex hold the table. Exit code 1 when a video cannot be
    judged or a file is named otherwise; the others are on the page.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.video import VideoScore, score_track, video_task
    from gauge_envs.tools.video.frames import FileFrames
    from gauge_envs.tools.video.tracker import track_object
    from gauge_envs.tools.video.words import find_videos, results_table, video_page

    videos, others = find_videos(folder)
    results: dict[tuple[str, str], dict[Path, VideoScore | None]] = {}
    broken = [
        f"{file}: left out: it is named otherwise than MODEL/TASK.mp4 or MODEL/TASK/seed_1.mp4"
        for file in others
    ]
    with Progress("videos", len(videos)) as progress:
        for model, task, file in videos:
            progress.show(f"{model}: {task}")
            clips = results.setdefault((model, task), {})
            clips[file] = None
            try:
                picture = None if first_frame is None else first_frame / f"{task}.png"
                track = track_object(
                    FileFrames(file), video_task(task), first_frame=picture
                )
                clips[file] = score_track(
                    track, video_task(task), name=str(file.relative_to(folder))
                )
            except VideoError as error:
                broken.append(str(error))
            progress.advance(f"{model}: {task}")
    for text in broken:
        message(text)
    page = save_file(out / "index.html", video_page(results))
    rows = [
        {"model": key[0], **one.to_dict()}
        for key, clips in results.items()
        for one in clips.values()
        if one
    ]
    save_file(out / "results.json", json_text(rows))
    table = results_table(results)
    save_file(out / "table.csv", table.csv())
    save_file(out / "table.tex", table.latex())
    echo(page)
    return bool(broken)


def video_board(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE [NAME=VALUE]...",
            help="File to write, .pdf or .png in true size.",
        ),
    ],
) -> None:
    """Write a board to print, beside which a phone held by hand can film a motion.

    Details: square_mm=35, the edge of a square: 7 x 5 of them fit on A4.
    """
    from gauge_envs.tools.video.phone_films import save_board

    file, details = arguments.split_subject(words, square_mm=float)
    echo(save_board(Path(file), details.get("square_mm", 35.0)))


def video_render(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="TASK [NAME=VALUE]...", help="Task; see gauge list video-tasks."
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Video to write, .mp4; its exact track goes beside it.")
    ],
    backend: Annotated[str, typer.Option(help="Engine.")] = "mujoco",
    parameters: arguments.Parameters = None,
    changes: arguments.Settings = None,
) -> None:
    """Make a video of an engine with the view of the first frame of a task.

    gauge video score judges it. Details: fps=30, which divides 180; seconds=, time after the release, by default that
    of the experiment, at most 8 s.
    """
    from gauge_envs.tools.video.render import film

    task, details = arguments.split_subject(words, fps=float, seconds=float)
    filmed = film(
        task,
        backend=backend,
        parameters=arguments.parsed_parameters(parameters) or "calibrated",
        settings=arguments.parsed_settings(changes),
        **details,
    )
    track = filmed.save(out)
    echo(out)
    echo(track)
