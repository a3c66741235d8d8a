"""`gauge sanity`, and the command that carries settings from other machines."""

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
    echo,
    message,
    print_document,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.tools.sanity import Report


class ReportFormat(StrEnum):
    """Format of a sanity check on stdout."""

    TEXT = "text"
    WIDE = "wide"
    MARKDOWN = "markdown"
    JSON = "json"
    JUNIT = "junit"
    SARIF = "sarif"
    GITHUB = "github"


class FailOn(StrEnum):
    """Least bad verdict with which a sanity check fails."""

    WRONG = "wrong"
    VISIBLE = "visible"
    NEVER = "never"


FailOnOption = Annotated[
    FailOn | None,
    arguments.option(
        arguments.SELECTION,
        "Exit code 1 when a row is at least as bad; with --against, when a change is: wrong is large.",
        show_default="visible",
    ),
]

ReportForm = Annotated[
    ReportFormat,
    arguments.option(
        arguments.OUTPUT,
        "Format on stdout: text, wide with all columns, markdown, json; junit, sarif and github are for CI.",
        "--format",
        metavar="FORMAT",
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
        "Write the model with the change that mends most, checked again.",
        metavar="OUT.xml",
    ),
]

OutOption = Annotated[
    list[Path] | None,
    arguments.target("Pages (.html), tables (.md) or rows (.json)."),
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
            "Where the policy runs: report what changes to this target.",
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
    form: ReportForm = ReportFormat.TEXT,
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
    if against is not None:
        if baseline is not None or pair is not None or fix is not None:
            raise ParameterError(
                "--against goes with none of --baseline, --pair and --fix: leave them out"
            )
        files = arguments.by_suffix(out, ".md", ".json")
        return _compare(
            target,
            against,
            common | {"time_limit_s": timeout},
            fail_on,
            files,
            form,
        )
    exit_code, files = _judged_by(fail_on, baseline), _checked_files(out)
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


def _checked_files(out: Sequence[Path] | None) -> dict[str, Path]:
    """Return the files of `--out`; a page needs what draws its pictures."""
    from gauge_envs.tools.sanity.page import check_can_draw

    files = arguments.by_suffix(out, ".html", ".md", ".json")
    if ".html" in files:
        check_can_draw()
    return files


def _print_report(
    report: Report, form: ReportFormat, files: Mapping[str, Path]
) -> None:
    from gauge_envs.backends.mujoco.versions import SPARSE_FAULT
    from gauge_envs.pages.document import Document, Paragraph, Tone, save_file
    from gauge_envs.tools.sanity.formats import WRITERS
    from gauge_envs.tools.sanity.model import UNREAD
    from gauge_envs.tools.sanity.page import sanity_page
    from gauge_envs.tools.sanity.words import is_clean, sanity_document, top_line

    writers = {".html": lambda file: save_file(file, sanity_page(report))}
    shown = sanity_document(report)
    if form is ReportFormat.TEXT and is_clean(report):
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
    if form.value in WRITERS:
        echo(WRITERS[form.value](report))
        shown = Document(parts=(), rows=shown.rows, markdown=shown.markdown)
    printed = Format.TEXT if form.value in WRITERS else Format(form.value)
    print_document(shown, printed, files=files, writers=writers)


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
    trained: str,
    deployed: str,
    options: dict[str, Any],
    fail_on: FailOn | None,
    files: Mapping[str, Path],
    form: ReportFormat,
) -> int:
    """Print what changes between two targets, and return the exit code."""
    from gauge_envs.pages.document import Document
    from gauge_envs.tools.sanity.comparison import Change, compare
    from gauge_envs.tools.sanity.comparison_words import comparison_document
    from gauge_envs.tools.sanity.formats import github_comparison

    known = (*Format, ReportFormat.GITHUB)
    if form.value not in {one.value for one in known}:
        raise ParameterError(
            f"--format {form.value} is of a check; --against has {', '.join(known)}"
        )
    comparison = compare(trained, deployed, **options)
    shown = comparison_document(comparison)
    if form is ReportFormat.GITHUB:
        echo(github_comparison(comparison))
        shown = Document(parts=(), rows=shown.rows, markdown=shown.markdown)
    printed = Format.TEXT if form is ReportFormat.GITHUB else Format(form.value)
    print_document(shown, printed, files=files)
    bad = {
        FailOn.WRONG: (Change.LARGE,),
        FailOn.VISIBLE: (Change.LARGE, Change.VISIBLE),
    }.get(fail_on or FailOn.VISIBLE, ())
    changes = {row.change for row in comparison.rows} - {Change.NEITHER}
    return (
        EXIT_FAILED
        if changes & set(bad)
        else EXIT_INCOMPLETE
        if changes <= {Change.UNKNOWN}
        else 0
    )


def list_phenomena(patterns: Sequence[str]) -> list[Table]:
    """Return the table of phenomena, those of deformable bodies only for patterns that choose them."""
    from gauge_envs.tools.sanity.words import phenomena_table

    return [
        phenomena_table(include_deformables=_with_deformables(patterns), only=patterns)
    ]


def sanity_probe(
    out: Annotated[
        Path | None,
        arguments.target(
            "File to write, as gauge_probe.py; - is stdout.",
            metavar=f"PATH|{arguments.STDOUT}",
            show_default="stdout",
        ),
    ] = None,
) -> None:
    """Print a Python file that saves the settings of a training environment.

    Copy it to the training environment, where gauge-envs need not be installed, and run it there: python gauge_probe.py
    TARGET. Then run gauge sanity TARGET.gaugeprobe.json here.
    """
    from gauge_envs.pages.document import save_file

    program = Path(__file__).with_name("gauge_probe.py").read_text(encoding="utf-8")
    if out is None or str(out) == arguments.STDOUT:
        echo(program, nl=False)
    else:
        message(save_file(out, program))
