"""Compare two versions of MuJoCo on one model, and find the release of a range with which a difference came."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gauge_envs.cli.output import message
from gauge_envs.tools.versions.differences import Gap, parting
from gauge_envs.tools.versions.environments import (
    Arrays,
    Bench,
    Output,
    VersionsError,
)
from gauge_envs.tools.versions.laws import rulings
from gauge_envs.tools.versions.schema import (
    Comparison,
    FieldChange,
    Release,
    Side,
    Verdict,
)

BITS = ("qacc", "step_acc", "touching")
"""Results whose bits are compared."""

FIELD_TOLERANCE = 1e-9
"""Relative difference of a compiled number that counts."""


def compare(bench: Bench, before: Side, after: Side) -> Comparison:
    """Return what differs between two versions on the model of a bench.

    Raises:
        VersionsError: An environment cannot be made, or a version cannot run the model.
    """
    sides = (before, after)
    runs, states = _runs(bench, sides)
    gap = Gap(*_probes(bench, sides, states))
    first, second = (run.description for run in runs)
    verdict = Verdict.SAME
    if np.any(gap.differs):
        verdict = Verdict.DIFFERENT
    elif all(np.array_equal(*gap.pair(name)) for name in BITS):
        verdict = Verdict.IDENTICAL
    indices = [*np.flatnonzero(gap.differs)[:1], *gap.worst(1)]
    partings = [parting(gap, index, states, first["names"]) for index in indices]
    first_parting, worst_parting = partings or (None, None)
    ruled = tuple(rulings(bench, sides, gap, states, first["fields"]))
    rights = {ruling.right for ruling in ruled if ruling.right}
    return Comparison(
        subject=bench.title,
        before=before.title,
        after=after.title,
        versions=(first["version"], second["version"]),
        verdict=verdict,
        states=len(gap.relative),
        differing=int(np.sum(gap.differs)),
        largest=float(np.max(gap.relative)),
        noise=float(np.median(gap.noise)),
        first=first_parting,
        worst=worst_parting,
        fields=tuple(field_changes(first["fields"], second["fields"], first["names"])),
        new_fields=tuple(sorted({*first["fields"]} ^ {*second["fields"]})),
        dropped=(first["dropped"], second["dropped"]),
        rulings=ruled,
        right=rights.pop() if len(rights) == 1 else "",
    )


def field_changes(
    before: Mapping[str, Any], after: Mapping[str, Any], names: Mapping[str, list[str]]
) -> Iterator[FieldChange]:
    """Yield the compiled fields of two sides that differ: the row that differs most, and how many differ.

    Args:
        before: Fields of the first side.
        after: Fields of the second side.
        names: Names of objects by the prefix of their fields.
    """
    for name, value in before.items():
        other = after.get(name, value)
        first, second = np.array(value), np.array(other)
        if name.startswith("opt.") or first.shape != second.shape:
            if value != other:
                yield FieldChange(
                    field=name, where="", count=1, before=value, after=other
                )
            continue
        is_close = np.isclose(
            first, second, rtol=FIELD_TOLERANCE, atol=1e-12, equal_nan=True
        )
        size = np.where(is_close, 0.0, np.abs(first - second))
        if np.any(size):
            sizes = size.reshape(len(size), -1).max(axis=1)
            row = int(np.argmax(sizes))
            owners = names.get(name.partition("_")[0], [])
            yield FieldChange(
                field=name,
                where=owners[row] if len(owners) == len(sizes) else f"row {row}",
                count=int(np.count_nonzero(sizes)),
                before=value[row],
                after=other[row],
            )


def find_change(
    bench: Bench, releases: Sequence[Side]
) -> tuple[list[Side], list[Release]]:
    """Return two neighboring releases between which the difference of the ends of a range came.

    A release belongs to the end whose accelerations are nearer to its accelerations, in the states that both ends
    visit. If the range has several changes, this finds one of them.

    Args:
        bench: The bench.
        releases: The releases, the oldest first.

    Returns:
        The two releases, which are the ends if these do not differ; and the releases that were tried, in their order.
    """
    low, high = 0, len(releases) - 1
    ends = (releases[low], releases[high])
    _, states = _runs(bench, ends)
    first, last = _probes(bench, ends, states)

    def attempt(side: Side, probe: Arrays) -> Release:
        """Return how far a release is from both ends."""
        from_first, from_last = Gap(first, probe).distance, Gap(probe, last).distance
        return Release(
            release=side.title,
            from_first=from_first,
            from_last=from_last,
            like="first" if from_first <= from_last else "last",
        )

    tried = {low: attempt(ends[0], first), high: attempt(ends[1], last)}
    while tried[high].from_first and high - low > 1:
        middle = (low + high) // 2
        side = releases[middle]
        (probe,) = _probes(bench, [side], states)
        tried[middle] = attempt(side, probe)
        message(f"{side.title} is like the {tried[middle].like} release")
        if tried[middle].like == "first":
            low = middle
        else:
            high = middle
    return [releases[low], releases[high]], [tried[index] for index in sorted(tried)]


def _runs(bench: Bench, sides: Sequence[Side]) -> tuple[list[Output], Arrays]:
    """Move the model on both sides, and return the states of both, which must fit both."""
    runs = bench.work("run", sides)
    before, after = (run.description["sizes"] for run in runs)
    if before != after:
        raise VersionsError(
            f"{bench.title}: {sides[0].title} compiles {before}; {sides[1].title} compiles {after}. No state fits both."
        )
    first, second = (run.arrays for run in runs)
    states = {name: np.concatenate([first[name], second[name]]) for name in first}
    titles = [side.title for side in sides]
    states["of"] = np.repeat(titles, [len(first["step"]), len(second["step"])])
    return runs, states


def _probes(bench: Bench, sides: Sequence[Side], states: Arrays) -> list[Arrays]:
    """Compute one step from each state, on each side."""
    return [output.arrays for output in bench.work("probe", sides, states)]
