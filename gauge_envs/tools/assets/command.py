"""`gauge data scenes` and `gauge data isaac-sim`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import echo, message
from gauge_envs.errors import first_names

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table


def data_scenes(
    out: Annotated[
        Path | None,
        arguments.folder("Folder.", show_default="the checked-in assets"),
    ] = None,
    check: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT,
            "Write nothing; exit code 1 if a file is stale.",
            "--check",
        ),
    ] = False,
) -> bool:
    """Write every scene as USD and MJCF, and every solid as OBJ."""
    from gauge_envs.pages.text import counted
    from gauge_envs.tools.assets.build import assets_folder, build_assets, stale_asset

    folder = out or assets_folder()
    stale = stale_asset(folder) if check else None
    if stale:
        message(f"{stale}; gauge data scenes renews it", "stale")
    else:
        echo(
            f"{folder} is current"
            if check
            else f"{counted(len(build_assets(folder)), 'file')} in {folder}"
        )
    return stale is not None


def list_scenes(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the built files and the experiments that they show."""
    from gauge_envs.pages.table import Column, Table
    from gauge_envs.tools.assets.build import asset_rows, assets_folder

    def owners(names: str) -> str:
        return first_names(names.split(", "), 1)

    size = Column("bytes", "KiB", lambda size: f"{size / 1024:.1f}", is_number=True)
    columns = (Column("file", "file"), size, Column("of", "of", owners))
    return arguments.matching(
        [Table(columns=columns, rows=asset_rows(assets_folder()))],
        patterns,
        kind="scene",
    )


def data_isaac_sim(
    pattern: Annotated[
        str, typer.Argument(metavar="ID", help="Id or pattern, as 'TextileBending-*'.")
    ],
    out: Annotated[Path, arguments.folder("Folder for the layers.")] = Path(
        "isaac_sim"
    ),
) -> None:
    """Write experiments as USD layers that Isaac Sim simulates.

    examples/isaac_sim/run_layer.py runs them.
    """
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.experiments.variants import matching_variants
    from gauge_envs.tools.assets.isaac_sim import (
        unsupported_reason,
        write_isaac_sim_layer,
    )

    experiments = [load_experiment(variant) for variant in matching_variants(pattern)]
    reasons = {
        experiment.id: unsupported_reason(experiment.scene)
        for experiment in experiments
    }
    # If all are unsupported, the first one raises its reason.
    for experiment in [
        one for one in experiments if reasons[one.id] is None
    ] or experiments[:1]:
        path = out / f"{experiment.name}.usda"
        write_isaac_sim_layer(experiment, path)
        echo(path)
    for name, reason in reasons.items():
        if reason is not None:
            message(f"{name} is left out: {reason}")
