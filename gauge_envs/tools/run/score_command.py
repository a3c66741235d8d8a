"""`gauge score`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, note, print_document
from gauge_envs.pages.text import counted


def score(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="CSV, NPZ or JSON; also a result file."),
    ],
    name: Annotated[
        str | None,
        arguments.experiment("Experiment, if the file does not state it."),
    ] = None,
    parameters: arguments.Parameters = None,
    use: arguments.Use = None,
    details: arguments.Details = False,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Score a trajectory from your own simulator; no engine is needed.

    It is g(t) in the observable's unit, mm for positions. Columns are the coordinates that `gauge show ID` lists.
    Without a `time_s` column, rows are 30 Hz frames. The id may be a task file.
    """
    from gauge_envs.runs.score_file import score_file
    from gauge_envs.tools.run.words import summary_document

    used = arguments.parsed_use(use, "reference")
    result, interpolated = score_file(
        file, variant=name, parameters=arguments.parsed_parameters(parameters), **used
    )
    if interpolated:
        note(f"{counted(interpolated, 'frame')} between samples: interpolated linearly")
    document = summary_document([result], details=details or form is Format.WIDE)
    print_document(replace(document, rows=[result.to_dict(trajectory=False)]), form)
