"""Find the change of a few settings that mends most flags, and measure what it does before it is reported."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.sanity.alternatives import Alternative, alternatives
from gauge_envs.tools.sanity.model import Cure, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.stacks.dialect import TOML, Dialect
from gauge_envs.tools.sanity.subject import Subject

RECOMMENDED_MUJOCO: Mapping[str, Any] = {
    "timestep_s": 0.002,
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

RECOMMENDED_PHYSX: Mapping[str, Any] = {"solver": "TGS", "position_iterations": 10, "velocity_iterations": 1}
"""The same for PhysX, in the dialect of a training stack."""

AT_LEAST = ("iterations", "ls_iterations", "position_iterations", "velocity_iterations")
"""Recommended settings that are kept where the target has more."""

STEP = "timestep_s"
"""Setting that is changed only where no other change mends as much, since shorter steps cost time in proportion."""

MOST_CHANGES = 3
"""Most settings that are changed one after the other."""

MOST_COMPARED = 3
"""Most changes, of those that mend most, whose harm to other rows is measured."""

LARGEST_DEVIATION = 1000.0
"""Deviation at which errors no longer count as larger."""


@dataclass(frozen=True, kw_only=True)
class _Step:
    """Changes added at once, and the number of flags that are mended with all changes so far."""

    changes: Mapping[str, Any]
    mended: int
    source: str


def find_cure(
    configuration: TrainingConfiguration,
    flagged: Sequence[Subject],
    others: Sequence[Subject],
    dialect: Dialect,
    named: Collection[str] = (),
) -> Cure | None:
    """Return the change that mends most flagged rows; None when no change mends one.

    Single changes are tried first, then further ones beside the best. If flags are left, or come instead, the settings
    that this package recommends for the target are tried as a whole. Rows that were inside are measured again.

    Args:
        configuration: The checked configuration.
        flagged: Subjects that are visible or wrong, and count.
        others: Other subjects that count.
        dialect: Dialect of the target.
        named: Settings that are responsible for rows; of changes that mend as much, theirs come first.
    """
    if not flagged:
        return None
    steps = list(_greedy(flagged, others, dialect, named))
    changes = {name: value for step in steps for name, value in step.changes.items()}
    mended = steps[-1].mended if steps else 0
    new = _new_flags(others, changes) if mended else ()
    recommended = _recommended(configuration)
    if recommended and (mended < len(flagged) or len(new) >= mended):
        count = _score(flagged, recommended)[0]
        if count > mended or (count and len(new) >= mended):
            first = steps[:1] if count > mended else []
            steps = [*first, _Step(changes=recommended, mended=count, source="this package's recommendation")]
            changes, mended = recommended, count
            new = _new_flags(others, changes)
    if len(new) >= mended:
        return None
    return Cure(
        changes=changes,
        line=_line(configuration, steps, dialect, len(flagged), new),
        flag_count=len(flagged),
        mended_count=mended,
        new_flags=new,
    )


def _greedy(
    flagged: Sequence[Subject],
    others: Sequence[Subject],
    dialect: Dialect,
    named: Collection[str],
) -> Iterator[_Step]:
    """Yield the single change that mends most, then further ones beside it; each must mend a further flag.

    Of the changes that mend most, the one with the fewest new flags is taken.
    """
    candidates = [one for one in _candidates(flagged) if dialect.writes(one.name)]
    changes: dict[str, Any] = {}
    left, mended = list(flagged), 0
    while left and candidates and len(changes) < MOST_CHANGES:
        scored = [(_score(left, {**changes, one.name: one.value}), one) for one in candidates]
        scored.sort(key=lambda pair: _preference(pair[1], named, *pair[0]), reverse=True)
        harms = [len(_new_flags(others, {**changes, one.name: one.value})) for _, one in scored[:MOST_COMPARED]]
        net = [count - harm for ((count, _), _), harm in zip(scored, harms, strict=False)]
        (count, _), best = scored[net.index(max(net))]
        if not count:
            return
        changes[best.name] = best.value
        mended += count
        yield _Step(changes={best.name: best.value}, mended=mended, source=best.source)
        left = [one for one in left if one.worst(changes).verdict is not Verdict.INSIDE]
        candidates = [one for one in candidates if one.name not in changes]


def _preference(one: Alternative, named: Collection[str], mended: int, closeness: float) -> tuple[float, ...]:
    """Return the order of a change: flags it mends, no shorter step, whether it is named for a row, closeness."""
    return (mended, one.name != STEP, one.name in named, closeness)


def _new_flags(others: Sequence[Subject], changes: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the rows that are visible or wrong only with the changes."""
    return tuple(
        subject.phenomenon.id
        for subject in others
        if subject.worst(changes).verdict in (Verdict.VISIBLE, Verdict.WRONG)
    )


def _candidates(flagged: Sequence[Subject]) -> list[Alternative]:
    found: dict[str, Alternative] = {}
    for subject in flagged:
        for settings in subject.sets.values():
            try:
                several = alternatives(subject.measurements, subject.phenomenon.scenario, settings)
            except DeclinedError:
                continue
            for one in (one for values in several.values() for one in values):
                found.setdefault(json.dumps([one.name, one.value]), one)
    return list(found.values())


def _score(subjects: Sequence[Subject], changes: Mapping[str, Any]) -> tuple[int, float]:
    """Return how many subjects are inside with changes, and minus the sum of all deviations."""
    outcomes = [subject.worst(changes) for subject in subjects]
    total = sum(min(one.deviation, LARGEST_DEVIATION) for one in outcomes)
    return sum(one.verdict is Verdict.INSIDE for one in outcomes), -total


def _recommended(configuration: TrainingConfiguration) -> dict[str, Any]:
    """Return the recommended settings that differ from the target's; a shorter step and more iterations are kept.

    A settings file has none, since its backend's preset is what it differs from.
    """
    recommended: Mapping[str, Any] = {}
    if configuration.is_model:
        recommended = RECOMMENDED_MUJOCO
    elif configuration.backend == "physx" and configuration.language != TOML.name:
        recommended = RECOMMENDED_PHYSX
    changes = {}
    for name, value in recommended.items():
        was = configuration.settings.get(name, 0.0 if name == "contact_margin_m" else None)
        if name == STEP and was is not None and was <= value:
            continue
        if name in AT_LEAST and was is not None and was >= value:
            continue
        if (tuple(was) if isinstance(was, list) else was) != value:
            changes[name] = value
    return changes


# --- words -----------------------------------------------------------------------------------------------------------


def _line(
    configuration: TrainingConfiguration, steps: Sequence[_Step], dialect: Dialect, flags: int, new: Sequence[str]
) -> str:
    parts = []
    for number, step in enumerate(steps):
        geoms = _geoms_that_change(configuration, step.changes)
        text = dialect.paste_text(step.changes, geoms=geoms)
        whole = step.source == "this package's recommendation"
        if not number:
            count = f"{step.mended} of {flags} flags go" if flags > 1 else "the one flag goes"
            parts.append(f"{text}: {count}")
        else:
            parts.append(f"{'all of' if whole else 'with'} {text}{'' if whole else ' too'}: {step.mended} of {flags}")
    sources = ", ".join(dict.fromkeys(step.source for step in steps))
    harm = f"; new flags: {', '.join(new)}" if new else ""
    return f"{'; '.join(parts)}{harm} (from {sources})"


def _geoms_that_change(configuration: TrainingConfiguration, changes: Mapping[str, Any]) -> str:
    """Return the geoms whose contact constants change, if there are several sets and not all change."""
    sets = configuration.contact_sets
    changing = [
        geoms
        for geoms, settings in sets.items()
        if any(name in settings and _plain(settings[name]) != _plain(value) for name, value in changes.items())
    ]
    return "; ".join(changing) if len(changing) < len(sets) else ""


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list | tuple) else value
