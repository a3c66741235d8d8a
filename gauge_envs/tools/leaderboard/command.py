"""`gauge leaderboard check` and `gauge leaderboard table`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, message, print_document

if TYPE_CHECKING:
    from gauge_envs.tools.leaderboard import LeaderboardCheck

Folder = Annotated[
    Path, typer.Argument(metavar="DIR", help="The leaderboard, or one submission.")
]
FOLDER = Path("leaderboard")

GENERATED = ("leaderboard.json", "leaderboard.md")
"""Files that `gauge leaderboard table --out` writes."""


def leaderboard_check(
    folder: Folder = FOLDER,
    run: Annotated[
        bool,
        typer.Option(
            "--run",
            rich_help_panel=arguments.NUMERICS,
            help="Run all experiments here first, and write results.tar.xz of each submission.",
        ),
    ] = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Check submissions: what they state, and the results that --run wrote.

    With --run the engine must be installed in the version that the submission states. Exit code 1 when anything is
    wrong.
    """
    from gauge_envs.pages.text import counted
    from gauge_envs.tools.leaderboard.words import check_document

    check = _checked(folder, run)
    print_document(check_document(check), form)
    message(
        f"{counted(len(check.submissions), 'submission')}, {counted(len(check.faults), 'fault')}"
    )
    return bool(check.faults)


def leaderboard_table(
    folder: Folder = FOLDER,
    out: Annotated[
        Path | None,
        arguments.folder("Folder for leaderboard.json and leaderboard.md."),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Print scores of all submissions without faults: intervals, ranks and pairs.

    Ranks and pairs are within each grade of reference. Exit code 1 when a submission has faults, and is therefore left
    out.
    """
    from gauge_envs.pages.document import as_markdown, as_rows, save_file
    from gauge_envs.tools.leaderboard.words import leaderboard_document

    check = _checked(folder)
    document = leaderboard_document(check)
    if out is not None:
        texts = (
            json.dumps(as_rows(document), allow_nan=False, indent=1) + "\n",
            as_markdown(document),
        )
        for name, text in zip(GENERATED, texts, strict=True):
            message(save_file(out / name, text))
    if out is None or form is not Format.TEXT:
        print_document(document, form)
    for fault in check.faults:
        message(fault, "left out")
    return bool(check.faults)


def _checked(folder: Path, run: bool = False) -> LeaderboardCheck:
    from gauge_envs.tools.leaderboard import check_leaderboard

    with Progress("files", None) as progress:
        return check_leaderboard(folder, run=run, advance=progress.advance)
