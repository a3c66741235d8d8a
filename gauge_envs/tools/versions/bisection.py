"""Find the release with which a difference came."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gauge_envs.tools.versions.comparison import check_same_shape
from gauge_envs.tools.versions.gap import distance
from gauge_envs.tools.versions.model import Release, Side
from gauge_envs.tools.versions.processes import Bench


def bisect(
    bench: Bench, releases: Sequence[Side], say: Callable[[str], object] = print
) -> tuple[tuple[Side, Side] | None, list[Release]]:
    """Return two neighbouring releases between which the difference of the ends of a range lies.

    A release belongs to the end whose accelerations are nearer to its own, in the states that both ends visit. Of
    several changes in the range one is found.

    Args:
        bench: The bench.
        releases: The releases, the oldest first.
        say: Prints what was tried.

    Returns:
        The two releases, or None if the ends do not differ; and the releases that were tried, in their order.
    """
    ends = (releases[0], releases[-1])
    runs = [bench.run(end) for end in ends]
    check_same_shape(bench, runs[0][0], runs[1][0])
    files = [file for _, file in runs]
    first, last = (bench.probe(end, files) for end in ends)
    whole = distance(first, last)
    low, high = 0, len(releases) - 1
    gaps = {low: (0.0, whole), high: (whole, 0.0)}
    while whole and high - low > 1:
        middle = (low + high) // 2
        found = bench.probe(releases[middle], files)
        gaps[middle] = (distance(first, found), distance(found, last))
        side = _like(*gaps[middle])
        say(f"{releases[middle].title} is like the {side} release")
        low, high = (middle, high) if side == "first" else (low, middle)
    tried = [
        Release(
            release=releases[index].title,
            from_first=from_first,
            from_last=from_last,
            like=_like(from_first, from_last),
        )
        for index, (from_first, from_last) in sorted(gaps.items())
    ]
    return ((releases[low], releases[high]) if whole else None), tried


def _like(from_first: float, from_last: float) -> str:
    return "first" if from_first <= from_last else "last"
