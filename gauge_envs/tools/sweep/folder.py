"""The folder of a sweep: a file for each episode, those without a result apart.

DIR/SlopeSlider-2-wood.mujoco.e8ec72ec30333307.json     the episode ran; `diverged` counts
DIR/failed/...json                                      an error or the end of its process prevented it
DIR/declined/...json                                    the engine or the experiment cannot do it

The files alone state what is done: a sweep goes on with the episodes that have none.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from gauge_envs.pages.text import short_id
from gauge_envs.runs.batch import check_writable
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import write_result
from gauge_envs.tools.sweep.plan import SweepTask

SUBFOLDERS = {Outcome.FAILED: "failed", Outcome.DECLINED: "declined"}


@dataclass(frozen=True)
class EarlierEpisode:
    """An episode whose result file exists.

    Attributes:
        outcome: How it ended.
        group: Engine and experiment.
        wall_s: Wall time in the engine [s]; None if it did not run.
        steps: Number of its time steps; None where the engine does not tell.
    """

    outcome: Outcome
    group: tuple[str, str]
    wall_s: float | None
    steps: float | None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> EarlierEpisode:
        """Return the episode of a result in JSON."""
        timestep_s = values["settings"].get("timestep_s")
        return cls(
            outcome=Outcome(values["outcome"]),
            group=(values["backend"], short_id(values["id"])),
            wall_s=values["wall_s"],
            steps=values["sim_s"] / timestep_s if timestep_s else None,
        )


def create_folder(path: Path) -> None:
    """Create the folder of a sweep if it does not exist."""
    for name in ("", *SUBFOLDERS.values()):
        check_writable(path / name)


def result_files(path: Path) -> Iterator[Path]:
    """Yield the result files of a sweep."""
    for name in ("", *SUBFOLDERS.values()):
        yield from (path / name).glob("[!.]*.json")


def write_episode(path: Path, result: Result, name: str) -> None:
    """Write a result file; that of an earlier failure of the episode is removed."""
    file = path / SUBFOLDERS.get(result.outcome, "") / name
    write_result(result, file)
    for folder in SUBFOLDERS.values():
        earlier = path / folder / name
        if earlier != file:
            earlier.unlink(missing_ok=True)


def earlier_episodes(
    path: Path, notify: Callable[[str], None] = lambda _: None
) -> dict[str, EarlierEpisode]:
    """Return the episodes of a folder by the names of their files.

    Args:
        path: The folder; without one there are none.
        notify: Receives a sentence for each damaged file, whose episode is left out.
    """
    found = {}
    for file in result_files(path):
        try:
            found[file.name] = EarlierEpisode.of(json.loads(file.read_bytes()))
        except OSError:
            # A folder or a link to nothing is no result.
            continue
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            notify(f"{file}: not a result file: {error}; run again")
    return found


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


class EarlierCosts:
    """Costs of earlier episodes.

    The cost of an episode is the median time of earlier episodes of the same engine and experiment with as many time
    steps. Between two numbers of steps it is interpolated, and beyond the largest it grows in proportion. Other
    settings, as iterations, are not considered.

    Args:
        episodes: The earlier episodes.
    """

    def __init__(self, episodes: Iterable[EarlierEpisode]) -> None:
        times_s: dict[tuple[str, str], dict[int, list[float]]] = {}
        for one in episodes:
            if one.outcome is Outcome.FINISHED and one.wall_s and one.steps:
                of_group = times_s.setdefault(one.group, {})
                of_group.setdefault(round(one.steps), []).append(one.wall_s)
        self._medians = {
            group: {steps: median(values) for steps, values in sorted(by_steps.items())}
            for group, by_steps in times_s.items()
        }

    def of(self, tasks: Iterable[SweepTask]) -> Cost:
        """Return the estimated cost of tasks."""
        engine_s = 0.0
        known = 0
        unknown = 0
        for task in tasks:
            medians = self._medians.get(task.run.group)
            if medians is None or task.run.steps is None:
                unknown += len(task.seeds)
            else:
                known += len(task.seeds)
                engine_s += len(task.seeds) * _interpolated_s(medians, task.run.steps)
        return Cost(engine_s, known, unknown)


def _interpolated_s(medians: Mapping[int, float], steps: float) -> float:
    """Return the time for a number of steps [s], from times by numbers of steps in ascending order."""
    largest = max(medians)
    if steps > largest:
        return medians[largest] * steps / largest
    return float(np.interp(steps, list(medians), list(medians.values())))
