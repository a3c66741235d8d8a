"""Divergence of a simulation by four rules, which also give the bounds of observations.

1. A number is not finite.
2. A body moves faster than 50 m/s, or spins faster than 10,000 rad/s.
3. A body, or a node of a deformable body, is more than 100 m from the origin along an axis.
4. A deformable body spans more than three times what it spans at the start.

Real trials stay far below: the fastest has 5 m/s, and the largest strain in the paper is 0.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gauge_envs.scene.geometry import FloatArray

SPEED_LIMIT_M_PER_S = 50.0
SPIN_LIMIT_RAD_PER_S = 1e4
DISTANCE_LIMIT_M = 100.0
STRETCH_LIMIT = 3.0

STATE_LIMITS = np.repeat(
    [DISTANCE_LIMIT_M, 1.0 + 1e-6, SPEED_LIMIT_M_PER_S, SPIN_LIMIT_RAD_PER_S],
    [3, 4, 3, 3],
)
"""Largest absolute value of each number of a state, shape [13]."""


def diverged_bodies(names: Sequence[str], states: FloatArray) -> dict[int, str]:
    """Return the reason of each diverged world, by its number.

    Args:
        names: Names of the bodies.
        states: Their states, shape [N, len(names), 13].
    """
    # A comparison with NaN is false.
    is_within = np.abs(states) <= STATE_LIMITS
    if is_within.all():
        return {}
    reasons = {}
    for world in np.flatnonzero(~is_within.all(axis=(1, 2))).tolist():
        row, column = np.argwhere(~is_within[world])[0].tolist()
        reasons[world] = _reason(names[row], column, states[world, row])
    return reasons


def _reason(name: str, column: int, state: FloatArray) -> str:
    """Return why a body has diverged, from the column of its state that is out of bounds."""
    if not np.isfinite(state).all():
        return f"the state of {name} is not finite"
    if column < 3:
        return f"{name} is more than {DISTANCE_LIMIT_M:g} m from the origin"
    if column < 7:
        return f"the quaternion of {name} is not a unit quaternion"
    if column < 10:
        return f"{name} moves faster than {SPEED_LIMIT_M_PER_S:g} m/s"
    return f"{name} spins faster than {SPIN_LIMIT_RAD_PER_S:g} rad/s"


def spans_m(nodes_m: FloatArray) -> FloatArray:
    """Return the diagonals of the boxes around nodes [m], shape [N], from shape [N, node_count, 3]."""
    return np.linalg.norm(np.ptp(nodes_m, axis=1), axis=-1)


def diverged_nodes(name: str, nodes_m: FloatArray, rest_m: float) -> dict[int, str]:
    """Return the reason of each diverged world, by its number.

    Args:
        name: Name of a deformable body.
        nodes_m: Its nodes [m], shape [N, node_count, 3].
        rest_m: Its span at the start [m].
    """
    low_m, high_m = nodes_m.min(axis=1), nodes_m.max(axis=1)
    sizes_m = high_m - low_m
    spans = np.sqrt((sizes_m * sizes_m).sum(axis=1))
    is_near = (np.maximum(-low_m, high_m) <= DISTANCE_LIMIT_M).all(axis=1)
    is_within = is_near & (spans <= STRETCH_LIMIT * rest_m)
    if is_within.all():
        return {}
    reasons = {}
    for world in np.flatnonzero(~is_within).tolist():
        if not np.isfinite(nodes_m[world]).all():
            reasons[world] = f"a node of {name} is not finite"
        elif not is_near[world]:
            reasons[world] = (
                f"{name} is more than {DISTANCE_LIMIT_M:g} m from the origin"
            )
        else:
            reasons[world] = (
                f"{name} spans {spans[world]:.3g} m, more than {STRETCH_LIMIT:g} times its {rest_m:.3g} m at the start"
            )
    return reasons
