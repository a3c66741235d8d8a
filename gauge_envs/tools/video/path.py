"""Choose the places of an object among the candidates of all frames of a video."""

import math
from collections.abc import Sequence

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.follow import Sight

MOST_GAP = 40
"""Most frames after which the object is still looked for as itself."""

BEND, BEND_COST, MOST_COST = 0.5, 0.4, 1.5
"""Change of the velocity from frame to frame, in sizes, that costs `BEND_COST` of a likeness; a jump costs
`MOST_COST`."""

MOST_STEP = 4.0
"""Largest step from frame to frame, in sizes or in changes by gravity."""

FIRST_STEP, FIRST_FRAMES = 0.4, 3
"""Distance from the known place, in sizes, and frames, in which a path begins."""


def best_path(
    candidates: Sequence[Sequence[Sight]],
    start_px: FloatArray,
    size_px: float,
    lawful_px: float = 0.0,
    is_struck: bool = False,
) -> list[Sight]:
    """Return the places of the whole clip with the largest sum of likenesses, less what changes of the velocity cost.

    Dynamic programming over all candidates; a frame may have none. The path begins at rest at a known place.

    Args:
        candidates: Candidates by frame.
        start_px: Place before the first frame [px], shape [2].
        size_px: Size of the object [px].
        lawful_px: Largest change of the step from frame to frame that the law makes [px].
        is_struck: Whether it may return to that place, where impacts change its velocity at no cost.
    """
    usual_px = max(BEND * size_px, lawful_px)
    nodes = [(-1, Sight(x_px=float(start_px[0]), y_px=float(start_px[1])))]
    for frame, ones in enumerate(candidates):
        nodes += [(frame, nodes[0][1])] * is_struck + [(frame, one) for one in ones]
    hangs = np.array([is_struck and one is nodes[0][1] for _, one in nodes])
    frames = np.array([frame for frame, _ in nodes])
    places = np.array([one.place for _, one in nodes])
    totals, speeds, before = (
        np.zeros(len(nodes)),
        np.zeros((len(nodes), 2)),
        np.full(len(nodes), -1),
    )
    # Where the known place shows the object in one of the first frames, the path begins there.
    near = (frames < FIRST_FRAMES) & (
        np.linalg.norm(places - start_px, axis=1) <= FIRST_STEP * size_px
    )
    at_start = set(np.flatnonzero(near).tolist()) - {0}
    for node in range(1, len(nodes)):
        gap = frames[node] - frames[:node]
        steps = (places[node] - places[:node]) / np.maximum(gap, 1)[:, None]
        # When it was struck between two frames is unknown, and so is the velocity of its first step.
        bend = (
            np.linalg.norm(steps - speeds[:node], axis=1)
            / usual_px
            * ~(hangs[:node] | hangs[before[:node]])
        )
        value = totals[:node] - np.minimum(BEND_COST * bend**2, MOST_COST)
        is_possible = (gap > 0) & ((gap <= MOST_GAP) | (frames[:node] < 0))
        is_possible &= np.linalg.norm(steps, axis=1) <= MOST_STEP * max(
            size_px, lawful_px
        )
        is_possible[0] &= not at_start or node in at_start
        if not is_possible.any():
            totals[node] = -math.inf
            continue
        best = int(np.argmax(np.where(is_possible, value, -math.inf)))
        before[node], totals[node] = best, value[best] + nodes[node][1].likeness
        speeds[node] = steps[best]
    path = [Sight() for _ in candidates]
    node = int(totals.argmax())
    while node > 0:
        path[frames[node]] = Sight() if hangs[node] else nodes[node][1]
        node = int(before[node])
    return path
