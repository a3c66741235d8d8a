"""`gauge data scenes`, `gauge list scenes` and `gauge data isaac-sim`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypedDict

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.names import first_names

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table


class SceneLine(TypedDict):
    """A built file of a scene, as `gauge list scenes --json` prints it.

    Attributes:
        file: Its folder and name.
        bytes: Its size.
        of: Id of the experiment, or names of the bodies, that it shows.
    """

    file: str
    bytes: int
    of: Sequence[str]


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
    from gauge_envs.tools.assets import build

    folder = out or build.assets_folder()
    with Progress("files", None) as progress:
        texts = build.asset_texts(progress.advance)
        if check:
            stale = build.stale_asset(folder, texts)
        else:
            written = build.build_assets(folder, texts)
    if not check:
        echo(f"{counted(len(written), 'file')} in {folder}")
        return False
    if stale:
        message(f"{stale}; gauge data scenes renews it", "stale")
    else:
        echo(f"{folder} is current")
    return stale is not None


def list_scenes(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the built files and what they show."""
    from gauge_envs.pages.table import Column, Table
    from gauge_envs.tools.assets.build import asset_rows, assets_folder

    columns = (
        Column("file", "file"),
        Column("bytes", "bytes", is_number=True),
        Column("of", "of", partial(first_names, max_count=1)),
    )
    table = Table(columns=columns, rows=asset_rows(assets_folder()))
    return arguments.matching([table], patterns, kind="scene")


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
    from gauge_envs.errors import ParameterError
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.experiments.variants import matching_variants
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.assets.isaac_sim import isaac_sim_stage

    unsupported = []
    variants = matching_variants(pattern)
    for variant in variants:
        path = out / f"{variant.name}.usda"
        try:
            stage = isaac_sim_stage(load_experiment(variant))
        except ParameterError as error:
            unsupported.append(error)
        else:
            echo(save_file(path, stage.GetRootLayer().ExportToString()))
    if len(unsupported) == len(variants):
        raise unsupported[0]
    for reason in unsupported:
        message(reason, "left out")
