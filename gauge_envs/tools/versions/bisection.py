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
    tried = {
        0: Release(
            release=ends[0].title, from_first=0.0, from_last=whole, like="first"
        ),
        len(releases) - 1: Release(
            release=ends[1].title, from_first=whole, from_last=0.0, like="last"
        ),
    }
    low, high = 0, len(releases) - 1
    while whole and high - low > 1:
        middle = (low + high) // 2
        found = bench.probe(releases[middle], files)
        gaps = (distance(first, found), distance(found, last))
        like = "first" if gaps[0] <= gaps[1] else "last"
        tried[middle] = Release(
            release=releases[middle].title,
            from_first=gaps[0],
            from_last=gaps[1],
            like=like,
        )
        say(f"{releases[middle].title} is like the {like} release")
        low, high = (middle, high) if like == "first" else (low, middle)
    ordered = [tried[index] for index in sorted(tried)]
    return ((releases[low], releases[high]) if whole else None), ordered
