"""Report the plan and the outcomes of a sweep."""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from typing import Any

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table, grid
from gauge_envs.pages.text import digits_text
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.sweep.plan import SweepRun, episode_count

COUNTS = {
    "runs": "runs",
    "episodes": "episodes",
    "left": "left",
    "unsupported": "unsupported",
    "simulated_s": "simulated [s]",
}
"""Numbers of a plan and their titles."""


def plan_document(runs: Sequence[SweepRun], done: Container[str]) -> Document:
    """Return the episodes of a plan and those that are left, for each engine.

    The JSON rows have the numbers for each engine and experiment.

    Args:
        runs: The plan, grouped by engine and experiment.
        done: Names of the existing result files.
    """
    numbers = [
        Column(key, title, digits_text, is_number=True) for key, title in COUNTS.items()
    ]
    engines = list(_rows(runs, done, "backend"))
    return Document(
        parts=[Table(columns=(Column("backend", "engine"), *numbers), rows=engines)],
        rows=list(_rows(runs, done, "backend", "experiment")),
    )


def _rows(
    runs: Iterable[SweepRun], done: Container[str], *keys: str
) -> Iterator[dict[str, Any]]:
    """Yield the counts of neighbouring runs with equal attributes `keys`."""
    for _, group in groupby(runs, attrgetter(*keys)):
        members = list(group)
        first = members[0]
        left = [run for run in members for name in run.file_names if name not in done]
        yield {
            "backend": first.backend,
            "experiment": first.experiment,
            "runs": len(members),
            "episodes": episode_count(members),
            "left": len(left),
            "unsupported": episode_count(run for run in members if run.unsupported),
            "reason": first.unsupported,
            "simulated_s": sum(run.duration_s for run in left if not run.unsupported),
        }


def outcome_table(counts: Counter[tuple[str, Outcome]]) -> Table:
    """Return the number of episodes of each engine and outcome."""
    rows = [
        (backend, outcome.value, str(count))
        for (backend, outcome), count in sorted(counts.items())
    ]
    return grid(("engine", "outcome", "episodes"), rows, number_from=2)
