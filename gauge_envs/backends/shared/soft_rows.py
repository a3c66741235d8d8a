"""Rows of soft boxes, whatever the engine: which boxes join face to face, what grips their ends, what is left free."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import ShapeError, UnsupportedSceneError
from gauge_envs.scene import Motion, SoftBody

__all__ = [
    "TOLERANCE_M",
    "Block",
    "SoftRow",
]

TOLERANCE_M = 1e-5
"""Distance below which faces touch and points lie inside [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """The free material of one soft box, aligned with the world's axes.

    Attributes:
        body: What it is made of.
        low_m: Lowest corner [m], shape [3].
        high_m: Highest corner [m], shape [3].
    """

    body: SoftBody
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]

    @property
    def density_kg_per_m3(self) -> float:
        """Mass of the whole body per volume of the whole body."""
        return self.body.mass_kg / self.body.shape.volume_m3

    @property
    def centre_m(self) -> NDArray[np.float64]:
        """Middle of the free material [m], shape [3]."""
        return 0.5 * (self.low_m + self.high_m)

    def holds(self, points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points [m], shape [point_count, 3], lie inside or on the faces, shape [point_count]."""
        inside = (points_m > self.low_m - TOLERANCE_M) & (points_m < self.high_m + TOLERANCE_M)
        return np.asarray(inside.all(axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class SoftRow:
    """Soft boxes bonded face to face along a world axis; one box is a row too.

    Attributes:
        axis: World axis of the row.
        blocks: Free material of each box, from the low to the high end.
        ends: What grips the low and the high end.
    """

    axis: int
    blocks: tuple[Block, ...]
    ends: Mapping[str, RigidAttachment]

    @classmethod
    def of(cls, bodies: Sequence[SoftBody], glued: Mapping[str, Sequence[RigidAttachment]]) -> SoftRow:
        """Sort bodies into a row and cut off what sits in grips.

        Args:
            bodies: One body, or all bodies of a row in any order.
            glued: What is glued to rigid bodies, by name of the soft body.

        Raises:
            UnsupportedSceneError: A body is not turned by right angles, the bodies do not form a row, something else
                than a free end is glued, or an end is glued to a body that moves under forces.
        """
        boxes = [_box(body) for body in bodies]
        grips = [(box, glue) for box in boxes for glue in glued.get(box.body.name, ())]
        if len(boxes) > 1:
            axis = int(np.argmax(np.ptp([box.low_m + box.high_m for box in boxes], axis=0)))
        elif grips:
            axis = _world_axis(*grips[0])[0]
        else:
            axis = int(np.argmax(boxes[0].high_m - boxes[0].low_m))
        boxes.sort(key=lambda box: float(box.low_m[axis]))
        for first, second in pairwise(boxes):
            _check_joined(first, second, axis)
        ends: dict[str, RigidAttachment] = {}
        for box, glue in grips:
            found, side = _world_axis(box, glue)
            if found != axis or box is not (boxes[0] if side == "low" else boxes[-1]) or side in ends:
                raise UnsupportedSceneError(f"soft body {box.body.name!r} is glued elsewhere than at a free end")
            if glue.motion is Motion.DYNAMIC:
                raise UnsupportedSceneError(
                    f"soft body {box.body.name!r} is glued to {glue.body!r}, which moves under forces"
                )
            ends[side] = glue
            # A box owns its corners: nothing else sees them shrink.
            if side == "low":
                box.low_m[axis] += glue.region.depth_m
            else:
                box.high_m[axis] -= glue.region.depth_m
        return cls(axis=axis, blocks=tuple(boxes), ends=ends)

    @property
    def low_m(self) -> NDArray[np.float64]:
        """Lowest corner of the free material [m], shape [3]."""
        return self.blocks[0].low_m

    @property
    def high_m(self) -> NDArray[np.float64]:
        """Highest corner of the free material [m], shape [3]."""
        return self.blocks[-1].high_m

    def gripped(self, points_m: NDArray[np.float64]) -> Iterator[tuple[RigidAttachment, NDArray[np.intp]]]:
        """For each grip the rows of points [m], shape [point_count, 3], that are on its face or beyond it."""
        along = points_m[:, self.axis]
        for side, glue in self.ends.items():
            if side == "low":
                yield glue, np.flatnonzero(along < self.low_m[self.axis] + TOLERANCE_M)
            else:
                yield glue, np.flatnonzero(along > self.high_m[self.axis] - TOLERANCE_M)

    def checked(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points [m], shape [point_count, 3], if all of them lie in the free material.

        Raises:
            ShapeError: One does not.
        """
        outside = np.maximum(self.low_m - points_m, points_m - self.high_m).max(axis=1)
        if not np.all(outside < TOLERANCE_M):
            worst = int(np.argmax(outside))
            raise ShapeError(f"point {worst} lies {1e3 * outside[worst]:.3g} mm outside the free soft material")
        return points_m


def _box(body: SoftBody) -> Block:
    turn = body.pose.rotation.as_matrix()
    if not np.allclose(turn, np.rint(turn), atol=1e-6):
        raise UnsupportedSceneError(f"soft body {body.name!r} is not turned by right angles")
    half = 0.5 * np.abs(np.rint(turn)) @ body.shape.size_m
    centre = np.asarray(body.pose.position_m)
    return Block(body=body, low_m=centre - half, high_m=centre + half)


def _world_axis(block: Block, glue: RigidAttachment) -> tuple[int, str]:
    """World axis and side of a glued region, which is given in the body's frame."""
    direction = block.body.pose.rotation.as_matrix()[:, "xyz".index(glue.region.axis)]
    axis = int(np.argmax(np.abs(direction)))
    flipped = {"low": "high", "high": "low"}[glue.region.side]
    return axis, glue.region.side if direction[axis] > 0.0 else flipped


def _check_joined(first: Block, second: Block, axis: int) -> None:
    low, high = first.low_m.copy(), first.high_m.copy()
    high[axis] += second.high_m[axis] - second.low_m[axis]
    low[axis] = first.high_m[axis]
    if max(np.abs(second.low_m - low).max(), np.abs(second.high_m - high).max()) > TOLERANCE_M:
        names = f"{first.body.name!r} and {second.body.name!r}"
        raise UnsupportedSceneError(f"soft bodies {names} do not join face to face")
