"""Read result files for commands, and report results of long runs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gauge_envs.cli.output import (
    EXIT_INTERRUPTED,
    LINE_INTERVAL_S,
    Format,
    Progress,
    message,
    print_json_lines,
)
from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.files import is_folder, is_regular_file
from gauge_envs.pages.text import counted, short_id

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


def loaded_results(
    sources: Sequence[str] | None,
    *,
    with_scene: bool = False,
    corrected: bool = True,
    keep: Callable[[Result], Result] = lambda result: result,
) -> tuple[dict[Path, Result], int]:
    """Return the results of files and folders by file, each file once, and the number of skipped files.

    Args:
        sources: Files and folders; None for `results/`.
        with_scene: Whether to skip also results whose scene cannot be built again.
        corrected: Whether to include results with physics that this package corrects.
        keep: Function that returns what to keep of a result in memory.
    """
    from gauge_envs.runs.configuration import RunConfiguration
    from gauge_envs.runs.result_file import load_result, recorded_experiment

    files = dict.fromkeys(
        file.resolve()
        for source in sources or ["results"]
        for file in _result_files(Path(source))
    )
    results: dict[Path, Result] = {}
    built: set[str] = set()
    skipped = corrected_count = 0
    for file in files:
        try:
            result = load_result(file)
            scene = f"{result.id} {result.revision} {result.parameters} {result.dataset} {result.asset}"
            if with_scene and scene not in built:
                recorded_experiment(result)
                built.add(scene)
        except GaugeError as error:
            skipped += 1
            message(f"{file}: {str(error).removeprefix(f'{file}: ')}", "skipped")
            continue
        if not corrected and RunConfiguration.of(result).physics == "corrected":
            corrected_count += 1
        else:
            results[file] = keep(result)
    if corrected_count:
        text = counted(corrected_count, "result")
        message(f"{text} with corrections by this package", "left out")
    return results, skipped


def _result_files(source: Path) -> list[Path]:
    files = [source]
    if is_folder(source):
        files = sorted(filter(is_regular_file, source.glob("*.json")))
    if not files or not is_regular_file(files[0]):
        raise ResultFileError(f"{source}: holds no result files; gauge run writes them")
    return files


def reported(
    results: Generator[Result, None, None],
    form: Format,
    total: int,
    *,
    done: int = 0,
    kept: str,
) -> Iterator[Result]:
    """Yield the results of a long run after reporting each as progress and as a line of JSON.

    A full disk or a closed pipe does not end the run; the first error is raised at the end.

    Args:
        results: The results; closed at the end.
        form: Format of stdout.
        total: Number of all episodes.
        done: Number of episodes completed before.
        kept: Where the results are, and how to continue after Ctrl-C or a full disk.

    Raises:
        OSError: Output was lost.
        ResultFileError: A result cannot be written.
        typer.Exit: Ctrl-C ended the run.
    """
    progress = Progress("episodes", total, done=done, line_interval_s=LINE_INTERVAL_S)
    lost: OSError | None = None
    try:
        with closing(results), progress:
            for result in results:
                try:
                    _report(result, progress, form)
                except OSError as error:
                    lost = lost or error
                yield result
    except KeyboardInterrupt:
        message(f"interrupted: finished episodes are kept in {kept}")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except ResultFileError:
        message(f"stopped: finished episodes are kept in {kept}")
        raise
    if lost is not None:
        raise lost


def _report(result: Result, progress: Progress, form: Format) -> None:
    from gauge_envs.runs.result import Outcome

    name = f"{short_id(result.id)} on {result.backend}"
    if result.outcome is Outcome.FAILED:
        message(f"{name}, seed {result.seed}: {result.error}", "failed")
    progress.advance(f"{name}: {result.outcome.value}")
    if form is Format.JSON:
        print_json_lines([result.to_dict(trajectory=False)])
