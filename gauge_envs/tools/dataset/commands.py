"""`gauge data download`, `gauge data import` and `gauge list references`."""

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
    echo,
    message,
    print_document,
    print_json_lines,
)
from gauge_envs.pages.text import counted

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table


def data_download(
    patterns: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PATTERN",
            show_default="all trials",
            help="Files, as 'data/rigid/slope slider/*'.",
        ),
    ] = None,
    revision: Annotated[
        str | None,
        arguments.option(
            arguments.SELECTION,
            "Commit, branch or tag.",
            metavar="NAME",
            show_default="revision of the bundled data",
        ),
    ] = None,
    out: Annotated[
        Path | None, arguments.folder("Folder.", show_default="below the user's data")
    ] = None,
) -> None:
    """Download the GAUGE dataset (10 GB in all); an interrupted download resumes."""
    from gauge_envs.tools.dataset import download

    revision = revision or download.PINNED_REVISION
    commit = download.resolved_revision(revision)
    message(f"{download.DATASET}, revision {revision} is {commit}")
    patterns = patterns or [download.TRIAL_FILES]
    folder = download.download_dataset(commit, out, patterns)
    echo(folder)
    message(f"next: gauge data import '{folder}'")


def data_import(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder of the dataset, which contains 'data'."
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
            "Unit of lengths in files without a unit, as mm.",
            metavar="UNIT",
        ),
    ] = None,
    rate_hz: Annotated[
        float | None,
        arguments.measured(
            "--rate",
            "Hz",
            "Frames per second of files without a rate.",
            arguments.SCENE,
            is_positive=True,
        ),
    ] = None,
    keep: Annotated[
        bool,
        arguments.option(
            arguments.SELECTION,
            "Keep trials that are only too far from the others.",
            "--keep",
        ),
    ] = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Import real trials as bands and prescribed motions, and compare them with published baselines; offline.

    Damaged trials are listed and left out. Exit code 1: a trial or its prescribed motion was left out.
    """
    from gauge_envs.tools.dataset.importer import import_trials
    from gauge_envs.tools.dataset.layout import find_trials
    from gauge_envs.tools.dataset.report import import_document

    layout = find_trials(folder, only=patterns or ["*"])
    defaults = {"translation unit": unit, "FPS": rate_hz}
    imports, findings = [], [*layout.findings]
    with Progress("experiments", len(layout.files)) as progress:
        for trials in import_trials(layout, defaults=defaults, keep=keep):
            progress.advance(trials.variant.name)
            imports.append(trials)
            findings += trials.findings
            if form is Format.JSON:
                print_json_lines([trials.to_dict()])
    for finding in findings:
        if not finding.left_out:
            message(finding, "note")
    if form is Format.JSON:
        print_json_lines([{"finding": asdict(finding)} for finding in findings])
    else:
        print_document(import_document(imports, findings), form)
    stored = [trials.used for trials in imports if trials.facts is not None]
    message(
        f"{counted(sum(stored), 'trial')} of {counted(len(stored), 'experiment')} imported; "
        "use them by gauge run ID --use imported"
    )
    return any(finding.left_out for finding in findings)


def list_references(patterns: Sequence[str]) -> list[Table]:
    """Return the table of references, prescribed motions, and imported and published baselines of experiments."""
    from gauge_envs.experiments.variants import matching_variants
    from gauge_envs.tools.dataset.report import status_row, status_table

    variants = dict.fromkeys(
        variant
        for pattern in patterns or ["*"]
        for variant in matching_variants(pattern)
    )
    return [status_table([status_row(variant) for variant in variants])]
