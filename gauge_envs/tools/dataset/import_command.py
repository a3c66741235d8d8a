"""`gauge data import` and `gauge list references`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    Progress,
    message,
    print_document,
    print_json_lines,
)
from gauge_envs.pages.text import counted

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table


def data_import(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder of the dataset, which holds 'data'."
        ),
    ],
    patterns: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ID", show_default="all", help="Ids or patterns of experiments."
        ),
    ] = None,
    unit: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Unit of lengths in files that state none, as mm.",
            metavar="UNIT",
        ),
    ] = None,
    rate_hz: Annotated[
        float | None,
        arguments.measured(
            "--rate",
            "Hz",
            "Frames a second of files that state no rate.",
            arguments.SCENE,
            is_positive=True,
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Make bands and drivers of real trials, beside the published baselines; offline.

    A damaged file is reported and left out. Exit code 1 when any file was left out.
    """
    from gauge_envs.tools.dataset.forms import Stated
    from gauge_envs.tools.dataset.importer import import_trials
    from gauge_envs.tools.dataset.layout import find_trials
    from gauge_envs.tools.dataset.words import import_document

    layout = find_trials(folder, only=patterns or ["*"])
    imports, findings = [], list(layout.findings)
    with Progress("trials", layout.count) as progress:
        for one in import_trials(
            layout,
            stated=Stated(unit=unit, rate_hz=rate_hz),
            advance=lambda path: progress.advance(layout.relative(path)),
        ):
            imports.append(one)
            findings += one.findings
            if form is Format.JSON:
                print_json_lines([one.to_dict()])
    for finding in findings:
        message(finding, "left out" if finding.left_out else "note")
    if form is Format.JSON:
        print_json_lines([{"finding": asdict(finding)} for finding in findings])
    else:
        print_document(import_document(imports), form)
    kept = sum(one.facts is not None for one in imports)
    message(
        f"{counted(sum(one.used for one in imports), 'trial')} of {counted(kept, 'experiment')} imported"
    )
    if kept:
        message(
            "Use them with `gauge run ID --use imported`; the default stays bundled."
        )
    return any(finding.left_out for finding in findings)


def list_references(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the reference and drivers of experiments, with imported and published baselines."""
    from gauge_envs.experiments.variants import matching_variants
    from gauge_envs.tools.dataset.words import status_row, status_table

    variants = dict.fromkeys(
        variant
        for pattern in patterns or ["*"]
        for variant in matching_variants(pattern)
    )
    return [status_table([status_row(variant) for variant in variants])]
