"""Compare two versions of an engine on one model: the same states, one step from each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gauge_envs.tools.versions.ends import settled
from gauge_envs.tools.versions.environments import sides_at_once
from gauge_envs.tools.versions.fields import field_changes
from gauge_envs.tools.versions.gap import DEPTH_TOLERANCE_M, Gap, Visit
from gauge_envs.tools.versions.model import (
    Comparison,
    PairChange,
    Parting,
    Side,
    Verdict,
)
from gauge_envs.tools.versions.processes import Bench, Observed, VersionsError, arrays
from gauge_envs.tools.versions.rulings import law_rulings, solved_rulings


def compare(bench: Bench, before: Side, after: Side) -> Comparison:
    """Return what differs between two versions on the model of a bench.

    Args:
        bench: The bench.
        before: First version.
        after: Second version.

    Raises:
        VersionsError: A version cannot run the model.
        ReleaseError: An environment cannot be made.
    """
    sides = (before, after)
    with sides_at_once() as pool:
        (one, one_file), (two, two_file) = pool.map(bench.run, sides)
        check_same_shape(bench, one, two)
        files = [one_file, two_file]
        first, second = pool.map(lambda side: bench.probe(side, files), sides)
        visits = [
            Visit(
                gap=Gap(first.probes[index], second.probes[index]),
                states=arrays(files[index]),
                title=sides[index].title,
                segments=[*(end["segment"] for end in one.words["ends"]), SAVED],
                names=one.words["names"],
            )
            for index in range(2)
        ]
        rulings = [*law_rulings(visits, sides)]
        rulings += solved_rulings(bench, sides, visits, pool)
    partings = [visit.first() for visit in visits]
    largest = max((visit.worst() for visit in visits), key=_acceleration)
    differing = sum(int(np.sum(visit.gap.differs)) for visit in visits)
    is_identical = all(visit.gap.is_identical for visit in visits)
    verdict = Verdict.IDENTICAL if is_identical else Verdict.SAME
    right = {ruling.right for ruling in rulings if ruling.right}
    fields, new_fields = field_changes(one.words, two.words)
    return Comparison(
        subject=bench.title,
        before=before.title,
        after=after.title,
        versions=(one.words["version"], two.words["version"]),
        verdict=Verdict.DIFFERENT if differing else verdict,
        states=sum(len(visit.gap.relative) for visit in visits),
        differing=differing,
        largest=max(float(np.max(visit.gap.relative)) for visit in visits),
        noise=float(np.median(np.concatenate([visit.gap.noise for visit in visits]))),
        first=next((one for one in partings if one is not None), None),
        worst=largest,
        fields=fields,
        new_fields=new_fields,
        dropped=(tuple(one.words["dropped"]), tuple(two.words["dropped"])),
        pairs=_pair_changes(visits),
        # Without a step that differs, ends differ by chaos alone.
        settled=tuple(settled(one.words, two.words)) if differing else (),
        rulings=tuple(rulings),
        right=right.pop() if differing and len(right) == 1 else "",
    )


def check_same_shape(bench: Bench, one: Observed, two: Observed) -> None:
    """Check that a state of one side is a state of the other."""
    counts = []
    for side in (one, two):
        counts.append(", ".join(f"{key} {side.words[key]}" for key in SHAPE))
    if counts[0] != counts[1]:
        raise VersionsError(
            f"{bench.title}: {one.side.title} compiles {counts[0]}; {two.side.title} compiles {counts[1]}. "
            "No state fits both."
        )


SAVED = "saved states"
"""States of the user's file, which are behind those of the segments."""

SHAPE = ("nq", "nv", "nu")
"""Sizes of a state."""


def _pair_changes(visits: Sequence[Visit]) -> tuple[PairChange, ...]:
    """Return the pairs of geoms whose contacts differ in number or depth, the one that differs most first."""
    found: dict[tuple[int, int], list[dict[str, Any]]] = {}
    for which, visit in enumerate(visits):
        for place, side in enumerate((visit.gap.before, visit.gap.after)):
            rows = zip(
                side["contact_pair"],
                side["contact_state"],
                side["contact_dist"],
                strict=True,
            )
            for (first, second), state, dist in rows:
                empty = [{"states": set(), "count": 0, "depth": 0.0} for _ in range(2)]
                entry = found.setdefault((int(first), int(second)), empty)[place]
                entry["states"].add((which, int(state)))
                entry["count"] += 1
                entry["depth"] = max(entry["depth"], -float(dist))
    total = sum(len(visit.gap.relative) for visit in visits)
    changes = []
    for (first, second), (one, two) in found.items():
        is_deeper = abs(one["depth"] - two["depth"]) > 10.0 * DEPTH_TOLERANCE_M
        if one["count"] != two["count"] or is_deeper:
            geoms = visits[0].names["geom"]
            changes.append(
                PairChange(
                    pair=(geoms[first], geoms[second]),
                    states=total,
                    states_before=len(one["states"]),
                    states_after=len(two["states"]),
                    contacts_before=one["count"],
                    contacts_after=two["count"],
                    depth_before_m=one["depth"],
                    depth_after_m=two["depth"],
                )
            )
    changes.sort(key=lambda one: -abs(one.contacts_before - one.contacts_after))
    return tuple(changes)


def _acceleration(parting: Parting | None) -> float:
    return -1.0 if parting is None else parting.acceleration
