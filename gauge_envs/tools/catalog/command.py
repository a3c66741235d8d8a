"""`gauge list` and `gauge show`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, message, note, print_document
from gauge_envs.errors import TaskFileError
from gauge_envs.registry import id_modules, instruments_by

KINDS = instruments_by("listings")
"""Instrument of each kind that `gauge list` knows beside experiments."""


def list_(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KIND] [PATTERN]...",
            help=f"experiments by default, {', '.join(KINDS)}; ids, patterns.",
        ),
    ] = None,
    scored: Annotated[
        bool,
        typer.Option(
            "--scored", help="Only ids with a reference, and so with a reward."
        ),
    ] = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """List experiments; or backends, checks, phenomena, materials, scenes, ...

    Experiments have their observable, the grade of their reference, and the engines that can run them. The pattern '*'
    lists also phenomena of deformable bodies. Exit code 1 when a wrong task file was skipped.
    """
    from gauge_envs.pages.document import Document

    kind, *patterns = (
        words
        if words and words[0] in ("experiments", *KINDS)
        else ["experiments", *(words or ())]
    )
    if kind == "experiments":
        return _list_experiments(patterns, scored, form)
    print_document(Document(parts=KINDS[kind].function(f"list {kind}")(patterns)), form)
    return False


def _list_experiments(patterns: Sequence[str], scored: bool, form: Format) -> bool:
    """Print the experiments of patterns, and return whether a task file was skipped."""
    from gauge_envs.experiments.variants import beyond_variants, matching_variants
    from gauge_envs.pages.document import Document, Paragraph
    from gauge_envs.pages.text import counted
    from gauge_envs.references.grades import BandGrade
    from gauge_envs.tools.catalog.overview import list_table, stored_rows

    variants = dict.fromkeys(
        variant
        for pattern in patterns or ["*"]
        for variant in matching_variants(pattern)
    )
    faults: Mapping[str, TaskFileError] = {}
    found = stored_rows(variants)
    if found is None:
        from gauge_envs.experiments.task_files import task_file_faults
        from gauge_envs.tools.catalog.listing import list_rows

        faults = task_file_faults()
        for fault in faults.values():
            message(fault, "skipped")
        found = list_rows(
            [one for one in variants if one.family not in faults], notify=note
        )
    rows = [row for row in found if not scored or row["grade"] != BandGrade.NONE]
    families = len({row["family"] for row in rows})
    lines = [
        f"{counted(len(rows), 'id')} in {families} {'family' if families == 1 else 'families'}"
    ]
    if patterns in ([], ["*"]) and not scored:
        beyond = ", ".join(
            dict.fromkeys(f"{variant.family}-*" for variant in beyond_variants())
        )
        lines = [
            *(ids.summary() for ids in id_modules()),
            f"Beyond the benchmark: {beyond}",
            *lines,
        ]
    print_document(Document(parts=[list_table(rows), *map(Paragraph, lines)]), form)
    return bool(faults)


def show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="ID", help="Id, with or without GAUGE/; or an experiment file."
        ),
    ],
    asset: arguments.Asset = None,
    use: arguments.Use = "",
    form: arguments.Form = Format.TEXT,
) -> None:
    """Show one experiment or control task: reference, reward, spaces, engines, constants.

    `--format wide` adds the scene, decisions and the source of each number. For a control task: law, limit and reward.
    """
    from gauge_envs.experiments.resolve import resolve_experiment
    from gauge_envs.tools.catalog.description import description
    from gauge_envs.tools.catalog.words import experiment_document

    plain_name = name.removeprefix("GAUGE/")
    for ids in id_modules():
        if plain_name in ids.names():
            print_document(ids.document(plain_name), form)
            return
    experiment = resolve_experiment(
        name, asset=asset, **arguments.parsed_use(use, "drivers", "reference")
    )
    print_document(
        experiment_document(description(experiment), detailed=form is not Format.TEXT),
        form,
    )
