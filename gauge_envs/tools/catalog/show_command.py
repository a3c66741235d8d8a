"""`gauge show`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, echo, print_document
from gauge_envs.registry import id_modules


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
            "JSON Schema of what a command prints with --json; ID is its name, as 'list materials'.",
            "--schema",
        ),
    ] = False,
    asset: arguments.Asset = None,
    use: arguments.Use = None,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Show one experiment or control task: reference, reward, spaces, engines, constants.

    `--format wide` adds the scene, decisions and the source of each number. For a control task: law, limit and reward.
    """
    if schema:
        from gauge_envs.cli.schemas import output_schema

        echo(json.dumps(output_schema(name), indent=1))
        return
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.tools.catalog.description import description
    from gauge_envs.tools.catalog.words import experiment_document

    plain_name = name.removeprefix("GAUGE/")
    for ids in id_modules():
        if plain_name in ids.names():
            print_document(ids.document(plain_name), form)
            return
    experiment = load_experiment(
        name, asset=asset, **arguments.parsed_use(use, "drivers", "reference")
    )
    print_document(
        experiment_document(description(experiment), detailed=form is not Format.TEXT),
        form,
    )
