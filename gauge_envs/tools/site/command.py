"""The command that writes a site of results."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.output import EXIT_FAILED, counted, echo, plain_text, progress_bar, stderr_console
from gauge_envs.cli.results import loaded_files
from gauge_envs.errors import ResultFileError


def report(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the site; a site in it is replaced.")] = Path("site"),
    replay: Annotated[
        bool,
        typer.Option(
            "--replay/--no-replay", help="Run the episodes again for 3D replays; the poses are kept beside the results."
        ),
    ] = True,
) -> None:
    """Write results as a static site that opens from the folder: engines, phenomena, curves, errors and 3D replays.

    A replay is shown only if the repeated run has the g(t) of its result, bit for bit. Exit code 1 when a damaged file
    was skipped.
    """
    from gauge_envs.tools.site import save_site
    from gauge_envs.tools.site.build import check_replaceable

    # Before the runs, which may take minutes.
    check_replaceable(out)
    results, skipped = loaded_files(sources, with_scene=True)
    if not results:
        raise ResultFileError("no result is left to report; gauge run writes them")
    stderr = stderr_console()
    named = [str(source) for source in sources or [Path("results")]]
    command = shlex.join(["gauge", "report", *named, "--out", str(out), *([] if replay else ["--no-replay"])])
    with progress_bar(stderr) as bar:
        task = bar.add_task("pages", total=len({result.id for result in results.values()}))

        def show(name: str) -> None:
            bar.update(task, advance=1, description=name)

        notes = save_site(results, out, replays=replay, command=command, progress=show)
    reasons: dict[str, list[str]] = {}
    for note in notes:
        reasons.setdefault(note.reason, []).append(f"{note.id.removeprefix('GAUGE/')} on {note.label}")
    for reason, names in reasons.items():
        text = plain_text(f"{', '.join(names)}: {reason}")
        stderr.print(f"[yellow]no replay:[/] {text}", soft_wrap=True)
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    stderr.print(f"{counted(len(results), 'result')}, {size / 1e6:.1f} MB")
    echo(out / "index.html")
    if skipped:
        raise typer.Exit(EXIT_FAILED)
