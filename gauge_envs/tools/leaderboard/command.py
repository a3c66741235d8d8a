"""`gauge leaderboard check` and `gauge leaderboard table`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, message, print_document

Folder = Annotated[
    Path, typer.Argument(metavar="DIR", help="The leaderboard, or one submission.")
]
FOLDER = Path("leaderboard")


def leaderboard_check(
    folder: Folder = FOLDER,
    run: Annotated[
        bool,
        arguments.option(
            arguments.NUMERICS,
            "Run all experiments here first, and write results.tar.xz of each submission.",
            "--run",
        ),
    ] = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Check submissions: what they state, and the results that --run wrote.

    With --run the engine must be installed in the version that the submission states. Exit code 1 when anything is
    wrong.
    """
    from gauge_envs.tools.leaderboard import check_leaderboard
    from gauge_envs.tools.leaderboard.words import check_document

    with Progress("experiments", None) as progress:
        checks = check_leaderboard(folder, run=run, advance=progress.advance)
    print_document(check_document(checks), form)
    return any(one.faults for one in checks)


def leaderboard_table(
    folder: Folder = FOLDER, form: arguments.Form = Format.TEXT
) -> bool:
    """Print scores of all submissions without faults, with intervals, and ranks within each grade of reference.

    Exit code 1 when a submission has faults, and is therefore left out.
    """
    from gauge_envs.tools.leaderboard import check_leaderboard
    from gauge_envs.tools.leaderboard.words import leaderboard_document

    checks = check_leaderboard(folder)
    print_document(leaderboard_document(checks), form)
    faulty = [one for one in checks if one.faults]
    for one in faulty:
        message(f"{one.folder}: {one.faults[0]}", "left out")
    return bool(faulty)
