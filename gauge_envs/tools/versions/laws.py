"""Which of two versions is right: the misses of each side from laws and closed forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.differences import Gap, depths_m
from gauge_envs.tools.versions.environments import Arrays, Bench
from gauge_envs.tools.versions.schema import Ruling, Side

SPIN_LAW = "the angular momentum of a free body stays, in one step"
SPIN_LIMIT = 1e-6
"""Change of the angular momentum that counts, over it."""

SOLVER_LAW = "the solver reaches the solution of the engine's own equations (dense Newton, 1000 iterations)"
SOLVER_LIMIT = 1e-3
"""Distance from that solution that counts, over the acceleration."""

DEPTH_LAW = (
    "boxes and balls are as deep in each other as their geometry says (separating axes)"
)
DEPTH_LIMIT = 0.1
"""Miss of a depth that counts, over the depth: of nearly equal depths an engine may take the second."""

MIN_DEPTH_M = 1e-5
"""Depth from which it is judged [m]; less is the tolerance of convex solvers."""

LAW_RATIO = 10.0
"""A side is right if the other side misses the law by more than this multiple."""

MAX_SOLVED = 24
"""States in which both sides also solve their equations exactly."""

EXACT = {
    "jacobian": "dense",
    "solver": "newton",
    "iterations": 1000,
    "tolerance": 1e-14,
    "ls_iterations": 200,
    "ls_tolerance": 1e-6,
}
"""Settings with which a side solves its equations exactly."""


def rulings(
    bench: Bench,
    sides: Sequence[Side],
    gap: Gap,
    states: Arrays,
    fields: Mapping[str, Any],
) -> Iterator[Ruling]:
    """Yield each law that applies, and by how much each side misses it.

    Args:
        bench: The bench.
        sides: Both sides.
        gap: What both sides compute.
        states: The states. Those that differ most are solved again.
        fields: Compiled fields of the first side.
    """
    spins = np.array([side["spin"] for side in gap.sides])
    spins = spins[:, np.all(np.isfinite(spins), axis=0)]
    if np.max(spins, initial=0.0) > SPIN_LIMIT:
        yield _ruling(SPIN_LAW, spins, SPIN_LIMIT, sides)
    worst = gap.worst(MAX_SOLVED)
    if not len(worst):
        return
    file = bench.folder / "worst.npz"
    np.savez(file, allow_pickle=False, **{name: states[name][worst] for name in states})
    exact = [replace(side, settings={**side.settings, **EXACT}) for side in sides]
    outputs = bench.work([*sides, *exact], task="probe", states=[str(file)])
    given = [output.arrays for output in outputs[:2]]
    solved = [output.arrays for output in outputs[2:]]
    misses = [Gap(*pair).relative for pair in zip(given, solved, strict=True)]
    yield _ruling(SOLVER_LAW, np.array(misses), SOLVER_LIMIT, sides)
    # A release may leave out pairs on purpose.
    touching = [set(map(tuple, side["contact_pair"].tolist())) for side in gap.sides]
    depths = list(_depth_misses(fields, given, touching[0] & touching[1]))
    if depths:
        yield _ruling(DEPTH_LAW, np.transpose(depths), DEPTH_LIMIT, sides)


def _ruling(
    law: str, misses: FloatArray, limit: float, sides: Sequence[Side]
) -> Ruling:
    """Return which side keeps a law, from misses of shape [2, states]."""
    before, after = (float(miss) for miss in np.max(misses, axis=1))
    right = ""
    if after > max(limit, LAW_RATIO * before):
        right = sides[0].title
    elif before > max(limit, LAW_RATIO * after):
        right = sides[1].title
    return Ruling(
        law=law, before=before, after=after, states=misses.shape[1], right=right
    )


# --- depth by geometry -----------------------------------------------------------------------------------------------


class Solid(NamedTuple):
    """A box or a ball at a pose.

    Attributes:
        half_sizes_m: Half sizes of a box, shape [3]; 0 for a ball.
        radius_m: Radius of a ball; 0 for a box.
        position_m: Center, shape [3].
        rotation: Axes of a box as columns, shape [3, 3].
    """

    half_sizes_m: FloatArray
    radius_m: float
    position_m: FloatArray
    rotation: FloatArray


def depth_m(first: Solid, second: Solid) -> float:
    """Return how far two solids must move apart to touch no more [m]; negative for a gap between them."""
    if first.radius_m:
        first, second = second, first
    between_m = second.position_m - first.position_m
    if second.radius_m:
        outside_m = np.abs(first.rotation.T @ between_m) - first.half_sizes_m
        # A center inside leaves by the nearest face.
        distance_m = np.linalg.norm(np.maximum(outside_m, 0.0))
        distance_m += min(float(np.max(outside_m)), 0.0)
        return first.radius_m + second.radius_m - float(distance_m)
    # Two boxes are apart along one of 15 axes, or nowhere (Gottschalk et al. 1996).
    crosses = np.cross(first.rotation.T[:, None], second.rotation.T[None])
    crosses = crosses.reshape(-1, 3)
    lengths = np.linalg.norm(crosses, axis=1)
    is_axis = lengths > 1e-9
    crosses = crosses[is_axis] / lengths[is_axis, None]
    axes = np.concatenate([first.rotation.T, second.rotation.T, crosses])
    extents_m = np.abs(axes @ first.rotation) @ first.half_sizes_m
    extents_m += np.abs(axes @ second.rotation) @ second.half_sizes_m
    return float(np.min(extents_m - np.abs(axes @ between_m)))


def _depth_misses(
    fields: Mapping[str, Any], sides: Sequence[Arrays], pairs: set[tuple[Any, ...]]
) -> Iterator[FloatArray]:
    """Yield by how much each side misses the depth of a pair of boxes and balls, over it."""
    for index in range(len(sides[0]["qacc"])):
        contacts = [depths_m(side, index) for side in sides]
        for pair in sorted({*contacts[0], *contacts[1]} & pairs):
            kinds = {fields["geom_type"][geom] for geom in pair}
            if kinds <= {"mjGEOM_SPHERE", "mjGEOM_BOX"}:
                first, second = (_solid(fields, sides[0], index, geom) for geom in pair)
                true_m = depth_m(first, second)
                given_m = np.array([-min(each.get(pair, [0.0])) for each in contacts])
                if true_m > MIN_DEPTH_M:
                    yield np.abs(given_m - true_m) / true_m


def _solid(fields: Mapping[str, Any], side: Arrays, index: int, geom: int) -> Solid:
    """Return the box or ball that a geom is in a state."""
    is_ball = fields["geom_type"][geom] == "mjGEOM_SPHERE"
    size_m = np.array(fields["geom_size"][geom])
    return Solid(
        half_sizes_m=size_m * (not is_ball),
        radius_m=float(size_m[0] * is_ball),
        position_m=side["geom_xpos"][index, geom],
        rotation=side["geom_xmat"][index, geom].reshape(3, 3),
    )
