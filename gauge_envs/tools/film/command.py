"""`gauge video film`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from gauge_envs.cli.arguments import WithheldOption, parsed_use, split_details, whole
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.cli.results import loaded_files
from gauge_envs.errors import ParameterError

RECORDING: dict[str, Callable[[str], Any]] = {"recording": Path, "recording_start_s": float, "recording_rate_hz": float}

DETAILS: dict[str, Callable[[str], Any]] = {
    "speed": float,
    "fps": float,
    "from_s": float,
    "to_s": float,
    "hold_s": float,
    "width": whole(0),
    "height": whole(0),
    "columns": whole(0),
    "strip": whole(0),
    **RECORDING,
}


def video_film(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[DIR or FILE]... [NAME=VALUE]...",
            help="Result files, or folders of them; results/ by default. Details: speed=1, seconds of the experiment "
            "in one of the film; fps=30; from_s=0 and to_s=, times of the first and the last picture; hold_s=1 for the "
            "last frame; width=480 and height=360 of a panel in pixels; columns=, panels in a row, at most four by "
            "default; strip=COUNT, so many times in a row instead of a film; recording=FILE, a video of the real "
            "experiment as the first panel, recording_start_s=0, its time at which the experiment starts, and "
            "recording_rate_hz=, pictures that its camera took in a second, if it is in slow motion.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Film, .mp4, .webp or .gif; with strip= a picture, .png or .webp; or .rrd for the Rerun viewer, of "
            "one result. By default film.mp4 or strip.png."
        ),
    ] = None,
    only: Annotated[
        str | None, typer.Option("--only", metavar="ID", help="Experiment, if the results are of several.")
    ] = None,
    use: WithheldOption = "",
) -> bool:
    """Film results of one experiment side by side, or write one for the Rerun viewer.

    Each panel has its reference, its tracked points and its score. The episodes are run again. A result without the
    same g(t), bit for bit, has no panel. Exit code 1 when a file was skipped or a result has no panel; 2 when none is
    left.
    """
    from gauge_envs.tools.film.film import FilmOptions, results_of_one_experiment, save_film, save_strip

    files, details = split_details(sources, DETAILS)
    file = out or Path("strip.png" if "strip" in details else "film.mp4")
    keywords = parsed_use(use, "use_withheld")
    loaded, skipped = loaded_files(files, with_scene=True)
    if file.suffix == ".rrd":
        from gauge_envs.tools.film.rerun_file import write_rerun

        results = results_of_one_experiment(loaded, only)
        if details or len(results) != 1:
            raise ParameterError(f"{file}: a recording for Rerun shows one result, and has no details")
        echo(write_rerun(next(iter(results.values())), file, **keywords))
        return bool(skipped)
    strip = details.pop("strip", None)
    options = FilmOptions(recording=_recording(details), **details, **keywords)
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


def _recording(details: dict[str, Any]) -> Any:
    """Take what states the real recording out of the details, and return it; None without one."""
    from gauge_envs.tools.film.film import Recording

    given: Mapping[str, Any] = {name: details.pop(name) for name in RECORDING if name in details}
    if given and "recording" not in given:
        raise ParameterError("recording_start_s and recording_rate_hz need recording=FILE")
    names = {"recording": "file", "recording_start_s": "start_s", "recording_rate_hz": "rate_hz"}
    return Recording(**{names[name]: value for name, value in given.items()}) if given else None
