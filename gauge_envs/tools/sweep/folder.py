"""The folder of a sweep: a file for each episode, those without a result apart.

DIR/SlopeSlider-2-wood.mujoco.e8ec72ec30333307.json     the episode ran; `diverged` counts
DIR/failed/...json                                      an error or the end of its process prevented it
DIR/declined/...json                                    the engine or the experiment cannot do it

The files alone state what is done: a sweep goes on with the episodes that have none.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from gauge_envs.pages.text import short_id
from gauge_envs.runs.batch import check_writable
from gauge_envs.runs.pool import RequestWorker, run_tasks
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import write_result
from gauge_envs.tools.sweep.plan import SweepTask

SUBFOLDERS = {Outcome.FAILED: "failed", Outcome.DECLINED: "declined"}


def _folders(path: Path) -> list[Path]:
    return [path, *(path / name for name in SUBFOLDERS.values())]


def result_files(path: Path) -> Iterator[Path]:
    """Yield the result files of a sweep."""
    for folder in _folders(path):
        yield from folder.glob("[!.]*.json")


def write_episode(path: Path, result: Result, name: str) -> None:
    """Write a result file; the file of an earlier failure of the episode is removed."""
    file = path / SUBFOLDERS.get(result.outcome, "") / name
    write_result(result, file)
    for folder in _folders(path)[1:]:
        if folder != file.parent:
            (folder / name).unlink(missing_ok=True)


def run_sweep(
    tasks: Sequence[SweepTask], workers: Sequence[RequestWorker], path: Path
) -> Generator[list[Result], None, None]:
    """Run tasks on workers at once, and yield the results of each in their order, after they are written.

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
        ...     done = list(run_sweep(list(remaining_tasks(plan, ())), [ProcessWorker(Limits())], Path(folder)))
        >>> [result.outcome.value for results in done for result in results]
        ['finished', 'finished', 'finished']
    """
    for folder in _folders(path):
        check_writable(folder)

    def perform(worker: RequestWorker, task: SweepTask) -> list[Result]:
        results = [_checked(task, result) for result in worker.run(task.request)]
        for result, name in zip(results, task.file_names, strict=True):
            write_episode(path, result, name)
        return results

    return run_tasks(tasks, workers, perform)


def _checked(task: SweepTask, result: Result) -> Result:
    """Return a result, or a failure if other versions made it than the plan states, as on another machine."""
    difference = result.made_with_other_than(task.run.versions)
    if result.trajectory is None or not difference:
        return result
    reason = f"{difference}: install the same versions on every machine"
    return replace(result, outcome=Outcome.FAILED, error=reason, trajectory=None)


# --- earlier episodes ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class EarlierEpisode:
    """An episode whose result file exists.

    Attributes:
        outcome: How it ended.
        group: Engine and experiment.
        step_s: Wall time of a time step [s]; None if the episode did not finish, or the engine does not tell its steps.
    """

    outcome: Outcome
    group: tuple[str, str]
    step_s: float | None


def earlier_episodes(
    path: Path, notify: Callable[[str], None] = lambda _: None
) -> dict[str, EarlierEpisode]:
    """Return the episodes of a folder by the names of their files.

    Args:
        path: The folder; without one there are none.
        notify: Receives a sentence for each damaged file, whose episode is left out.
    """
    episodes = {}
    for file in result_files(path):
        try:
            values = json.loads(file.read_bytes())
            outcome = Outcome(values["outcome"])
            timestep_s = values["settings"].get("timestep_s")
            step_s = None
            if outcome is Outcome.FINISHED and timestep_s:
                step_s = values["wall_s"] * timestep_s / values["sim_s"]
            group = values["backend"], short_id(values["id"])
            episodes[file.name] = EarlierEpisode(outcome, group, step_s)
        except OSError:
            # A folder or a link to nothing is no result.
            continue
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            TypeError,
            ValueError,
        ) as error:
            notify(f"{file}: not a result file: {error}; run again")
    return episodes


@dataclass(frozen=True)
class Cost:
    """Estimated cost of episodes.

    Attributes:
        engine_s: Time in the engines of the episodes whose cost is known [s], without their start and building.
        known: Episodes with an estimate.
        unknown: Episodes without one: no earlier result of that engine and experiment exists.
    """

    engine_s: float = 0.0
    known: int = 0
    unknown: int = 0


class StepTimes:
    """Wall time of a time step: the median of earlier episodes of the same engine and experiment.

    Other settings, as iterations, are not considered.

    Args:
        episodes: The earlier episodes.
    """

    def __init__(self, episodes: Iterable[EarlierEpisode]) -> None:
        steps_s: dict[tuple[str, str], list[float]] = {}
        for one in episodes:
            if one.step_s is not None:
                steps_s.setdefault(one.group, []).append(one.step_s)
        self._medians_s = {group: median(values) for group, values in steps_s.items()}

    def cost_of(self, tasks: Iterable[SweepTask]) -> Cost:
        """Return the estimated cost of those tasks that are not declined."""
        engine_s, known, unknown = 0.0, 0, 0
        for task in tasks:
            step_s, steps = self._medians_s.get(task.run.group), task.run.steps
            count = 0 if task.run.declined else len(task.seeds)
            if step_s is None or steps is None:
                unknown += count
            else:
                known += count
                engine_s += count * step_s * steps
        return Cost(engine_s, known, unknown)
