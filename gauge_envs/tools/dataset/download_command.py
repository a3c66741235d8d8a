"""`gauge data download`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    echo,
    message,
)


def data_download(
    patterns: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PATTERN",
            show_default="all trials",
            help="Files, as 'data/rigid/slope slider/*'.",
        ),
    ] = None,
    revision: Annotated[
        str | None,
        arguments.option(
            arguments.SELECTION,
            "Commit, branch or tag.",
            metavar="NAME",
            show_default="that of the bundled data",
        ),
    ] = None,
    out: Annotated[
        Path | None, arguments.folder("Folder.", show_default="below the user's data")
    ] = None,
) -> None:
    """Download the GAUGE dataset (10 GB in all); an interrupted download resumes."""
    from gauge_envs.tools.dataset import download

    wanted = revision or download.PINNED_REVISION
    commit = download.resolved_revision(wanted)
    message(f"{download.DATASET}, revision {wanted} is {commit}")
    path, _ = download.download_dataset(
        out, patterns=patterns or [download.TRIAL_FILES], revision=commit
    )
    echo(path)
    message(f"gauge data import '{path}' makes bands and drivers from it")
