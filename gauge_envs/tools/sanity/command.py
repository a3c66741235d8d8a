"""`gauge sanity`, `gauge sanity probe` and `gauge list phenomena`."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from gauge_envs.files import json_ready

if TYPE_CHECKING:
    from gauge_envs.pages.document import Document
    from gauge_envs.pages.table import Table
    from gauge_envs.tools.sanity import Report


def sanity(
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="TARGET",
            help="Training configuration: a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a model file "
            "(robot.xml), a file that gauge sanity probe's program writes in any "
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
    stack: Annotated[
        str,
        arguments.option(
            arguments.SCENE,
            "With --pair: friction and restitution of the same materials in isaac, physx, newton, genesis, mujoco, "
            "pybullet, rapier or drake, with the source of the rule.",
            "--as",
            metavar="STACK",
            show_default="all",
        ),
    ] = "",
    against: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Check this target too, and print both side by side.",
            metavar="TARGET",
        ),
    ] = None,
    only: arguments.Only = None,
    is_strict: Annotated[
        bool,
        arguments.option(
            arguments.SELECTION,
            "Exit code 1 for warnings too; with --against, for checks that differ.",
            "--strict",
        ),
    ] = False,
    fix: Annotated[
        Path | None,
        arguments.option(
            arguments.OUTPUT,
            "Write the model file and included ones with the fixes, and check them again.",
            metavar="OUT.xml",
        ),
    ] = None,
    is_all: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "Also print all checks, and the sources of the findings.",
            "--all",
        ),
    ] = False,
    out: Annotated[
        list[Path] | None, arguments.target("Tables (.md) or results (.json).")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> int:
    """Check the physics of a robot model or an RL task, and name causes before effects.

    Reads the target's own model, runs it, then runs measured objects with its numerical settings, and compares all with
    mechanics and real trials; gauge list phenomena shows all checks. Exit code 0: no error, all checks were measured.
    1: an error, or with --strict a warning. 3: checks were not measured.
    """
    from gauge_envs.tools.sanity import check, configuration
    from gauge_envs.tools.sanity.fix_file import check_can_fix, write_fix
    from gauge_envs.tools.sanity.pair import pair_parts, touching_table
    from gauge_envs.tools.sanity.report import sanity_document
    from gauge_envs.tools.sanity.target_checks import selection

    if target is None:
        raise ParameterError(
            "no target is given: name one, as in gauge sanity HalfCheetah-v5"
        )
    chosen = only or []
    files = arguments.by_suffix(out, ".md", ".json")
    if against is not None:
        if pair is not None or fix is not None:
            raise ParameterError(
                "--against goes with neither --pair nor --fix: leave them out"
            )
        return _compare(target, against, chosen, is_strict, files, form)
    if fix is not None:
        check_can_fix(fix)
    geoms = None if pair is None else tuple(pair)
    if geoms is not None and len(geoms) != 2:
        raise ParameterError(
            f"--pair {','.join(geoms)}: expected the names of two geoms, as floor,foot"
        )
    checked = configuration(target, pair=geoms)
    with Progress("checks", len(selection(chosen))) as progress:
        report = check(
            checked, only=chosen, notify=lambda result: progress.advance(result.id)
        )
    document = sanity_document(report, is_all=is_all)
    if geoms is not None:
        of_pair = pair_parts(checked, (geoms[0], geoms[1]), stack)
        document = replace(document, parts=[*of_pair, *document.parts])
    elif not only:
        document = replace(document, parts=[*document.parts, *touching_table(checked)])
    _print(document, form, files)
    _annotate(report)
    if fix is not None:
        message(write_fix(report, fix), "fix")
    if report.errors or (is_strict and report.warnings):
        return EXIT_FAILED
    return EXIT_INCOMPLETE if report.unmeasured else 0


def _print(document: Document, form: Format, files: dict[str, Path]) -> None:
    """Print a document, and write it to files."""
    from gauge_envs.pages.document import as_rows, save_file

    if json_file := files.pop(".json", None):
        text = json.dumps(json_ready(as_rows(document)), allow_nan=False, indent=1)
        message(save_file(json_file, text))
    print_document(document, form, files=files)


def _annotate(report: Report) -> None:
    """Annotate the lines of a model in a workflow of GitHub."""
    from gauge_envs.tools.sanity.report import workflow_commands

    if os.environ.get("GITHUB_ACTIONS") == "true":
        for command in workflow_commands(report):
            typer.echo(command, err=True)


def _compare(
    first: str,
    second: str,
    only: Sequence[str],
    is_strict: bool,
    files: dict[str, Path],
    form: Format,
) -> int:
    """Print the checks of two targets side by side, and return the exit code."""
    from gauge_envs.tools.sanity import check
    from gauge_envs.tools.sanity.comparison import difference, difference_document

    reports = [check(target, explain=False, only=only) for target in (first, second)]
    compared = difference(*reports)
    _print(difference_document(compared), form, files)
    changed = [check for check in compared.checks if check.is_changed]
    if is_strict and changed:
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
    """Return the table of checks."""
    from gauge_envs.tools.sanity.report import checks_table

    return [checks_table(patterns)]
