"""`gauge replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, echo, message, print_document


def replay(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG", help="Log of a robot or simulator: CSV, NPZ or Parquet."
        ),
    ],
    model: Annotated[
        Path,
        arguments.option(
            arguments.SCENE, "The robot: MJCF or URDF.", "--model", "-m", metavar="FILE"
        ),
    ],
    against: Annotated[
        Path | None,
        arguments.option(
            arguments.SCENE,
            "Second log, which is explained; the first says how well the model predicts where it should.",
            metavar="LOG",
        ),
    ] = None,
    map_: Annotated[
        Path | None,
        arguments.option(
            arguments.SCENE,
            "Names, signs, units and gains that differ (TOML).",
            "--map",
            metavar="FILE",
        ),
    ] = None,
    out: Annotated[
        list[Path] | None,
        arguments.target("The same as .md or .json; the figure as .png."),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Name the cause that makes a robot, or another simulator, move unlike your model.

    The model predicts the log from its own recorded states. Each cause of a list is fitted alone, and then in pairs;
    its share of the error counts on pieces of the log that the fit has not seen. Exit code 1 when the model does not
    predict the log within its noise.
    """
    from gauge_envs.tools.replay import ReplayVerdict, read_map, replay as run
    from gauge_envs.tools.replay.report import replay_document, replay_figure

    files = arguments.by_suffix(out, ".md", ".json", ".png")
    picture = files.pop(".png", None)
    with Progress("causes", None) as progress:
        result = run(log, model, against, read_map(map_), progress.advance)
    print_document(replay_document(result.line), form, files=files)
    if form is not Format.JSON:
        for stack, text in result.line.paste.items():
            # A terminal's width must not wrap what is to be pasted.
            echo(f"\n{stack}\n{text}")
    if picture is not None:
        from gauge_envs.pages.figures import save_png

        message(save_png(replay_figure(result), picture))
    return result.verdict is not ReplayVerdict.NOISE
