"""Commands that write the scenes of a sanity check for other simulators, and judge the motion that they return."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, check_one_format
from gauge_envs.cli.output import EXIT_FAILED, counted, plain_text, print_json_lines, stderr_console, stdout_console
from gauge_envs.tools.sanity.command import FailOn, has_failed, print_report

Only = Annotated[
    list[str] | None,
    typer.Option("--only", help="Ids or patterns of phenomena, as 'creep-*,gravity'; repeatable."),
]


def sanity_export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New folder, or one of an earlier export.")],
    only: Only = None,
    json_lines: Json = False,
) -> None:
    """Write the scenes of a sanity check for any simulator: MJCF, USD, URDF, drivers, a manifest and a loop.

    Run the scenes in your simulator, as README.md in the folder explains, and judge them with gauge sanity judge DIR.
    """
    from gauge_envs.tools.sanity.exchange.export import export
    from gauge_envs.tools.sanity.exchange.scenes import scenes

    written = export(folder, only=only or [])
    if json_lines:
        print_json_lines([{"file": str(path)} for path in written])
        return
    chosen = scenes(only or [])
    stdout_console().print(
        plain_text(f"{folder}: {counted(len(chosen), 'scene')}, {counted(len(written), 'file')}"), soft_wrap=True
    )
    stderr_console().print(plain_text(f"next: read {folder / 'README.md'}"), soft_wrap=True)


def sanity_judge(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of gauge sanity export, with your motion.")],
    engine: Annotated[str, typer.Option(metavar="NAME", help="Name of your simulator for the report.")] = "",
    only: Only = None,
    fail_on: Annotated[FailOn, typer.Option(help="Exit code 1 when a phenomenon is at least as bad as this.")] = (
        FailOn.NEVER
    ),
    baseline: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="JSON output of an earlier run; exit code 1 on regressions only."),
    ] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="File for an HTML page with pictures.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="The table as GitHub Markdown.")] = False,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Report which physics a simulator gets wrong, from the motion that it wrote for exported scenes.

    Exit code 1 for a phenomenon as bad as --fail-on states, for a regression from --baseline, or when nothing could be
    measured. A scene without a motion file is declined.
    """
    from gauge_envs.tools.sanity.baseline import read_baseline
    from gauge_envs.tools.sanity.exchange.judge import judge
    from gauge_envs.tools.sanity.page import check_can_draw, save_sanity_page

    check_one_format(json_lines, markdown)
    if html is not None:
        check_can_draw()
    before = None if baseline is None else read_baseline(baseline)
    report = judge(folder, only=only or [], engine=engine)
    print_report(report, json_lines, markdown, wide)
    if html is not None:
        stderr_console().print(plain_text(str(save_sanity_page(report, html))), soft_wrap=True)
    if has_failed(report, fail_on, before):
        raise typer.Exit(EXIT_FAILED)
