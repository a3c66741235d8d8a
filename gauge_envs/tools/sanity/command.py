"""`gauge sanity`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, check_one_format
from gauge_envs.cli.output import (
    EXIT_FAILED,
    echo,
    plain_text,
    print_json_lines,
    print_table,
    progress_bar,
    stderr_console,
    stdout_console,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from gauge_envs.tools.sanity import PhenomenonResult, Report, Verdict


class OtherEngine(StrEnum):
    """Engine on which flagged rows are run again."""

    MUJOCO_WARP = "mujoco_warp"


class FailOn(StrEnum):
    """Least bad verdict with which a sanity check fails."""

    WRONG = "wrong"
    VISIBLE = "visible"
    NEVER = "never"


def sanity(
    target: Annotated[
        str | None,
        typer.Argument(
            help="Training configuration: a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a task of "
            "dm_control's suite (dm_control:walker/walk), of MuJoCo Playground (playground:WalkerWalk), of mjlab or of "
            "ManiSkill (maniskill:PickCube-v1), the params/env.yaml of Isaac Lab, a model file (robot.xml), a settings "
            "file (.toml, .json), or a backend and a preset (mujoco:out_of_box)."
        ),
    ] = None,
    pair: Annotated[
        str | None,
        typer.Option(
            metavar="GEOM1,GEOM2",
            help="Two geoms whose contact constants are used; by default all on the ground.",
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="TARGET", help="Target where the policy runs: report what changes from the first target to it."
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Ids or patterns of phenomena, as 'creep-*,gravity'; repeatable."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Also check deformable bodies, which takes longer.")] = False,
    describe: Annotated[
        bool, typer.Option("--list", help="List ids, titles and kinds of the phenomena, and measure none.")
    ] = False,
    fail_on: Annotated[FailOn, typer.Option(help="Exit code 1 when a phenomenon is at least as bad as this.")] = (
        FailOn.NEVER
    ),
    baseline: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="JSON output of an earlier run; exit code 1 on regressions only."),
    ] = None,
    time_limit_s: Annotated[
        float | None,
        typer.Option(
            "--time-limit-s", min=0.0, help="Start no simulation after this time in s; other rows are declined."
        ),
    ] = None,
    on_engine: Annotated[
        OtherEngine | None,
        typer.Option(help="Run flagged rows of a MuJoCo model again on mujoco_warp: a minute more, longer at first."),
    ] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="File for an HTML page with pictures.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="The table as GitHub Markdown.")] = False,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Report which physics a training configuration gets wrong, and the change that corrects most of it.

    Runs measured objects with the numerical settings of the target and of this package's presets, and compares both
    with real trials and laws. Exit code 1 for a phenomenon as bad as --fail-on states, for a regression from
    --baseline, or when nothing could be measured.
    """
    from gauge_envs.tools.sanity import check, configuration
    from gauge_envs.tools.sanity.baseline import read_baseline
    from gauge_envs.tools.sanity.page import check_can_draw, save_sanity_page
    from gauge_envs.tools.sanity.phenomena import selection
    from gauge_envs.tools.sanity.stacks import compiled_model
    from gauge_envs.tools.sanity.words import phenomena_rows, phenomena_table

    check_one_format(json_lines, markdown)
    patterns = only or []
    if describe:
        listed = phenomena_rows(include_deformables=every, only=patterns)
        print_table(phenomena_table(listed), json_lines=json_lines, wide=wide)
        return
    if target is None:
        raise ParameterError("no target is given: name one, as in gauge sanity HalfCheetah-v5, or use --list")
    if against is not None:
        if html is not None or baseline is not None or pair is not None:
            raise ParameterError("--against goes with none of --html, --baseline and --pair: leave them out")
        _compare(target, against, patterns, every, time_limit_s, fail_on, json_lines, markdown, wide)
        return
    if html is not None:
        check_can_draw()
    before = None if baseline is None else read_baseline(baseline)
    checked = configuration(target, pair=_geom_pair(pair))
    with progress_bar(stderr_console()) as progress:
        bar = progress.add_task("phenomena", total=len(selection(patterns, include_deformables=every)))

        def notify(row: PhenomenonResult) -> None:
            progress.update(bar, advance=1, description=row.phenomenon)

        report = check(checked, only=patterns, include_deformables=every, time_limit_s=time_limit_s, notify=notify)
        if on_engine is not None:
            from gauge_envs.tools.sanity.mujoco_warp_run import with_mujoco_warp

            progress.update(bar, description=on_engine.value)
            report = with_mujoco_warp(report, model=compiled_model(target))
    print_report(report, json_lines, markdown, wide)
    if html is not None:
        stderr_console().print(plain_text(str(save_sanity_page(report, html))), soft_wrap=True)
    if has_failed(report, fail_on, before):
        raise typer.Exit(EXIT_FAILED)


def print_report(report: Report, json_lines: bool, markdown: bool, wide: bool) -> None:
    """Print a sanity check as JSON lines, as Markdown, or for a terminal."""
    from gauge_envs.tools.sanity.words import sanity_markdown, sanity_rows, sanity_view

    if json_lines:
        print_json_lines(sanity_rows(report))
    elif markdown:
        echo(sanity_markdown(report), nl=False)
    else:
        stdout_console().print(sanity_view(report, wide=wide))


def _compare(
    trained: str,
    deployed: str,
    patterns: list[str],
    every: bool,
    time_limit_s: float | None,
    fail_on: FailOn,
    json_lines: bool,
    markdown: bool,
    wide: bool,
) -> None:
    """Print what changes between two targets; exit code 1 for a change as large as --fail-on states."""
    from gauge_envs.tools.sanity.against import Change, compare
    from gauge_envs.tools.sanity.against_words import against_markdown, against_rows, against_view

    comparison = compare(trained, deployed, only=patterns, include_deformables=every, time_limit_s=time_limit_s)
    if json_lines:
        print_json_lines(against_rows(comparison))
    elif markdown:
        echo(against_markdown(comparison), nl=False)
    else:
        stdout_console().print(against_view(comparison, wide=wide))
    bad = {FailOn.WRONG: (Change.LARGE,), FailOn.VISIBLE: (Change.LARGE, Change.VISIBLE), FailOn.NEVER: ()}
    if any(row.change in bad[fail_on] for row in comparison.rows):
        raise typer.Exit(EXIT_FAILED)


def has_failed(report: Report, fail_on: FailOn, before: Mapping[str, Verdict] | None) -> bool:
    """Return whether a sanity check ends with an error, and print regressions from a baseline."""
    from gauge_envs.tools.sanity import Verdict
    from gauge_envs.tools.sanity.baseline import regressions

    applicable = [row for row in report.rows if row.applies]
    if applicable and report.worst is Verdict.DECLINED:
        return True
    if before is None:
        bad = {FailOn.WRONG: (Verdict.WRONG,), FailOn.VISIBLE: (Verdict.WRONG, Verdict.VISIBLE), FailOn.NEVER: ()}
        return report.worst in bad[fail_on]
    worse = regressions(report, before, least=Verdict.WRONG if fail_on is FailOn.WRONG else Verdict.VISIBLE)
    for row in worse:
        was = before.get(row.phenomenon, Verdict.DECLINED)
        stderr_console().print(plain_text(f"regression: {row.phenomenon}: {row.verdict.value}, was {was.value}"))
    return bool(worse)


def _geom_pair(text: str | None) -> tuple[str, str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise ParameterError(f"--pair {text!r}: expected the names of two geoms, as floor,foot")
    return names[0], names[1]
