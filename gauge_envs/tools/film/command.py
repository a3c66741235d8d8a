"""`gauge video film`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError

RECORDING = {"recording": Path, "recording_start_s": float, "recording_rate_hz": float}
"""Details of the real recording beside a film."""

TIMES = dict.fromkeys(("speed", "fps", "from_s", "to_s", "hold_s"), float)

COUNTS = dict.fromkeys(("width", "height", "columns", "strip"), int)


def video_film(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[DIR or FILE]... [NAME=VALUE]...",
            help="Results; results/ by default.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Film, .mp4, .webp or .gif; strip, .png or .webp; or .rrd for the Rerun viewer, of one result."
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Experiment, if the results are of several."),
    ] = None,
    use: arguments.Use = "",
) -> bool:
    """Film results of one experiment side by side, or write one for the Rerun viewer.

    Details: speed=1, seconds of the experiment in one of the film; fps=30; from_s=0 and to_s=, times of the first and
    the last picture; hold_s=1 for the last frame; width=480 and height=360 of a panel in pixels; columns=, panels in a
    row, at most four by default; strip=COUNT, so many times in a row instead of a film; recording=FILE, a video of the
    real experiment as the first panel; recording_start_s=0, its time at which the experiment starts; and
    recording_rate_hz=, pictures that its camera took in a second, if it is in slow motion.

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
    from gauge_envs.tools.film.rerun_file import write_rerun

    files, details = arguments.split_details(sources, **TIMES, **COUNTS, **RECORDING)
    file = out or Path("strip.png" if "strip" in details else "film.mp4")
    used = arguments.parsed_use(use, "use_withheld")
    loaded, skipped = loaded_results(files, with_scene=True)
    if file.suffix == ".rrd":
        results = results_of_one_experiment(loaded, only)
        if details or len(results) != 1:
            raise ParameterError(
                f"{file}: a recording for Rerun shows one result, and has no details"
            )
        echo(write_rerun(next(iter(results.values())), file, **used))
        return bool(skipped)
    strip = details.pop("strip", None)
    real = {name: details.pop(name) for name in RECORDING if name in details}
    if real and "recording" not in real:
        raise ParameterError(
            "recording_start_s and recording_rate_hz need recording=FILE"
        )
    if real:
        start_s, rate_hz = (
            real.get("recording_start_s", 0.0),
            real.get("recording_rate_hz"),
        )
        details["recording"] = Recording(
            file=real["recording"], start_s=start_s, rate_hz=rate_hz
        )
    options = FilmOptions(**details, **used)
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
