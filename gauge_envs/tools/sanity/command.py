"""`gauge sanity`, `gauge sanity probe` and `gauge list phenomena`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    from gauge_envs.tools.sanity.comparison import Baseline


FAIL_ON = {"failed": {"failed"}, "warning": {"failed", "warning"}, "never": set[str]()}
"""Verdicts that give the exit code 1, by the value of `--fail-on`."""


def read_fail_on(text: str) -> str:
    """Return a value of `--fail-on`, which must be one of the known ones."""
    if text not in FAIL_ON:
        raise typer.BadParameter(f"{text!r}: expected {', '.join(FAIL_ON)}")
    return text


FailOnOption = Annotated[
    str,
    arguments.option(
        arguments.SELECTION,
        "Exit code 1 for this verdict or a worse one; with --against, for checks that differ.",
        metavar="|".join(FAIL_ON),
        parser=read_fail_on,
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
        "Write the model file with the fix, and check it again.",
        metavar="OUT.xml",
    ),
]


OutOption = Annotated[
    list[Path] | None,
    arguments.target("Tables (.md) or results (.json)."),
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
            "Check this target too, and print both side by side.",
            metavar="TARGET",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        arguments.timeout(
            "Start no simulation after this time.",
            "no limit",
            is_positive=False,
        ),
    ] = None,
    only: arguments.Only = None,
    fail_on: FailOnOption = "warning",
    baseline: BaselineOption = None,
    fix: FixOption = None,
    is_all: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT, "Also print the table of all checks.", "--all"
        ),
    ] = False,
    details: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "Also print settings, sources, and the changes that were tried.",
            "--details",
        ),
    ] = False,
    out: OutOption = None,
    form: arguments.Form = Format.TEXT,
) -> int:
    """Check the physics of a training configuration, and print the best fix of its settings.

    Runs the target's own model, then measured objects with its numerical settings, and compares both with mechanics and
    real trials; gauge list phenomena shows all checks. A wall and deformable bodies are checked where a pattern of
    --only is '*' or names them alone. Exit code 0: all checks were measured and passed. 1: a verdict of --fail-on, or a
    value farther from reality than in --baseline. 3: checks were not measured.
    """
    from gauge_envs.tools.sanity import check, configuration
    from gauge_envs.tools.sanity.comparison import read_baseline
    from gauge_envs.tools.sanity.fix_file import check_can_fix, write_fix
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
        check_can_fix(fix)
    geoms = None if pair is None else tuple(pair)
    if geoms is not None and len(geoms) != 2:
        raise ParameterError(
            f"--pair {','.join(geoms)}: expected the names of two geoms, as floor,foot"
        )
    checked = configuration(target, pair=geoms)
    with Progress("checks", len(selection(**chosen))) as progress:
        report = check(
            checked,
            notify=lambda result: progress.advance(result.id),
            time_limit_s=timeout,
            **chosen,
        )
    document = sanity_document(report, details=details, is_all=is_all)
    print_document(document, form, files=files)
    if fix is not None:
        message(write_fix(report, fix), "fix")
    if _fails(report, FAIL_ON[fail_on], earlier):
        return EXIT_FAILED
    return EXIT_INCOMPLETE if report.unmeasured else 0


def _fails(report: Report, verdicts: set[str], baseline: Baseline | None) -> bool:
    """Return whether a check has one of the verdicts, and with a baseline, is worse than there; print regressions."""
    from gauge_envs.tools.sanity.comparison import regressions

    if baseline is None:
        return any(result.verdict in verdicts for result in report.flags.values())
    worse = regressions(report, baseline, verdicts=verdicts)
    for text in worse:
        message(text, "regression")
    return bool(worse)


def _compare(
    first: str,
    second: str,
    options: dict[str, Any],
    fail_on: str,
    files: Mapping[str, Path],
    form: Format,
) -> int:
    """Print the checks of two targets side by side, and return the exit code."""
    from gauge_envs.tools.sanity import check
    from gauge_envs.tools.sanity.comparison import difference, difference_document

    reports = [check(target, explain=False, **options) for target in (first, second)]
    compared = difference(*reports)
    print_document(difference_document(compared), form, files=files)
    changed = [check for check in compared.checks if check.is_changed]
    if fail_on == "failed":
        changed = [check for check in changed if check.is_failed]
    if changed and FAIL_ON[fail_on]:
        return EXIT_FAILED
    is_measured = any(check.is_measured for check in compared.checks)
    return 0 if is_measured else EXIT_INCOMPLETE


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

    program = (Path(__file__).parent / "readers" / "gauge_probe.py").read_text(
        encoding="utf-8"
    )
    if out is None or str(out) == arguments.STDOUT:
        echo(program, nl=False)
    else:
        message(save_file(out, program))


def list_checks(patterns: Sequence[str]) -> list[Table]:
    """Return the table of checks, those of a wall and of deformable bodies only for patterns that choose them."""
    from gauge_envs.tools.sanity.report import checks_table

    return [checks_table(patterns)]
