"""`gauge leaderboard check` and `gauge leaderboard table`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import FormatOption
from gauge_envs.cli.output import Format, Progress, counted, message, print_result

if TYPE_CHECKING:
    from gauge_envs.tools.leaderboard import LeaderboardCheck

FolderArgument = Annotated[
    Path, typer.Argument(metavar="[DIR]", help="Folder of the leaderboard, or of one submission.")
]


def leaderboard_check(
    folder: FolderArgument = Path("leaderboard"),
    rerun: Annotated[int, typer.Option(min=0, help="Run this many episodes of each submission again.")] = 0,
    salt: Annotated[
        str, typer.Option(help="Text unknown to the submitter, which enters the choice of these episodes.")
    ] = "",
    form: FormatOption = Format.TEXT,
) -> bool:
    """Check submissions: layout, versions, task hashes, trajectories and scores.

    Scores are computed anew from the trajectories. Exit code 1 when anything is wrong.
    """
    from gauge_envs.tools.leaderboard.words import check_records, check_view

    check = _checked(folder, rerun, salt)
    print_result(form, rows=lambda: check_records(check), view=lambda _: check_view(check))
    message(f"{counted(len(check.submissions), 'submission')}, {counted(len(check.all_faults), 'fault')}")
    return not check.ok


def leaderboard_table(
    folder: FolderArgument = Path("leaderboard"),
    out: Annotated[
        Path | None, typer.Option(help="Write leaderboard.json and leaderboard.md into this folder.")
    ] = None,
    form: FormatOption = Format.TEXT,
) -> bool:
    """Print scores of all submissions without faults: intervals, ranks and pairs.

    Ranks and pairs are within each grade of reference. Exit code 1 when a submission has faults, and is therefore left
    out.
    """
    from gauge_envs.cli.output import save_text
    from gauge_envs.tools.leaderboard.layout import GENERATED
    from gauge_envs.tools.leaderboard.words import leaderboard_markdown, leaderboard_records, leaderboard_view

    check = _checked(folder)
    if out is not None:
        rows = json.dumps(leaderboard_records(check), allow_nan=False, indent=1) + "\n"
        for name, text in zip(GENERATED, (rows, leaderboard_markdown(check)), strict=True):
            message(save_text(out / name, text))
    if out is None or form is not Format.TEXT:
        print_result(
            form,
            rows=lambda: leaderboard_records(check),
            view=lambda wide: leaderboard_view(check, wide=wide),
            markdown=lambda: leaderboard_markdown(check),
        )
    for fault in check.all_faults:
        message(fault, "left out")
    return not check.ok


def _checked(folder: Path, rerun: int = 0, salt: str = "") -> LeaderboardCheck:
    from gauge_envs.tools.leaderboard import check_leaderboard

    with Progress("files", None) as progress:
        return check_leaderboard(folder, rerun_count=rerun, salt=salt, advance=progress.advance)
