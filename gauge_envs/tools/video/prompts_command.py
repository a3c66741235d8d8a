"""`gauge video prompts` and `gauge list video-tasks`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Progress,
    echo,
    message,
)

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table


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
