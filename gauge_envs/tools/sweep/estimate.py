"""The cost of a sweep, estimated from earlier results of the same engine and experiment."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from statistics import median

import numpy as np

from gauge_envs.errors import ResultFileError
from gauge_envs.tools.sweep.plan import SweepTask
from gauge_envs.tools.sweep.store import SweepFolder, read_only


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
    """Costs of the results in the store of a folder.

    The cost of an episode is the median time of earlier episodes of the same engine and experiment with as many time
    steps. Between two numbers of steps it is interpolated, and beyond the largest it grows in proportion. Other
    settings, as iterations, are not considered.

    Args:
        folder: The folder; without a store nothing is known.
    """

    def __init__(self, folder: SweepFolder) -> None:
        times_s: dict[tuple[str, str], dict[float, list[float]]] = {}
        for experiment, backend, wall_s, steps in _measured(folder):
            times_s.setdefault((backend, experiment), {}).setdefault(round(steps), []).append(wall_s)
        self._medians = {
            group: {steps: median(values) for steps, values in sorted(by_steps.items())}
            for group, by_steps in times_s.items()
        }

    def of(self, tasks: Iterable[SweepTask]) -> Cost:
        """Return the estimated cost of tasks."""
        engine_s, known, unknown = 0.0, 0, 0
        for task in tasks:
            medians = self._medians.get(task.run.group)
            if medians is None or task.run.steps is None:
                unknown += len(task.seeds)
            else:
                known += len(task.seeds)
                engine_s += len(task.seeds) * _interpolated(medians, task.run.steps)
        return Cost(engine_s, known, unknown)


def _interpolated(medians: Mapping[float, float], steps: float) -> float:
    """Return the time for a number of steps [s], from times by numbers of steps in ascending order."""
    most = max(medians)
    if steps > most:
        return medians[most] * steps / most
    return float(np.interp(steps, list(medians), list(medians.values())))


def _measured(folder: SweepFolder) -> list[tuple[str, str, float, float]]:
    """Return experiment, engine, wall time [s] and number of steps of earlier results."""
    if not folder.store_path.exists():
        return []
    try:
        with closing(read_only(folder.store_path)) as connection:
            return connection.execute(
                "SELECT replace(id, 'GAUGE/', ''), backend, wall_s, sim_s / timestep_s AS steps FROM results "
                "WHERE outcome = 'finished' AND wall_s > 0 AND steps BETWEEN 1 AND 1e15 "
                "AND typeof(wall_s) = 'real' AND typeof(steps) = 'real'"
            ).fetchall()
    except (sqlite3.DatabaseError, ResultFileError):
        # A damaged store is made again when the sweep runs.
        return []
