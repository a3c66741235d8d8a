"""The command that films results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.arguments import WithheldOption
from gauge_envs.cli.output import EXIT_FAILED, echo, plain_text, progress_bar, stderr_console
from gauge_envs.cli.results import loaded_files
from gauge_envs.errors import ParameterError


def film(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Film, MP4, WebP or GIF; with --strip a picture, PNG or WebP. By default film.mp4 or strip.png."
        ),
    ] = None,
    name: Annotated[str | None, typer.Option("--id", help="Experiment, if the results are of several.")] = None,
    strip: Annotated[
        int | None, typer.Option(metavar="COUNT", help="Draw this number of times in a row instead of a film.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Seconds of the experiment in a second of the film.")] = 1.0,
    fps: Annotated[float, typer.Option(help="Frames per second of the film.")] = 30.0,
    from_s: Annotated[float, typer.Option(help="Time of the first picture in seconds.")] = 0.0,
    to_s: Annotated[float | None, typer.Option(help="Time of the last picture in seconds; the end by default.")] = None,
    hold_s: Annotated[float, typer.Option(help="Time for which the last frame stays in seconds.")] = 1.0,
    width: Annotated[int, typer.Option(help="Width of a panel in pixels.")] = 480,
    height: Annotated[int, typer.Option(help="Height of a panel in pixels.")] = 360,
    columns: Annotated[int | None, typer.Option(help="Panels in a row of the film; at most four by default.")] = None,
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Video of the real experiment, as the first panel.")
    ] = None,
    recording_start_s: Annotated[
        float, typer.Option(help="Time in that video at which the experiment starts in seconds.")
    ] = 0.0,
    recording_rate_hz: Annotated[
        float | None,
        typer.Option(help="Pictures that its camera took in a second, if the video is in slow motion."),
    ] = None,
    use_withheld: WithheldOption = False,
) -> None:
    """Film results of one experiment side by side, each with its reference, its tracked points and its score.

    The episodes are run again. A result without the same g(t), bit for bit, has no panel. Exit code 1 when a file was
    skipped or a result has no panel; 2 when none is left.
    """
    from gauge_envs.tools.film.film import FilmOptions, Recording, results_of_one_experiment, save_film, save_strip

    if recording is None and (recording_start_s or recording_rate_hz is not None):
        raise ParameterError("--recording-start-s and --recording-rate-hz need --recording")
    options = FilmOptions(
        width=width,
        height=height,
        columns=columns,
        from_s=from_s,
        to_s=to_s,
        fps=fps,
        speed=speed,
        hold_s=hold_s,
        use_withheld=use_withheld,
        recording=None
        if recording is None
        else Recording(file=recording, start_s=recording_start_s, rate_hz=recording_rate_hz),
    )
    file = out or Path("film.mp4" if strip is None else "strip.png")
    loaded, skipped = loaded_files(sources, with_scene=True)
    results = results_of_one_experiment(loaded, name)
    stderr = stderr_console()
    with progress_bar(stderr) as bar:
        task = bar.add_task("episodes", total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, description="pictures")

        if strip is None:
            left_out = save_film(results, file, options, progress=show)
        else:
            left_out = save_strip(results, file, options, count=strip, progress=show)
    for one in left_out:
        stderr.print(f"[yellow]left out:[/] {plain_text(f'{one.file.name}: {one.reason}')}", soft_wrap=True)
    echo(file)
    if skipped or left_out:
        raise typer.Exit(EXIT_FAILED)
