"""`gauge video film`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.cli.results import loaded_results


def _pixels(option: str, text: str) -> Any:
    return arguments.option(arguments.OUTPUT, text, option, min=1, metavar="px")


def video_film(
    sources: arguments.Sources = None,
    use: arguments.Use = None,
    only: Annotated[
        str | None,
        arguments.experiment(
            "Experiment, if the results are of several.", arguments.SELECTION
        ),
    ] = None,
    from_s: Annotated[
        float,
        arguments.measured(
            "--from", "s", "Time of the first picture.", arguments.SELECTION
        ),
    ] = 0.0,
    to_s: Annotated[
        float | None,
        arguments.measured(
            "--until",
            "s",
            "Time of the last picture.",
            arguments.SELECTION,
            show_default="the end",
        ),
    ] = None,
    speed: Annotated[
        float,
        arguments.option(
            arguments.OUTPUT, "Seconds of the experiment in one of the film."
        ),
    ] = 1.0,
    fps: Annotated[
        float,
        arguments.measured("--fps", "Hz", "Pictures in a second.", arguments.OUTPUT),
    ] = 30.0,
    width: Annotated[int, _pixels("--width", "Width of a panel.")] = 480,
    height: Annotated[int, _pixels("--height", "Height of a panel.")] = 360,
    out: Annotated[Path, arguments.target("Film, .mp4, .webp or .gif.")] = Path(
        "film.mp4"
    ),
) -> bool:
    """Film results of one experiment side by side.

    Each panel has its reference, its tracked points and its score. The episodes are run again. A result without the
    same g(t), bit for bit, has no panel. Exit code 1 when a file was skipped or a result has no panel; 2 when none is
    left.
    """
    from gauge_envs.tools.film.film import (
        FilmOptions,
        results_of_one_experiment,
        save_film,
    )

    used = arguments.parsed_use(use, "use_withheld")
    loaded, skipped = loaded_results(sources, with_scene=True)
    options = FilmOptions(
        speed=speed,
        fps=fps,
        from_s=from_s,
        to_s=to_s,
        width=width,
        height=height,
        **used,
    )
    results = results_of_one_experiment(loaded, only)
    with Progress("episodes", None) as progress:

        def show(done: int, total: int) -> None:
            progress.show("pictures", done, total)

        left_out = save_film(results, out, options, progress=show)
    for one in left_out:
        message(f"{one.file.name}: {one.reason}", "left out")
    echo(out)
    return bool(skipped or left_out)
