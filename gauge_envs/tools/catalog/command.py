"""`gauge list` and `gauge show`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from gauge_envs.cli.arguments import AssetOption, DriversOption, Json, ReferenceOption, Wide
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    plain_text,
    print_json_lines,
    print_table,
    stderr_console,
    stdout_console,
)
from gauge_envs.experiments.variants import matching_variants
from gauge_envs.references.imported import DataSource


def list_(
    pattern: Annotated[str, typer.Argument(help="Id or pattern such as 'SlopeSlider-*'.")] = "*",
    scored: Annotated[bool, typer.Option("--scored", help="Only ids with a reference, and so with a reward.")] = False,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """List experiments with their observable, the grade of their reference, and the engines that can run them.

    Exit code 1 when a wrong task file was skipped.
    """
    from gauge_envs.experiments.task_files import task_file_faults
    from gauge_envs.references.bands import BandGrade
    from gauge_envs.tools.catalog.listing import list_rows, list_table

    stderr = stderr_console()
    faults = task_file_faults()
    for fault in faults.values():
        stderr.print(f"[yellow]skipped:[/] {plain_text(str(fault))}", soft_wrap=True)
    found = list_rows(
        [variant for variant in matching_variants(pattern) if variant.family not in faults],
        isolate=True,
        notify=lambda text: stderr.print(f"[yellow]note:[/] {plain_text(text)}", soft_wrap=True),
    )
    rows = [row for row in found if not scored or row["grade"] != BandGrade.NONE]
    print_table(list_table(rows), json_lines=json_lines, wide=wide)
    if not json_lines:
        _print_counts(rows, with_control=pattern == "*" and not scored)
    if faults:
        raise typer.Exit(EXIT_FAILED)


def _print_counts(rows: list[dict[str, Any]], *, with_control: bool) -> None:
    from gauge_envs.experiments.variants import beyond_variants
    from gauge_envs.tools.catalog.control import control_summary

    families = len({row["family"] for row in rows})
    console = stdout_console()
    if with_control:
        console.print(control_summary())
        console.print(f"Beyond the benchmark: {', '.join(variant.id for variant in beyond_variants())}")
    console.print(f"{counted(len(rows), 'id')} in {families} {'family' if families == 1 else 'families'}")


def show(
    name: Annotated[str, typer.Argument(metavar="ID", help="Id, with or without GAUGE/; or an experiment file.")],
    asset: AssetOption = None,
    drivers: DriversOption = DataSource.BUNDLED,
    reference: ReferenceOption = DataSource.BUNDLED,
    json_lines: Json = False,
) -> None:
    """Show one experiment: scene, constants and their sources, reference, published scores.

    For a control task: law, limit and reward.
    """
    from gauge_envs.envs.control.tasks import control_tasks, find_control_task
    from gauge_envs.experiments.resolve import resolve_experiment
    from gauge_envs.tools.catalog.control import control_description, control_view
    from gauge_envs.tools.catalog.description import description, description_view

    if name.removeprefix("GAUGE/") in {task.name for task in control_tasks()}:
        values = control_description(find_control_task(name))
        view = control_view(values)
    else:
        values = description(resolve_experiment(name, drivers=drivers, reference=reference, asset=asset))
        view = description_view(values)
    if json_lines:
        print_json_lines([values])
    else:
        stdout_console().print(view)
