"""`gauge data scenes` and `gauge data isaac-sim`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import matching
from gauge_envs.cli.output import counted, echo, message

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table


def data_scenes(
    out: Annotated[Path | None, typer.Option(help="Folder; the checked-in assets/ by default.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit code 1 if a file is stale.")] = False,
) -> bool:
    """Write every scene as USD and MJCF, and every solid as OBJ."""
    from gauge_envs.tools.assets.build import assets_folder, build_assets, stale_asset

    folder = out or assets_folder()
    if not check:
        echo(f"{counted(len(build_assets(folder)), 'file')} in {folder}")
    elif stale := stale_asset(folder):
        message(f"{stale}; gauge data scenes renews it", "stale")
        return True
    else:
        echo(f"{folder} is current")
    return False


def list_scenes(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the built files and the experiments that they show."""
    from gauge_envs.pages.table import Column, Table
    from gauge_envs.tools.assets.build import asset_rows, assets_folder

    columns = (
        Column("file", "file"),
        Column("bytes", "KiB", lambda size: f"{size / 1024:.1f}", is_number=True),
        Column("of", "of", _owners_text),
    )
    return matching([Table(columns=columns, rows=asset_rows(assets_folder()))], patterns, kind="scene")


def _owners_text(names: str) -> str:
    first, *others = names.split(", ")
    return f"{first} and {len(others)} more" if others else first


def data_isaac_sim(
    pattern: Annotated[str, typer.Argument(metavar="ID", help="Id or pattern, as 'TextileBending-*'.")],
    out: Annotated[Path, typer.Option(help="Folder for the layers.")] = Path("isaac_sim"),
) -> None:
    """Write experiments as USD layers that Isaac Sim simulates.

    examples/isaac_sim/run_layer.py runs them.
    """
    from gauge_envs.experiments.patterns import matching_variants
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
            message(f"{experiment.id} is left out: {reason}")
