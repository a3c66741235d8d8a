"""`gauge list`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.commands import listings
from gauge_envs.cli.output import Format, message, note, print_document
from gauge_envs.registry import id_modules

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table

KINDS = listings()
"""What `gauge list` lists other than experiments, by kind."""

OTHER_WORDS = {kind.removesuffix("s"): kind for kind in ("experiments", *KINDS)} | {
    "engines": "backends",
    "engine": "backends",
    "envs": "experiments",
    "environments": "experiments",
    "ids": "experiments",
}
"""Kinds by the words that others have for them."""


def list_(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KIND or PATTERN",
            show_default="experiments",
            help=f"What to list, {', '.join(KINDS)}; then ids or patterns.",
        ),
    ] = None,
    scored: Annotated[
        bool,
        arguments.option(arguments.SELECTION, "Only ids that have scores.", "--scored"),
    ] = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """List experiments; or backends, checks, phenomena, materials, scenes, ...

    Experiments have their observable, the kind of their reference, and the engines that can run them. The pattern '*'
    lists also phenomena of deformable bodies. Exit code 1 when a wrong task file was skipped.
    """
    from gauge_envs.pages.document import Document

    kind, *patterns = words or ["experiments"]
    kind = OTHER_WORDS.get(kind, kind)
    if kind not in ("experiments", *KINDS):
        kind, patterns = "experiments", words or []
    if kind == "experiments":
        return _list_experiments(patterns, scored, form)
    print_document(Document(parts=KINDS[kind].function()(patterns)), form)
    return False


def _list_experiments(patterns: Sequence[str], scored: bool, form: Format) -> bool:
    """Print the experiments of patterns, and return whether a task file was skipped."""
    from gauge_envs.experiments.variants import (
        beyond_variants,
        matching_variants,
        unreadable_task_files,
        user_variants,
    )
    from gauge_envs.pages.document import Document, Paragraph
    from gauge_envs.pages.text import counted
    from gauge_envs.references.kind import Kind
    from gauge_envs.tools.catalog.listing import list_rows
    from gauge_envs.tools.catalog.words import list_table

    faults = unreadable_task_files()
    for fault in faults:
        message(fault, "skipped")
    variants = dict.fromkeys(
        variant
        for pattern in patterns or ["*"]
        for variant in matching_variants(pattern)
    )
    found = list_rows(variants, notify=note)
    rows = [row for row in found if not scored or row["kind"] != Kind.NONE]
    families = len({row["family"] for row in rows})
    lines = [
        f"{counted(len(rows), 'id')} in {families} {'family' if families == 1 else 'families'}"
    ]
    if patterns in ([], ["*"]) and not scored:
        beyond = ", ".join(
            dict.fromkeys(
                f"{variant.family}-*"
                for variant in beyond_variants()
                if variant not in user_variants()
            )
        )
        user_names = [variant.name for variant in user_variants()]
        lines = [
            *(ids.summary() for ids in id_modules()),
            f"Beyond the benchmark: {beyond}",
            *([f"Of GAUGE_TASKS: {', '.join(user_names)}"] if user_names else []),
            *lines,
        ]
    print_document(Document(parts=[list_table(rows), *map(Paragraph, lines)]), form)
    return bool(faults)


def list_schemas(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the JSON Schemas and their versions."""
    from gauge_envs.cli.schemas import schema_names
    from gauge_envs.pages.table import Column, Table

    rows = [{"name": name, "version": one} for name, one in schema_names().items()]
    columns = (Column("name", "schema"), Column("version", "version"))
    return arguments.matching(
        [Table(columns=columns, rows=rows)], patterns, kind="schema"
    )
