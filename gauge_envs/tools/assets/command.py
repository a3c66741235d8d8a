"""`gauge assets`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.arguments import Json
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    echo,
    plain_text,
    print_table,
    stderr_console,
)
from gauge_envs.experiments.variants import matching_variants

assets_app = typer.Typer(help="Scenes as USD, MJCF and OBJ for other tools.", no_args_is_help=True)


@assets_app.command("build")
def assets_build(
    out: Annotated[Path | None, typer.Option(help="Folder; the checked-in assets/ by default.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit code 1 if a file is stale.")] = False,
) -> None:
    """Build every scene as USD and MJCF, and every solid as OBJ, from the task files."""
    from gauge_envs.tools.assets.build import assets_folder, build_assets, stale_asset

    folder = out or assets_folder()
    if not check:
        echo(f"{counted(len(build_assets(folder)), 'file')} in {folder}")
    elif stale := stale_asset(folder):
        stderr_console().print(f"[red]stale:[/] {plain_text(str(stale))}; gauge assets build renews it", soft_wrap=True)
        raise typer.Exit(EXIT_FAILED)
    else:
        echo(f"{folder} is current")


@assets_app.command("list")
def assets_list(json_lines: Json = False) -> None:
    """List the built assets and their experiments."""
    from gauge_envs.pages.table import Column, Table
    from gauge_envs.tools.assets.build import asset_rows, assets_folder

    columns = (
        Column("file", "file"),
        Column("bytes", "KiB", lambda size: f"{size / 1024:.1f}", is_number=True),
        Column("of", "of", _owners_text),
    )
    print_table(Table(columns=columns, rows=asset_rows(assets_folder())), json_lines=json_lines)


@assets_app.command("isaac-sim")
def assets_isaac_sim(
    pattern: Annotated[str, typer.Argument(metavar="ID", help="Id or pattern, as 'TextileBending-*'.")],
    out: Annotated[Path, typer.Option(help="Folder for the layers.")] = Path("isaac_sim"),
) -> None:
    """Write experiments as USD layers that Isaac Sim simulates with examples/isaac_sim/run_layer.py."""
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.tools.assets.isaac_sim import unsupported_reason, write_isaac_sim_layer

    experiments = [load_experiment(variant) for variant in matching_variants(pattern)]
    reasons = [unsupported_reason(experiment.scene) for experiment in experiments]
    supported = [experiment for experiment, reason in zip(experiments, reasons, strict=True) if reason is None]
    # If all are unsupported, the first one raises its reason.
    for experiment in supported or experiments[:1]:
        path = out / f"{experiment.name}.usda"
        write_isaac_sim_layer(experiment, path)
        echo(path)
    for experiment, reason in zip(experiments, reasons, strict=True):
        if reason is not None:
            stderr_console().print(plain_text(f"{experiment.id} is left out: {reason}"), soft_wrap=True)


def _owners_text(names: str) -> str:
    first, *others = names.split(", ")
    return f"{first} and {len(others)} more" if others else first
