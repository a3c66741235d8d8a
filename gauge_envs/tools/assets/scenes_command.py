"""`gauge data scenes` and `gauge list scenes`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
