"""Which of two versions is right, where a law tells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.gap import Gap, Visit, depths_m
from gauge_envs.tools.versions.model import Ruling, Side
from gauge_envs.tools.versions.overlap import Solid, depth_m
from gauge_envs.tools.versions.processes import Arrays, Bench

SOLVER_LIMIT = 1e-3
"""Distance from the solution of an engine's own equations that counts, over the acceleration."""

DEPTH_LIMIT = 0.1
"""Miss of a depth that counts, over the depth: of nearly equal ways out an engine may take the second."""

DEEP_ENOUGH_M = 1e-5
"""Depth from which it is judged [m]; less is the tolerance of convex solvers."""

LAW_RATIO = 10.0
"""A side is right if the other one misses the law by more than this multiple."""

SOLVED_STATES = 24
"""States in which both sides also solve their equations to the end."""

EXACT = {
    "jacobian": "dense",
    "solver": "newton",
    "iterations": 1000,
    "tolerance": 1e-14,
    "ls_iterations": 200,
    "ls_tolerance": 1e-6,
}
"""Settings with which a side solves its equations to the end."""


def law_rulings(visits: Sequence[Visit], sides: Sequence[Side]) -> Iterator[Ruling]:
    """Yield the laws that hold in every state, where a side misses one."""
    for name, (law, limit) in LAWS.items():
        misses = []
        for side in ("before", "after"):
            values = [getattr(visit.gap, side)[name] for visit in visits]
            misses.append(np.concatenate(values))
        applies = np.isfinite(misses[0]) & np.isfinite(misses[1])
        if np.any(applies):
            worst = [float(np.max(miss[applies])) for miss in misses]
            if max(worst) > limit:
                yield _ruling(law, worst, limit, int(np.sum(applies)), sides)


LAWS = {
    "imbalance": (
        "mass x acceleration = applied + constraint forces, as the engine states them",
        1e-3,
    ),
    "spin": ("the angular momentum of a free body stays, in one step", 1e-6),
}
"""Law of each probed miss, and the miss that counts, as a fraction."""


def _ruling(
    law: str, worst: Sequence[float], limit: float, states: int, sides: Sequence[Side]
) -> Ruling:
    right = ""
    for this, other, side in ((0, 1, sides[0]), (1, 0, sides[1])):
        if worst[other] > max(limit, LAW_RATIO * worst[this]):
            right = side.title
    return Ruling(law=law, before=worst[0], after=worst[1], states=states, right=right)


def _worst_states(visits: Sequence[Visit]) -> dict[str, NDArray[Any]] | None:
    """Return the states in which the sides part most; None if they do not part."""
    relative = np.concatenate([visit.gap.relative for visit in visits])
    differs = np.concatenate([visit.gap.differs for visit in visits])
    order = np.argsort(np.where(differs, -relative, np.inf), kind="stable")
    worst = order[: min(SOLVED_STATES, int(np.sum(differs)))]
    if not worst.size:
        return None
    return {
        name: np.concatenate([visit.states[name] for visit in visits])[worst]
        for name in visits[0].states
    }


def solved_rulings(
    bench: Bench,
    sides: Sequence[Side],
    visits: Sequence[Visit],
    pool: ThreadPoolExecutor,
) -> Iterator[Ruling]:
    """Yield by how much each side misses the solution of its own equations, and the depths of its shapes.

    Args:
        bench: The bench.
        sides: Both sides.
        visits: States of both; of those that differ, the worst are computed again.
        pool: Runs the processes.
    """
    states = _worst_states(visits)
    if states is None:
        return
    file = bench.kept(states)
    found = list(pool.map(lambda one: bench.probe(one, [file], exact=EXACT), sides))
    worst = [float(np.max(Gap(*observed.probes).relative)) for observed in found]
    law = "the solver reaches the solution of the engine's own equations (dense Newton, 1000 iterations)"
    yield _ruling(law, worst, SOLVER_LIMIT, len(states["qpos"]), sides)
    given = [observed.probes[0] for observed in found]
    misses = _depth_misses(found[0].words, given, _common(visits))
    if len(misses):
        worst = [float(value) for value in np.max(misses, axis=0)]
        law = "boxes and balls are as deep in each other as their geometry says (separating axes)"
        yield _ruling(law, worst, DEPTH_LIMIT, len(misses), sides)


def _common(visits: Sequence[Visit]) -> set[tuple[int, int]]:
    """Return the pairs of geoms that touch on both sides; a release may leave other pairs out on purpose."""
    touching = []
    for side in ("before", "after"):
        rows = [getattr(visit.gap, side)["contact_pair"] for visit in visits]
        touching.append({(int(one), int(two)) for one, two in np.concatenate(rows)})
    return touching[0] & touching[1]


def _depth_misses(
    words: Mapping[str, Any], sides: Sequence[Arrays], common: set[tuple[int, int]]
) -> FloatArray:
    """Return by how much each side misses the depth of each pair of boxes and balls, over it, shape [pair, side]."""
    kinds, sizes = words["fields"]["geom_type"], np.array(words["fields"]["geom_size"])
    misses = []
    for index in range(len(sides[0]["qacc"])):
        depths = [depths_m(side, index) for side in sides]
        for pair in sorted({*depths[0], *depths[1]} & common):
            one, two = (
                _solid(kinds[geom], sizes[geom], sides[0], index, geom) for geom in pair
            )
            if one is None or two is None:
                continue
            true_m = depth_m(one, two)
            if true_m > DEEP_ENOUGH_M:
                stated = [-min(found.get(pair, [0.0])) for found in depths]
                misses.append(np.abs(np.array(stated) - true_m) / true_m)
    return np.array(misses)


def _solid(
    kind: str, size: FloatArray, side: Arrays, index: int, geom: int
) -> Solid | None:
    """Return the box or ball that a geom is at a state; None for another shape."""
    is_ball = kind == "mjGEOM_SPHERE"
    if not is_ball and kind != "mjGEOM_BOX":
        return None
    return Solid(
        half_sizes_m=np.zeros(3) if is_ball else size,
        radius_m=float(size[0]) if is_ball else 0.0,
        position_m=side["geom_xpos"][index, geom],
        rotation=side["geom_xmat"][index, geom].reshape(3, 3),
    )
