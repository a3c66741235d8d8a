"""The folder of a sweep: a file for each episode, those without a result apart.

DIR/SlopeSlider-2-wood.mujoco.e8ec72ec30333307.json     the episode ran; `diverged` counts
DIR/failed/...json                                      an error or the end of its process prevented it
DIR/declined/...json                                    the engine or the experiment cannot do it

The files alone state what is done: a sweep goes on with the episodes that have none.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path

from gauge_envs.runs.batch import check_writable
from gauge_envs.runs.pool import RequestWorker, run_tasks
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import write_result
from gauge_envs.tools.sweep.plan import SweepRun

SUBFOLDERS = {Outcome.FAILED: "failed", Outcome.DECLINED: "declined"}


def _folders(path: Path) -> list[Path]:
    return [path, *(path / name for name in SUBFOLDERS.values())]


def earlier_outcomes(path: Path, notify: Callable[[str], None]) -> dict[str, Outcome]:
    """Return the outcomes of the episodes of a folder by the names of their files.

    Args:
        path: The folder, which need not exist.
        notify: Receives a sentence for each damaged file, whose episode is left out.
    """
    outcomes = {}
    for folder in _folders(path):
        for file in folder.glob("[!.]*.json"):
            try:
                outcomes[file.name] = Outcome(json.loads(file.read_bytes())["outcome"])
            except (OSError, LookupError, TypeError, ValueError) as error:
                notify(f"{file}: not a result file: {error}; run again")
    return outcomes


def run_sweep(
    tasks: Sequence[SweepRun], workers: Sequence[RequestWorker], path: Path
) -> Generator[Result, None, None]:
    """Run tasks on workers at once, and yield each result after the results of its task are written.

    Args:
        tasks: The tasks.
        workers: The workers, which are closed at the end.
        path: Folder of the result files, created if it does not exist.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from gauge_envs.runs.pool import Limits, ProcessWorker
        >>> from gauge_envs.tools.sweep.plan import plan_sweep, remaining_tasks
        >>> from gauge_envs.tools.sweep.spec import sweep_spec
        >>> plan = plan_sweep(sweep_spec({"variants": ["SlopeSlider-2-*"], "settings": {"timestep_s": [1 / 1800]}}))
        >>> with TemporaryDirectory() as folder:
        ...     results = list(run_sweep(list(remaining_tasks(plan, ())), [ProcessWorker(Limits())], Path(folder)))
        >>> [result.outcome.value for result in results]
        ['finished', 'finished', 'finished']
    """
    for folder in _folders(path):
        check_writable(folder)

    def perform(worker: RequestWorker, task: SweepRun) -> list[Result]:
        results = worker.run(task.request)
        for result, name in zip(results, task.file_names, strict=True):
            write_result(result, path / SUBFOLDERS.get(result.outcome, "") / name)
            if result.outcome is not Outcome.FAILED:
                # An earlier attempt may have failed.
                (path / "failed" / name).unlink(missing_ok=True)
        return results

    with closing(run_tasks(tasks, workers, perform)) as finished:
        for results in finished:
            yield from results
