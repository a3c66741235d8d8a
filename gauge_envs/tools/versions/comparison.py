"""Compare two versions of MuJoCo on one model, and find the release of a range with which a difference came."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gauge_envs.tools.versions.differences import (
    Gap,
    field_changes,
    pair_changes,
    parting,
    settled,
)
from gauge_envs.tools.versions.environments import (
    Arrays,
    Bench,
    Output,
    Say,
    VersionsError,
)
from gauge_envs.tools.versions.laws import rulings
from gauge_envs.tools.versions.schema import (
    Comparison,
    Release,
    Side,
    Verdict,
)

BITS = ("qacc", "step_acc", "constraint", "contact_dist", "contact_pair")
"""Results whose bits are compared."""


def compare(bench: Bench, before: Side, after: Side) -> Comparison:
    """Return what differs between two versions on the model of a bench.

    Raises:
        VersionsError: An environment cannot be made, or a version cannot run the model.
    """
    sides = (before, after)
    runs = _runs(bench, sides)
    gap = Gap(*_probes(bench, sides, runs))
    states = {
        name: np.concatenate([run.arrays[name] for run in runs])
        for name in runs[0].arrays
    }
    first, second = (run.description for run in runs)
    names = first["names"]
    ruled = tuple(rulings(bench, sides, gap, states, first["fields"]))
    rights = {ruling.right for ruling in ruled if ruling.right}
    is_different = bool(np.any(gap.differs))
    is_identical = all(
        np.array_equal(gap.sides[0][name], gap.sides[1][name]) for name in BITS
    )
    verdict = Verdict.IDENTICAL if is_identical else Verdict.SAME
    segments = [*(end["segment"] for end in first["ends"]), "saved states"]
    first_count = len(runs[0].arrays["step"])
    partings = [
        parting(
            gap,
            index,
            int(states["step"][index]),
            names,
            segment=segments[int(states["segment"][index])],
            of=(before if index < first_count else after).title,
        )
        for index in [*np.flatnonzero(gap.differs)[:1], *gap.worst(1)]
    ]
    # Where no step differs, chaos alone changes final positions.
    ends = settled(first["ends"], second["ends"], names["body"])
    return Comparison(
        subject=bench.title,
        before=before.title,
        after=after.title,
        versions=(first["version"], second["version"]),
        verdict=Verdict.DIFFERENT if is_different else verdict,
        states=len(gap.relative),
        differing=int(np.sum(gap.differs)),
        largest=float(np.max(gap.relative)),
        noise=float(np.median(gap.noise)),
        first=partings[0] if is_different else None,
        worst=partings[1] if is_different else None,
        fields=tuple(field_changes(first["fields"], second["fields"], names)),
        new_fields=tuple(sorted({*first["fields"]} ^ {*second["fields"]})),
        dropped=(tuple(first["dropped"]), tuple(second["dropped"])),
        pairs=pair_changes(gap, names["geom"]),
        settled=tuple(ends) if is_different else (),
        rulings=ruled,
        right=rights.pop() if is_different and len(rights) == 1 else "",
    )


def find_change(
    bench: Bench, releases: Sequence[Side], say: Say = print
) -> tuple[list[Side], list[Release]]:
    """Return two neighboring releases between which the difference of the ends of a range came.

    A release belongs to the end whose accelerations are nearer to its accelerations, in the states that both ends
    visit. If the range has several changes, this finds one of them.

    Args:
        bench: The bench.
        releases: The releases, the oldest first.
        say: Prints what was tried.

    Returns:
        The two releases, which are the ends if these do not differ; and the releases that were tried, in their order.
    """
    low, high = 0, len(releases) - 1
    ends = (releases[low], releases[high])
    runs = _runs(bench, ends)
    first, last = _probes(bench, ends, runs)
    whole = Gap(first, last).distance
    tried = {
        low: Release(
            release=ends[0].title, from_first=0.0, from_last=whole, like="first"
        ),
        high: Release(
            release=ends[1].title, from_first=whole, from_last=0.0, like="last"
        ),
    }
    while whole and high - low > 1:
        middle = (low + high) // 2
        side = releases[middle]
        (probe,) = _probes(bench, [side], runs)
        distances = Gap(first, probe).distance, Gap(probe, last).distance
        like = "first" if distances[0] <= distances[1] else "last"
        tried[middle] = Release(
            release=side.title,
            from_first=distances[0],
            from_last=distances[1],
            like=like,
        )
        say(f"{side.title} is like the {like} release")
        low, high = (middle, high) if like == "first" else (low, middle)
    return [releases[low], releases[high]], [tried[index] for index in sorted(tried)]


def _runs(bench: Bench, sides: Sequence[Side]) -> list[Output]:
    """Move the model on both sides, and check that a state of one side is a state of the other."""
    runs = bench.work(sides, task="run")
    before, after = (run.description["sizes"] for run in runs)
    if before != after:
        raise VersionsError(
            f"{bench.title}: {sides[0].title} compiles {before}; {sides[1].title} compiles {after}. No state fits both."
        )
    return runs


def _probes(
    bench: Bench, sides: Sequence[Side], runs: Sequence[Output]
) -> list[Arrays]:
    """Compute one step from each state of runs, on each side."""
    files = [run.file for run in runs]
    outputs = bench.work(sides, task="probe", states=files)
    return [output.arrays for output in outputs]
