"""`gauge list` and `gauge show`.

The table of families is `families.json`, which `python -m scripts build` writes, so that its list reads no task files.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.commands import listings
from gauge_envs.cli.output import Format, echo, message, note, print_document

if TYPE_CHECKING:
    from gauge_envs.experiments.variants import Variant
    from gauge_envs.pages.table import Table

KINDS = listings()
"""Lists of `gauge list` besides experiments, by kind."""

SYNONYMS = {kind.removesuffix("s"): kind for kind in ("experiments", *KINDS)} | {
    "engines": "backends",
    "engine": "backends",
    "envs": "experiments",
    "environments": "experiments",
    "ids": "experiments",
}
"""Kinds by alternative words."""


def list_(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KIND or PATTERN",
            show_default="experiments",
            help=f"What to list: {', '.join(KINDS)}; then ids or patterns.",
        ),
    ] = None,
    scored: Annotated[
        bool,
        arguments.option(arguments.SELECTION, "Only ids with scores.", "--scored"),
    ] = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """List experiments; or backends, checks, phenomena, materials, scenes, ...

    Without a pattern, the list has a row for each family. With a pattern it has the kind of reference of each id, and
    the engines that can run it. Exit code 1: a wrong task file was skipped.
    """
    from gauge_envs.pages.document import Document

    kind, *patterns = words or ["experiments"]
    kind = SYNONYMS.get(kind, kind)
    if kind in KINDS:
        print_document(Document(parts=KINDS[kind].function()(patterns)), form)
        return False
    if kind != "experiments":
        patterns = words or []
    return _list_experiments(patterns, scored, form)


def _list_experiments(patterns: Sequence[str], scored: bool, form: Format) -> bool:
    """Print the experiments that match patterns, and return whether a task file was skipped."""
    from gauge_envs.experiments.variants import (
        matching_variants,
        unreadable_task_files,
    )
    from gauge_envs.pages.document import Document, Paragraph
    from gauge_envs.pages.text import counted

    faults = unreadable_task_files()
    for fault in faults:
        message(fault, "skipped")
    variants: list[Variant] = []
    for pattern in patterns or ["*"]:
        variants += matching_variants(pattern)
    is_whole = not patterns and not scored
    if is_whole and form is Format.TEXT:
        table, count = _family_table(), len(variants)
    else:
        table = _experiment_table(variants, scored)
        count = len(table.rows)
    lines = [counted(count, "id")]
    if is_whole:
        lines = [f"{lines[0]}; for the ids of a family: gauge list 'SlopeSlider-*'"]
        lines += _beyond_the_benchmark()
    print_document(Document(parts=[table, *map(Paragraph, lines)]), form)
    return bool(faults)


def _family_table() -> Table:
    """Return one row for each family: ids by kind of reference, and what it evaluates."""
    from gauge_envs.pages.table import grid

    text = (Path(__file__).parent / "families.json").read_text(encoding="utf-8")
    return grid(("family", "ids by kind of reference", "evaluates"), json.loads(text))


def _experiment_table(variants: Sequence[Variant], scored: bool) -> Table:
    """Return one row for each variant, with the engines that can run it."""
    from gauge_envs.references.kind import Kind
    from gauge_envs.tools.catalog.listing import list_rows
    from gauge_envs.tools.catalog.report import list_table

    rows = list_rows(dict.fromkeys(variants), notify=note)
    if scored:
        rows = [row for row in rows if row["kind"] != Kind.NONE]
    return list_table(rows)


def _beyond_the_benchmark() -> list[str]:
    """Return a line for each group of ids outside of the table."""
    from gauge_envs.experiments.variants import beyond_variants, user_variants
    from gauge_envs.tools.control import summary

    users = user_variants()
    families = dict.fromkeys(
        f"{variant.family}-*" for variant in beyond_variants() if variant not in users
    )
    lines = [summary()]
    lines.append(f"Beyond the benchmark: {', '.join(families)}")
    if users:
        lines.append(f"Of GAUGE_TASKS: {', '.join(variant.name for variant in users)}")
    return lines


def list_schemas(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the JSON Schemas and their versions."""
    from gauge_envs.cli.schemas import schema_names
    from gauge_envs.pages.table import Column, Table

    rows = [
        {"name": name, "version": version} for name, version in schema_names().items()
    ]
    columns = (Column("name", "schema"), Column("version", "version"))
    return arguments.matching(
        [Table(columns=columns, rows=rows)], patterns, kind="schema"
    )


def show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="ID",
            help="Id, with or without GAUGE/; or a task file.",
        ),
    ],
    schema: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "JSON Schema of the output of a command with --json; ID is the command, as 'list materials'.",
            "--schema",
        ),
    ] = False,
    asset: arguments.Asset = None,
    use: arguments.Use = None,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Show one experiment or control task: reference, reward, spaces, engines, constants.

    `--format wide` adds the scene, decisions and the source of each number. A control task has law, limit and reward.
    """
    if schema:
        from gauge_envs.cli.schemas import output_schema

        echo(json.dumps(output_schema(name), indent=1))
        return
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.tools import control
    from gauge_envs.tools.catalog.description import description
    from gauge_envs.tools.catalog.report import experiment_document, full_document

    plain_name = name.removeprefix("GAUGE/")
    if plain_name in control.names():
        print_document(control.document(plain_name), form)
        return
    experiment = load_experiment(
        name, asset=asset, **arguments.parsed_use(use, "drivers", "reference")
    )
    if experiment.unused_restitution:
        note(experiment.unused_restitution)
    document = full_document
    if form is Format.TEXT:
        document = experiment_document
    print_document(document(description(experiment)), form)
