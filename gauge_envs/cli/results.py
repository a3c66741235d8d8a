"""Result files that commands read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.cli.output import message
from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.pages.text import counted

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


def loaded_results(
    sources: Sequence[str] | None, *, with_scene: bool = False, corrected: bool = True
) -> tuple[dict[Path, Result], int]:
    """Return the results of files and folders by file, each file once, and the number of skipped files.

    Args:
        sources: Files and folders; None for `results/`.
        with_scene: Whether to skip also results whose scene cannot be built again.
        corrected: Whether results count whose physics this package corrects.
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
    for file in files:
        try:
            result = load_result(file)
            scene = f"{result.id} {result.revision} {result.parameters} {result.dataset} {result.asset}"
            if with_scene and scene not in built:
                recorded_experiment(result)
                built.add(scene)
            results[file] = result
        except GaugeError as error:
            message(f"{file}: {str(error).removeprefix(f'{file}: ')}", "skipped")
    skipped = len(files) - len(results)
    kept = {
        file: one
        for file, one in results.items()
        if corrected or RunConfiguration.of(one).physics != "corrected"
    }
    if len(kept) < len(results):
        message(
            f"{counted(len(results) - len(kept), 'result')} with corrections by this package",
            "left out",
        )
    return kept, skipped


def _result_files(source: Path) -> list[Path]:
    files = sorted(source.glob("*.json")) if source.is_dir() else [source]
    if not files or not files[0].exists():
        raise ResultFileError(f"{source}: holds no result files; gauge run writes them")
    return files
