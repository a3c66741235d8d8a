"""`gauge video film`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError


def _pixels(option: str, text: str) -> Any:
    return arguments.option(arguments.OUTPUT, text, option, min=1, metavar="px")


def video_film(
    sources: arguments.Sources = None,
    use: arguments.Use = None,
    recording: Annotated[
        Path | None,
        arguments.option(
            arguments.SCENE,
            "Video of the real experiment, as the first panel.",
            metavar="FILE",
        ),
    ] = None,
    recording_start_s: Annotated[
        float | None,
        arguments.measured(
            "--recording-start",
            "s",
            "Time of the recording at which the experiment starts.",
            arguments.SCENE,
            show_default="0",
        ),
    ] = None,
    recording_rate_hz: Annotated[
        float | None,
        arguments.measured(
            "--recording-rate",
            "Hz",
            "Pictures that the camera took in a second, if the recording is in slow motion.",
            arguments.SCENE,
            is_positive=True,
            show_default="that of the file",
        ),
    ] = None,
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
    hold_s: Annotated[
        float,
        arguments.measured(
            "--hold", "s", "Time that the last picture stays.", arguments.OUTPUT
        ),
    ] = 1.0,
    width: Annotated[int, _pixels("--width", "Width of a panel.")] = 480,
    height: Annotated[int, _pixels("--height", "Height of a panel.")] = 360,
    columns: Annotated[
        int | None,
        arguments.option(
            arguments.OUTPUT, "Panels in a row.", min=1, show_default="at most 4"
        ),
    ] = None,
    strip: Annotated[
        int | None,
        arguments.option(
            arguments.OUTPUT,
            "So many times in a row, in place of a film.",
            metavar="COUNT",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        arguments.target(
            "Film, .mp4, .webp or .gif; strip, .png or .webp.",
            show_default="film.mp4, or strip.png",
        ),
    ] = None,
) -> bool:
    """Film results of one experiment side by side.

    Each panel has its reference, its tracked points and its score. The episodes are run again. A result without the
    same g(t), bit for bit, has no panel. Exit code 1 when a file was skipped or a result has no panel; 2 when none is
    left.
    """
    from gauge_envs.tools.film.film import (
        FilmOptions,
        Recording,
        results_of_one_experiment,
        save_film,
        save_strip,
    )

    file = out or Path("film.mp4" if strip is None else "strip.png")
    used = arguments.parsed_use(use, "use_withheld")
    loaded, skipped = loaded_results(sources, with_scene=True)
    if recording is None and (recording_start_s, recording_rate_hz) != (None, None):
        raise ParameterError("--recording-start and --recording-rate need --recording")
    options = FilmOptions(
        speed=speed,
        fps=fps,
        from_s=from_s,
        to_s=to_s,
        hold_s=hold_s,
        width=width,
        height=height,
        columns=columns,
        recording=None
        if recording is None
        else Recording(
            file=recording, start_s=recording_start_s or 0.0, rate_hz=recording_rate_hz
        ),
        **used,
    )
    results = results_of_one_experiment(loaded, only)
    with Progress("episodes", None) as progress:

        def show(done: int, total: int) -> None:
            progress.show("pictures", done, total)

        if strip is None:
            left_out = save_film(results, file, options, progress=show)
        else:
            left_out = save_strip(results, file, options, count=strip, progress=show)
    for one in left_out:
        message(f"{one.file.name}: {one.reason}", "left out")
    echo(file)
    return bool(skipped or left_out)
