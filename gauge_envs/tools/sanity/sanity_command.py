"""`gauge sanity` and `gauge list phenomena`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    EXIT_FAILED,
    EXIT_INCOMPLETE,
    Format,
    Progress,
    message,
    print_document,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.tools.sanity import Report
    from gauge_envs.tools.sanity.comparison import Baseline


class FailOn(StrEnum):
    """Least bad verdict with which a sanity check fails."""

    WRONG = "wrong"
    VISIBLE = "visible"
    NEVER = "never"


FailOnOption = Annotated[
    FailOn | None,
    arguments.option(
        arguments.SELECTION,
        "Exit code 1 when a row is at least as bad; with --against, when one of two that differ is.",
        show_default="visible",
    ),
]


BaselineOption = Annotated[
    Path | None,
    arguments.option(
        arguments.SELECTION,
        "JSON of an earlier run; exit code 1 on regressions only.",
        metavar="FILE",
    ),
]


FixOption = Annotated[
    Path | None,
    arguments.option(
        arguments.OUTPUT,
        "Write the model file with the change of settings, checked again.",
        metavar="OUT.xml",
    ),
]


OutOption = Annotated[
    list[Path] | None,
    arguments.target("Tables (.md) or rows (.json)."),
]


def sanity(
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="TARGET",
            help="Training configuration: a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a model file "
            "(robot.xml), the params/env.yaml of Isaac Lab, a file that gauge sanity probe's program writes in any "
            "other environment, a settings file (.toml, .json), or a backend and a preset (mujoco:out_of_box).",
        ),
    ] = None,
    pair: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SCENE,
            "The two geoms whose contact counts, as floor,foot.",
            metavar="GEOM",
            show_default="all on the ground",
        ),
    ] = None,
    against: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Check this target too, and print the rows of both beside each other.",
            metavar="TARGET",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        arguments.timeout(
            "Start no simulation after this time; decline other rows.",
            "no limit",
            is_positive=False,
        ),
    ] = None,
    only: arguments.Only = None,
    fail_on: FailOnOption = None,
    baseline: BaselineOption = None,
    fix: FixOption = None,
    every: Annotated[
        bool,
        arguments.option(arguments.OUTPUT, "Also the table of all rows.", "--all"),
    ] = False,
    details: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "Also what was read, sources, and the changes that were tried.",
            "--details",
        ),
    ] = False,
    out: OutOption = None,
    form: arguments.Form = Format.TEXT,
) -> int:
    """Report what is wrong in a training configuration, and the change of settings that corrects most.

    Runs the target's own model, then measured objects with its numerical settings, and compares both with mechanics and
    real trials; gauge list phenomena shows all rows. A wall and deformable bodies are checked where a pattern of --only
    is '*' or names them alone. Exit code 0 when all that was asked for was measured and passed, 1 for a row as bad as
    --fail-on names or farther from reality than in --baseline, 3 when rows were not measured.
    """
    from gauge_envs.tools.sanity import check, configuration
    from gauge_envs.tools.sanity.comparison import read_baseline
    from gauge_envs.tools.sanity.mended import check_can_mend, write_mended
    from gauge_envs.tools.sanity.report import sanity_document
    from gauge_envs.tools.sanity.selection import chooses_deformables, selection

    if target is None:
        raise ParameterError(
            "no target is given: name one, as in gauge sanity HalfCheetah-v5"
        )
    chosen: dict[str, Any] = {
        "only": only or [],
        "include_deformables": chooses_deformables(only or []),
    }
    files = arguments.by_suffix(out, ".md", ".json")
    if against is not None:
        if baseline is not None or pair is not None or fix is not None:
            raise ParameterError(
                "--against goes with none of --baseline, --pair and --fix: leave them out"
            )
        options = chosen | {"time_limit_s": timeout}
        return _compare(target, against, options, fail_on, files, form)
    earlier = None if baseline is None else read_baseline(baseline)
    if fix is not None:
        check_can_mend(fix)
    geoms = None if pair is None else tuple(pair)
    if geoms is not None and len(geoms) != 2:
        raise ParameterError(
            f"--pair {','.join(geoms)}: expected the names of two geoms, as floor,foot"
        )
    checked = configuration(target, pair=geoms)
    with Progress("rows", len(selection(**chosen))) as progress:
        report = check(
            checked,
            notify=lambda row: progress.advance(row.phenomenon),
            time_limit_s=timeout,
            **chosen,
        )
    document = sanity_document(report, details=details, every=every)
    print_document(document, form, files=files)
    if fix is not None:
        message(write_mended(report, fix), "fix")
    if _is_bad(report, fail_on or FailOn.VISIBLE, earlier):
        return EXIT_FAILED
    return EXIT_INCOMPLETE if report.unmeasured else 0


def _is_bad(report: Report, fail_on: FailOn, baseline: Baseline | None) -> bool:
    """Return whether a row is as bad as `fail_on`, and with a baseline, worse than there; regressions are printed."""
    from gauge_envs.tools.sanity import Verdict
    from gauge_envs.tools.sanity.comparison import regressions

    least = Verdict.WRONG if fail_on is FailOn.WRONG else Verdict.VISIBLE
    if baseline is not None:
        worse = regressions(report, baseline, least=least)
        for text in worse:
            message(text, "regression")
        return bool(worse)
    bad = {Verdict.WRONG, least} if fail_on is not FailOn.NEVER else set()
    return any(row.verdict in bad for row in report.flags.values())


def _compare(
    first: str,
    second: str,
    options: dict[str, Any],
    fail_on: FailOn | None,
    files: Mapping[str, Path],
    form: Format,
) -> int:
    """Print the rows of two targets beside each other, and return the exit code."""
    from gauge_envs.tools.sanity import check, difference
    from gauge_envs.tools.sanity.comparison import difference_document

    reports = [check(target, explain=False, **options) for target in (first, second)]
    compared = difference(*reports)
    print_document(difference_document(compared), form, files=files)
    changed = [row for row in compared.rows if row.is_changed]
    if fail_on is FailOn.WRONG:
        changed = [row for row in changed if row.is_wrong]
    if changed and fail_on is not FailOn.NEVER:
        return EXIT_FAILED
    is_measured = any(row.is_measured for row in compared.rows)
    return 0 if is_measured else EXIT_INCOMPLETE


def list_phenomena(patterns: Sequence[str]) -> list[Table]:
    """Return the table of rows, those of a wall and of deformable bodies only for patterns that choose them."""
    from gauge_envs.tools.sanity.report import phenomena_table
    from gauge_envs.tools.sanity.selection import chooses_deformables

    deformables = chooses_deformables(patterns)
    return [phenomena_table(include_deformables=deformables, only=patterns)]
