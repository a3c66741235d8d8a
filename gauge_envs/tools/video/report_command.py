"""`gauge video report`."""

from __future__ import annotations

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
from gauge_envs.errors import VideoError
from gauge_envs.tools.video.score_command import judged

if TYPE_CHECKING:
    from gauge_envs.tools.video import VideoScore


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
                one = judged(given if given.exists() else file, video_task(task))
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
