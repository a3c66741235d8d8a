"""Result files that commands read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.cli.output import message
from gauge_envs.errors import GaugeError, ResultFileError

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


def loaded_results(sources: Sequence[str] | None, *, with_scene: bool = False) -> tuple[dict[Path, Result], int]:
    """Return the results of files and folders by file, each file once, and the number of skipped files.

    Args:
        sources: Files and folders; None for `results/`.
        with_scene: Whether to skip also results whose scene cannot be built again.
    """
    from gauge_envs.runs.result_file import load_result, recorded_experiment

    files = dict.fromkeys(file.resolve() for source in sources or ["results"] for file in _result_files(Path(source)))
    results: dict[Path, Result] = {}
    for file in files:
        try:
            result = load_result(file)
            if with_scene:
                recorded_experiment(result)
            results[file] = result
        except GaugeError as error:
            place = "" if isinstance(error, ResultFileError) else f"{file}: "
            message(f"{place}{error}", "skipped")
    return results, len(files) - len(results)


def _result_files(source: Path) -> list[Path]:
    files = sorted(source.glob("*.json")) if source.is_dir() else [source]
    if not files or not files[0].exists():
        raise ResultFileError(f"{source}: holds no result files; gauge run writes them")
    return files
