"""The run of what is left of a sweep, on workers."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

from gauge_envs.runs.pool import RequestWorker, run_tasks
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.sweep.folder import create_folder, write_episode
from gauge_envs.tools.sweep.plan import SweepTask


def run_sweep(
    tasks: Sequence[SweepTask], workers: Sequence[RequestWorker], folder: Path
) -> Generator[list[Result], None, None]:
    """Run tasks on workers at once, and yield the results of each in their order, after they are written.

    Args:
        tasks: The tasks.
        workers: The workers, which are closed at the end.
        folder: Folder of the result files, created if it does not exist.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from gauge_envs.runs.pool import Limits, ProcessWorker
        >>> from gauge_envs.tools.sweep.plan import plan_sweep, remaining_tasks
        >>> from gauge_envs.tools.sweep.spec import sweep_spec
        >>> plan = plan_sweep(sweep_spec({"variants": ["SlopeSlider-2-*"], "settings": {"timestep_s": [1 / 1800]}}))
        >>> with TemporaryDirectory() as folder:
        ...     done = list(run_sweep(list(remaining_tasks(plan, ())), [ProcessWorker(Limits())], Path(folder)))
        >>> [result.outcome.value for results in done for result in results]
        ['finished', 'finished', 'finished']
    """
    create_folder(folder)

    def done(worker: RequestWorker, task: SweepTask) -> list[Result]:
        results = [_verified(task, result) for result in worker.run(task.request)]
        for result, name in zip(results, task.file_names, strict=True):
            write_episode(folder, result, name)
        return results

    return run_tasks(tasks, workers, done)


def _verified(task: SweepTask, result: Result) -> Result:
    """Return a result, or a failure if other versions made it than the plan states, as on another machine."""
    difference = result.made_with_other_than(task.run.versions)
    if result.trajectory is None or not difference:
        return result
    reason = f"{difference}: install the same versions on every machine"
    return replace(result, outcome=Outcome.FAILED, error=reason, trajectory=None)
