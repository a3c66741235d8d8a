"""Commands for a leaderboard of submitted results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, check_one_format
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    echo,
    plain_text,
    print_json_lines,
    progress_bar,
    stderr_console,
    stdout_console,
)

if TYPE_CHECKING:
    from gauge_envs.tools.leaderboard import LeaderboardCheck


FolderArgument = Annotated[
    Path, typer.Argument(metavar="[DIR]", help="Folder of the leaderboard, or of one submission.")
]

leaderboard_app = typer.Typer(help="Results that vendors of engines submit, as files.", no_args_is_help=True)


@leaderboard_app.command("check")
def leaderboard_check(
    folder: FolderArgument = Path("leaderboard"),
    rerun: Annotated[int, typer.Option(min=0, help="Run this many episodes of each submission again.")] = 0,
    salt: Annotated[
        str, typer.Option(help="Text unknown to the submitter, which enters the choice of these episodes.")
    ] = "",
    json_lines: Json = False,
) -> None:
    """Check submissions: layout, versions, task hashes, trajectories, and scores computed anew from these.

    Exit code 1 when anything is wrong.
    """
    from gauge_envs.tools.leaderboard.words import check_records, check_view

    check = _checked(folder, rerun=rerun, salt=salt)
    if json_lines:
        print_json_lines(check_records(check))
    else:
        stdout_console().print(check_view(check))
    stderr_console().print(
        f"{counted(len(check.submissions), 'submission')}, {counted(len(check.all_faults), 'fault')}"
    )
    if not check.ok:
        raise typer.Exit(EXIT_FAILED)


@leaderboard_app.command("table")
def leaderboard_table(
    folder: FolderArgument = Path("leaderboard"),
    json_lines: Json = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Tables as GitHub Markdown.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Write leaderboard.json and leaderboard.md into this folder.")
    ] = None,
    wide: Wide = False,
) -> None:
    """Print the table of all submissions without faults: scores with intervals, ranks and pairs within each grade.

    Exit code 1 when a submission has faults, and is therefore left out.
    """
    import json

    from gauge_envs.errors import ResultFileError
    from gauge_envs.files import write_whole
    from gauge_envs.tools.leaderboard.submission import GENERATED
    from gauge_envs.tools.leaderboard.words import leaderboard_markdown, leaderboard_records, leaderboard_view

    check_one_format(json_lines, markdown)
    check = _checked(folder)
    if out is not None:
        texts = (json.dumps(leaderboard_records(check), allow_nan=False, indent=1) + "\n", leaderboard_markdown(check))
        try:
            out.mkdir(parents=True, exist_ok=True)
            for name, text in zip(GENERATED, texts, strict=True):
                write_whole(out / name, text.encode())
                stderr_console().print(plain_text(str(out / name)), soft_wrap=True)
        except OSError as error:
            raise ResultFileError(f"{out}: cannot be written: {error.strerror or error}") from error
    if json_lines:
        print_json_lines(leaderboard_records(check))
    elif markdown:
        echo(leaderboard_markdown(check), nl=False)
    elif out is None:
        stdout_console().print(leaderboard_view(check, wide=wide))
    for fault in check.all_faults:
        stderr_console().print(f"[yellow]left out:[/] {plain_text(str(fault))}", soft_wrap=True)
    if not check.ok:
        raise typer.Exit(EXIT_FAILED)


def _checked(folder: Path, *, rerun: int = 0, salt: str = "") -> LeaderboardCheck:
    from gauge_envs.tools.leaderboard import check_leaderboard

    with progress_bar(stderr_console()) as progress:
        bar = progress.add_task("files", total=None)

        def advance(text: str) -> None:
            progress.update(bar, advance=1, description=plain_text(text))

        return check_leaderboard(folder, rerun_count=rerun, salt=salt, advance=advance)
