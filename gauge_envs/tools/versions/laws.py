"""Which of two versions is right: the misses of each side from laws and closed forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.differences import Gap, distances_m
from gauge_envs.tools.versions.environments import Arrays, Bench
from gauge_envs.tools.versions.schema import Ruling, Side

SOLVER_LAW = "the solver reaches the solution of the engine's own equations (dense Newton, 1000 iterations)"
SOLVER_LIMIT = 1e-3
"""Distance from that solution that counts, over the acceleration."""

DEPTH_LAW = "boxes are as deep in each other as their geometry says"
DEPTH_LIMIT = 0.1
"""Miss of a depth that counts, over the depth: of nearly equal depths an engine may take the second."""

MIN_DEPTH_M = 1e-5
"""Depth from which it is judged [m]; less is the tolerance of convex solvers."""

LAW_RATIO = 10.0
"""A side is right if the other side misses the law by more than this multiple."""

MAX_SOLVED = 24
"""States in which both sides also solve their equations exactly."""

BOX = float(mujoco.mjtGeom.mjGEOM_BOX)

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
    worst = gap.worst(MAX_SOLVED)
    if not worst:
        return
    exact = [replace(side, settings={**side.settings, **EXACT}) for side in sides]
    differing = {name: states[name][worst] for name in states}
    misses = []
    outputs = bench.work("probe", exact, differing)
    for side, output in zip(gap.sides, outputs, strict=True):
        given = {name: side[name][worst] for name in side if name != "touching"}
        misses.append(Gap(given, output.arrays).relative)
    yield _ruling(SOLVER_LAW, misses, SOLVER_LIMIT, sides)
    depths = list(_depth_misses(fields, gap.sides, worst))
    if depths:
        yield _ruling(DEPTH_LAW, np.transpose(depths), DEPTH_LIMIT, sides)


def _ruling(law: str, misses: ArrayLike, limit: float, sides: Sequence[Side]) -> Ruling:
    """Return which side keeps a law, from misses of shape [2, states]."""
    both = np.array(misses)
    before, after = np.max(both, axis=1).tolist()
    right = ""
    if after > max(limit, LAW_RATIO * before):
        right = sides[0].title
    elif before > max(limit, LAW_RATIO * after):
        right = sides[1].title
    return Ruling(
        law=law, before=before, after=after, states=both.shape[1], right=right
    )


def depth_m(first: FloatArray, second: FloatArray) -> float:
    """Return how far two convex bodies must move apart to touch no more [m]; negative if they do not touch.

    The Minkowski difference of two bodies that touch contains the origin. The depth is the distance of the origin from
    its nearest face (Cameron 1997).

    Args:
        first: Corners of the first body [m], shape [n, 3].
        second: Corners of the second body [m], shape [m, 3].
    """
    differences_m = (first[:, None] - second[None]).reshape(-1, 3)
    return -float(np.max(ConvexHull(differences_m).equations[:, 3]))


def _depth_misses(
    fields: Mapping[str, Any], sides: Sequence[Arrays], states: Sequence[int]
) -> Iterator[FloatArray]:
    """Yield by how much each side misses the depth of a pair of boxes, over it."""
    for index in states:
        contacts = [distances_m(side, index) for side in sides]
        for pair in sorted({*contacts[0], *contacts[1]}):
            if any(fields["geom_type"][geom] != BOX for geom in pair):
                continue
            true_m = depth_m(
                *(
                    corners_m(
                        fields["geom_size"][geom],
                        sides[0]["geom_xpos"][index, geom],
                        sides[0]["geom_xmat"][index, geom].reshape(3, 3),
                    )
                    for geom in pair
                )
            )
            if true_m > MIN_DEPTH_M:
                given_m = np.array([-min(each.get(pair, [0.0])) for each in contacts])
                yield np.abs(given_m - true_m) / true_m


def corners_m(
    half_sizes_m: FloatArray, center_m: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the corners of a box [m], shape [8, 3]; the columns of the rotation are its axes."""
    corners = half_sizes_m * np.array([*product((-1.0, 1.0), repeat=3)])
    return center_m + corners @ rotation.T
