"""Result files that commands read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.cli.output import plain_text, stderr_console
from gauge_envs.errors import GaugeError, ResultFileError

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


def loaded_results(sources: Sequence[Path] | None, *, with_scene: bool) -> tuple[list[Result], int]:
    """Return what `loaded_files` returns, without the files."""
    results, skipped = loaded_files(sources, with_scene=with_scene)
    return list(results.values()), skipped


def loaded_files(sources: Sequence[Path] | None, *, with_scene: bool) -> tuple[dict[Path, Result], int]:
    """Return the results of files and folders by file, each file once, and the number of skipped files.

    Args:
        sources: Files and folders; None for `results/`.
        with_scene: Whether to skip also results whose scene cannot be built again.
    """
    from gauge_envs.runs.result_file import load_result, recorded_experiment

    files = dict.fromkeys(file.resolve() for source in sources or [Path("results")] for file in _result_files(source))
    results: dict[Path, Result] = {}
    for file in files:
        try:
            result = load_result(file)
            if with_scene:
                recorded_experiment(result)
            results[file] = result
        except GaugeError as error:
            place = "" if isinstance(error, ResultFileError) else f"{file}: "
            stderr_console().print(f"[yellow]skipped:[/] {plain_text(f'{place}{error}')}", soft_wrap=True)
    return results, len(files) - len(results)


def _result_files(source: Path) -> list[Path]:
    files = sorted(source.glob("*.json")) if source.is_dir() else [source]
    if not files or not files[0].exists():
        raise ResultFileError(f"{source}: holds no result files; gauge run writes them")
    return files
