"""`gauge sanity` and `gauge list phenomena`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from fnmatch import fnmatchcase
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
        "Write the model with the change that mends most, checked again: contact and solver settings.",
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
    out: OutOption = None,
    form: arguments.Form = Format.TEXT,
) -> int:
    """Report which physics a training configuration gets wrong, and what corrects it.

    Runs measured objects with the numerical settings of the target and of this package's presets, and compares both
    with real trials and laws; gauge list phenomena shows them. Deformable bodies, which take longer, are checked where
    a pattern of --only is '*' or names them alone. Exit code 0 when all that was asked for was measured and passed, 1
    for a row as bad as --fail-on states or farther from reality than in --baseline, 3 when rows were not measured.
    """
    from gauge_envs.tools.sanity import check, configuration
    from gauge_envs.tools.sanity.mended import check_can_mend, write_mended
    from gauge_envs.tools.sanity.phenomena import selection

    if target is None:
        raise ParameterError(
            "no target is given: name one, as in gauge sanity HalfCheetah-v5"
        )
    common: dict[str, Any] = {
        "only": only or [],
        "include_deformables": _with_deformables(only or []),
    }
    files = arguments.by_suffix(out, ".md", ".json")
    if against is not None:
        if baseline is not None or pair is not None or fix is not None:
            raise ParameterError(
                "--against goes with none of --baseline, --pair and --fix: leave them out"
            )
        return _compare(
            target,
            against,
            common | {"time_limit_s": timeout},
            fail_on,
            files,
            form,
        )
    exit_code = _judged_by(fail_on, baseline)
    if fix is not None:
        check_can_mend(fix)
    geoms = None if pair is None else tuple(pair)
    if geoms is not None and len(geoms) != 2:
        raise ParameterError(
            f"--pair {','.join(geoms)}: expected the names of two geoms, as floor,foot"
        )
    checked = configuration(target, pair=geoms)
    with Progress("phenomena", len(selection(**common))) as progress:
        report = check(
            checked,
            notify=lambda row: progress.advance(row.phenomenon),
            time_limit_s=timeout,
            **common,
        )
    _print_report(report, form, files)
    if fix is not None:
        message(write_mended(report, fix), "fix")
    return exit_code(report)


def _with_deformables(patterns: Sequence[str]) -> bool:
    """Return whether a pattern chooses deformable bodies: it is '*', or matches no row of rigid bodies."""
    from gauge_envs.tools.sanity.phenomena import selection

    return any(
        pattern == "*" or not any(fnmatchcase(name, pattern) for name in selection())
        for pattern in patterns
    )


def _print_report(report: Report, form: Format, files: Mapping[str, Path]) -> None:
    from gauge_envs.backends.mujoco.versions import SPARSE_FAULT
    from gauge_envs.pages.document import Document, Paragraph, Tone
    from gauge_envs.tools.sanity.model import UNREAD
    from gauge_envs.tools.sanity.words import is_clean, sanity_document, top_line

    shown = sanity_document(report)
    if form is Format.TEXT and is_clean(report):
        line = Paragraph(
            f"{report.configuration.name}: {top_line(report)}; {report.wall_s:.0f} s"
        )
        unread = [
            Paragraph(f"note: {n}", Tone.WARNING)
            for n in report.configuration.notes
            if n.startswith(UNREAD) or SPARSE_FAULT in n
        ]
        shown = Document(
            parts=(line, *unread), rows=shown.rows, markdown=shown.markdown
        )
    print_document(shown, form, files=files)


def _judged_by(
    fail_on: FailOn | None, baseline: Path | None
) -> Callable[[Report], int]:
    """Return what decides the exit code of a check, and prints regressions from a baseline."""
    from gauge_envs.tools.sanity import Verdict
    from gauge_envs.tools.sanity.run import read_baseline, regressions
    from gauge_envs.tools.sanity.words import regression_text

    before = None if baseline is None else read_baseline(baseline)
    least = Verdict.WRONG if fail_on is FailOn.WRONG else Verdict.VISIBLE
    bad = {FailOn.WRONG: (Verdict.WRONG,), FailOn.NEVER: ()}.get(
        fail_on or FailOn.VISIBLE, (Verdict.WRONG, Verdict.VISIBLE)
    )

    def exit_code(report: Report) -> int:
        is_bad = any(row.verdict in bad for row in report.flags.values())
        if before is not None:
            worse = regressions(report, before, least=least)
            for one in worse:
                message(regression_text(one), "regression")
            is_bad = bool(worse)
        return EXIT_FAILED if is_bad else EXIT_INCOMPLETE if report.unmeasured else 0

    return exit_code


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
    found = difference(*reports)
    print_document(difference_document(found), form, files=files)
    changed = [row for row in found.rows if row.is_changed]
    if fail_on is FailOn.WRONG:
        changed = [row for row in changed if row.is_wrong]
    if changed and fail_on is not FailOn.NEVER:
        return EXIT_FAILED
    is_measured = any(row.is_measured for row in found.rows)
    return 0 if is_measured else EXIT_INCOMPLETE


def list_phenomena(patterns: Sequence[str]) -> list[Table]:
    """Return the table of phenomena, those of deformable bodies only for patterns that choose them."""
    from gauge_envs.tools.sanity.words import phenomena_table

    return [
        phenomena_table(include_deformables=_with_deformables(patterns), only=patterns)
    ]
