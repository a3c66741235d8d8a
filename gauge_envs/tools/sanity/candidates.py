"""Propose changes of settings that may mend flagged rows: single ones, further ones beside them, recommended ones."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from typing import Any

from gauge_envs.files import json_ready
from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.sanity.cause import (
    ADVISED_STEP_S,
    STEP,
    Alternative,
    alternatives,
)
from gauge_envs.tools.sanity.measure import Subject
from gauge_envs.tools.sanity.model import (
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.stacks.dialect import TOML, Dialect

RECOMMENDED_MUJOCO: Settings = {
    STEP: ADVISED_STEP_S,
    "integrator": "implicitfast",
    "cone": "elliptic",
    "impratio": 100.0,
    "iterations": 100,
    "ls_iterations": 50,
    "contact_solref": (0.004, 1.0),
    "contact_solimp": (0.95, 0.95, 0.001, 0.5, 2.0),
    "contact_margin_m": 0.0,
}
"""Settings that this package recommends for a model, tried as a whole where a few changes leave flags."""

RECOMMENDED_PHYSX: Settings = {
    "solver": "TGS",
    "position_iterations": 10,
    "velocity_iterations": 1,
}
"""The same for PhysX, in the dialect of a training stack."""

AT_LEAST = ("iterations", "ls_iterations", "position_iterations", "velocity_iterations")
"""Recommended settings that are kept where the target has more."""

MOST_CHANGES = 3
"""Most settings that are changed one after the other."""

MOST_COMPARED = 3
"""Most changes, of those that mend most, whose harm to other rows is measured."""

LARGEST_DEVIATION = 1000.0
"""Deviation at which errors no longer count as larger."""

MOST_CANDIDATES = 5
"""Most sets of changes that are applied to the target."""

FEW_ITERATIONS = (
    {"iterations": 4, "ls_iterations": 20},
    {"iterations": 4, "ls_iterations": 20, "cone": "elliptic"},
)
"""Least iterations with which bodies slide as they should on engines for GPUs (studies/README.md, few_iterations)."""


def candidates_of(
    configuration: TrainingConfiguration,
    subjects: Sequence[Subject],
    dialect: Dialect,
    rows: Sequence[PhenomenonResult],
) -> list[dict[str, Any]]:
    """Return sets of changes that may mend flagged rows: single ones, further ones beside them, recommended settings.

    Args:
        configuration: The checked configuration.
        subjects: Subjects of the simulated rows.
        dialect: Dialect of the target.
        rows: All rows. Of changes that mend as much, those of settings that they name come first.
    """
    flags = {row.phenomenon for row in rows if row.is_flag}
    causes = {row.phenomenon: row.cause for row in rows if row.cause is not None}
    # Where an engine died, there is no cause, and changes would let it die again.
    flagged = [one for one in subjects if one.phenomenon.id in flags & set(causes)]
    if not flagged:
        return []
    others = [
        one
        for one in subjects
        if one.sets and one.phenomenon.id not in flags and not one.advisory
    ]
    named = {name for cause in causes.values() for name in cause.settings}
    found: list[dict[str, Any]] = []
    least: dict[str, Any] = {}
    iterations = configuration.settings.get("iterations", math.inf)
    if iterations < FEW_ITERATIONS[0]["iterations"]:
        # Other changes let a body slide that starts to move, and not one that has rested.
        found += [
            {k: v for k, v in few.items() if configuration.settings.get(k) != v}
            for few in FEW_ITERATIONS
        ]
        least = found[0]
    # What a change does to a scene of many bodies is measured once it is chosen.
    few = [one for one in flagged if not one.phenomenon.has_many_bodies]
    if few:
        flagged = few
        others = [one for one in others if not one.phenomenon.has_many_bodies]
    mending = list(_greedy(flagged, (), dialect, named))
    if mending and any(one.is_off(mending[-1]) for one in others):
        mending = list(_greedy(flagged, others, dialect, named))
    found += [{**least, **one} for one in mending]
    if recommended := _recommended(configuration):
        # Of many, the last one is tried too.
        found = [*found[: MOST_CANDIDATES - 1], recommended]
    of_causes = ({**least, **one} for one in _of_causes(rows, dialect))
    return [*found[:MOST_CANDIDATES], *of_causes]


def key_of(changes: Any) -> str:
    """Return a text that equal changes share."""
    return json.dumps(json_ready(changes), sort_keys=True)


def _of_causes(
    rows: Sequence[PhenomenonResult], dialect: Dialect
) -> Iterator[dict[str, Any]]:
    """Yield changes that mended a row while its cause was sought, and that the target can state."""
    for row in rows:
        if not row.is_flag or row.cause is None:
            continue
        for trial in row.cause.tried:
            is_named = set(trial.changes) == set(row.cause.settings)
            if trial.on_default or not is_named or trial.value is None:
                continue
            is_inside = abs(trial.value - row.reality.value) <= row.reality.tolerance
            if is_inside and all(map(dialect.writes, trial.changes)):
                yield dict(trial.changes)


def _greedy(
    flagged: Sequence[Subject],
    others: Sequence[Subject],
    dialect: Dialect,
    named: Collection[str],
) -> Iterator[dict[str, Any]]:
    """Yield the single change that mends most, then it with further ones; each must mend a further flag.

    Of the changes that mend most, the one with the fewest new flags is taken.
    """
    candidates = _alternatives(flagged, dialect)
    changes: dict[str, Any] = {}
    left = list(flagged)
    while left and candidates and len(changes) < MOST_CHANGES:
        scored: list[tuple[tuple[int, bool, bool, float], Alternative]] = []
        # A step is changed only where no other change mends as much, since shorter ones cost time in proportion.
        for one in sorted(candidates, key=lambda one: one.name == STEP):
            least = 1
            if one.name == STEP:
                least += max((rank[0] for rank, _ in scored), default=0)
            score = _score(left, {**changes, one.name: one.value}, least)
            if score is None:
                continue
            mended, closeness = score
            # No shorter step if others mend as much, then one that is named for a row.
            rank = (mended, one.name != STEP, one.name in named, closeness)
            scored.append((rank, one))
        if not scored:
            return
        scored.sort(key=lambda pair: pair[0], reverse=True)
        best, largest_net = scored[0][1], -math.inf
        for one_rank, one in scored[:MOST_COMPARED]:
            if one_rank[0] <= largest_net:
                # It mends no more than what is left of the best one after its harm.
                break
            after = {**changes, one.name: one.value}
            net = _net(one_rank[0], others, after, largest_net)
            if net > largest_net:
                best, largest_net = one, net
        changes[best.name] = best.value
        yield dict(changes)
        left = [one for one in left if one.worst(changes).verdict is not Verdict.INSIDE]
        candidates = [one for one in candidates if one.name not in changes]


def _net(
    mended: int, others: Sequence[Subject], changes: Settings, least: float
) -> int:
    """Return the rows that changes mend minus those that they flag; at most `least` when it is no more."""
    for other in others:
        mended -= other.is_off(changes)
        if mended <= least:
            break
    return mended


def _alternatives(flagged: Sequence[Subject], dialect: Dialect) -> list[Alternative]:
    """Return the other values of all settings of flagged subjects that the target can state."""
    found: dict[str, Alternative] = {}
    for subject in flagged:
        for settings in subject.sets.values():
            with suppress(DeclinedError):
                several = alternatives(
                    subject.measurements, subject.phenomenon.scenario, settings
                )
                for one in chain.from_iterable(several.values()):
                    found.setdefault(key_of([one.name, one.value]), one)
    return [one for one in found.values() if dialect.writes(one.name)]


def _score(
    subjects: Sequence[Subject], changes: Settings, least: int
) -> tuple[int, float] | None:
    """Return how many subjects are inside with changes, and minus the sum of all deviations.

    None once fewer than `least` can be inside, without a measurement of the others.
    """
    inside_count, total = 0, 0.0
    possible_count = len(subjects)
    for subject in subjects:
        if possible_count < least:
            return None
        outcome = subject.worst(changes)
        is_inside = outcome.verdict is Verdict.INSIDE
        inside_count += is_inside
        possible_count -= not is_inside
        total += min(outcome.deviation, LARGEST_DEVIATION)
    return None if inside_count < least else (inside_count, -total)


def _recommended(configuration: TrainingConfiguration) -> dict[str, Any]:
    """Return the recommended settings that differ from the target's; a shorter step and more iterations are kept.

    A settings file has none, since its backend's preset is what it differs from.
    """
    recommended: Settings = {}
    if configuration.is_model:
        recommended = RECOMMENDED_MUJOCO
    elif configuration.backend == "physx" and configuration.language != TOML.name:
        recommended = RECOMMENDED_PHYSX
    changes = {}
    for name, value in recommended.items():
        was = configuration.settings.get(
            name, 0.0 if name == "contact_margin_m" else None
        )
        if name == STEP and was is not None and was <= value:
            continue
        if name in AT_LEAST and was is not None and was >= value:
            continue
        if (tuple(was) if isinstance(was, list) else was) != value:
            changes[name] = value
    return changes
