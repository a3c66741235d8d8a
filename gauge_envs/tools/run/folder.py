"""Run a sweep in a folder, with a file for each episode.

DIR/SlopeSlider-2-wood.mujoco.e8ec72ec30333307.json     the episode finished or diverged
DIR/failed/...json                                      an error occurred or the process ended
DIR/unsupported/...json                                    the engine or the experiment does not support it

A sweep continues with the episodes that have no file.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from pathlib import Path

from gauge_envs.errors import ResultFileError
from gauge_envs.reading import reading
from gauge_envs.runs.batch import check_writable
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import write_result
from gauge_envs.runs.workers import RequestWorker, run_tasks
from gauge_envs.text import json_document
from gauge_envs.tools.run.plan import PlannedRun

SUBFOLDERS = {Outcome.FAILED: "failed", Outcome.UNSUPPORTED: "unsupported"}


def _folders(path: Path) -> list[Path]:
    return [path, *(path / name for name in SUBFOLDERS.values())]


def earlier_outcomes(
    path: Path, notify: Callable[[str], None], *, without_failed: bool = False
) -> dict[str, Outcome]:
    """Return the outcomes of the episodes in a folder, by file name.

    Args:
        path: The folder; it may be missing.
        notify: Receives a sentence for each damaged file, which is left out.
        without_failed: Whether to leave out failed episodes, so that they run again.
    """
    outcomes = {}
    for folder in _folders(path):
        for file in folder.glob("[!.]*.json"):
            try:
                hint = "the episode runs again"
                with reading(file, ResultFileError, "a result file", hint) as content:
                    outcome = Outcome(json_document(content)["outcome"])
            except ResultFileError as error:
                notify(str(error))
                continue
            if not (without_failed and outcome is Outcome.FAILED):
                outcomes[file.name] = outcome
    return outcomes


def run_sweep(
    tasks: Sequence[PlannedRun], workers: Sequence[RequestWorker], path: Path
) -> Generator[Result, None, None]:
    """Run tasks on workers in parallel, and yield the results of a task after writing them.

    Args:
        tasks: The tasks.
        workers: The workers; they are closed at the end.
        path: Folder of the result files, created if it does not exist.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from gauge_envs.runs.workers import Limits, ProcessWorker
        >>> from gauge_envs.tools.run.plan import plan_runs, remaining_tasks
        >>> from gauge_envs.tools.run.spec import run_spec
        >>> plan = plan_runs(run_spec({"variants": ["SlopeSlider-2-*"], "settings": {"timestep_s": [1 / 1800]}}))
        >>> with TemporaryDirectory() as folder:
        ...     results = list(run_sweep(list(remaining_tasks(plan, ())), [ProcessWorker(Limits())], Path(folder)))
        >>> [result.outcome.value for result in results]
        ['finished', 'finished', 'finished']
    """
    for folder in _folders(path):
        check_writable(folder)

    def perform(worker: RequestWorker, task: PlannedRun) -> list[Result]:
        results = worker.run(task.request)
        for result, name in zip(results, task.file_names, strict=True):
            write_result(result, path / SUBFOLDERS.get(result.outcome, "") / name)
            if result.outcome is not Outcome.FAILED:
                # Remove the result of an earlier failed attempt.
                (path / "failed" / name).unlink(missing_ok=True)
        return results

    return run_tasks(tasks, workers, perform)
