"""Rows of bonded soft boxes, for every engine: their order, the grips at their ends, and the free material."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import ShapeError, UnsupportedSceneError
from gauge_envs.scene import Motion, SoftBody

TOLERANCE_M = 1e-5
"""Distance below which faces touch and points lie inside [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """The free material of one soft box, aligned with the world's axes.

    Attributes:
        body: The soft body that it belongs to.
        low_m: Lowest corner [m], shape [3].
        high_m: Highest corner [m], shape [3].
    """

    body: SoftBody
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]

    @property
    def density_kg_per_m3(self) -> float:
        """Density of the body [kg/m^3], grips included."""
        return self.body.mass_kg / self.body.shape.volume_m3

    @property
    def centre_m(self) -> NDArray[np.float64]:
        """Centre of the free material [m], shape [3]."""
        return 0.5 * (self.low_m + self.high_m)

    def holds(self, points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether points [m], shape [point_count, 3], lie inside or on the faces, shape [point_count]."""
        inside = (points_m > self.low_m - TOLERANCE_M) & (points_m < self.high_m + TOLERANCE_M)
        return np.asarray(inside.all(axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class SoftRow:
    """Soft boxes bonded face to face along a world axis; a single box is a row of length one.

    Attributes:
        axis: Index of the world axis of the row.
        blocks: Free material of each box, from the low to the high end.
        ends: Attachments of the row's ends, by side: `low` or `high`.
    """

    axis: int
    blocks: tuple[Block, ...]
    ends: Mapping[str, RigidAttachment]

    @classmethod
    def of(cls, bodies: Sequence[SoftBody], attachments: Mapping[str, Sequence[RigidAttachment]]) -> SoftRow:
        """Sort bodies into a row and cut off the material in the grips.

        Args:
            bodies: One body, or all bodies of a row in any order.
            attachments: Attachments to rigid bodies, by name of the soft body.
        """
        boxes = [_box(body) for body in bodies]
        grips = [(box, attachment) for box in boxes for attachment in attachments.get(box.body.name, ())]
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
        for box, attachment in grips:
            found, side = _world_axis(box, attachment)
            if found != axis or box is not (boxes[0] if side == "low" else boxes[-1]) or side in ends:
                raise UnsupportedSceneError(
                    f"soft body {box.body.name!r} is attached elsewhere than at a free end: attach each end once"
                )
            if attachment.motion is Motion.DYNAMIC:
                raise UnsupportedSceneError(
                    f"soft body {box.body.name!r} is attached to {attachment.body!r}, which moves under forces: attach "
                    "it to a fixed or kinematic body"
                )
            ends[side] = attachment
            # The corners belong to this box alone, so they can be changed in place.
            if side == "low":
                box.low_m[axis] += attachment.region.depth_m
            else:
                box.high_m[axis] -= attachment.region.depth_m
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
        """Yield each attachment and the indices of the points that lie on its face or beyond it.

        Args:
            points_m: Points in the world [m], shape [point_count, 3].
        """
        along = points_m[:, self.axis]
        for side, attachment in self.ends.items():
            if side == "low":
                yield attachment, np.flatnonzero(along < self.low_m[self.axis] + TOLERANCE_M)
            else:
                yield attachment, np.flatnonzero(along > self.high_m[self.axis] - TOLERANCE_M)

    def checked(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points [m], shape [point_count, 3], unchanged if all of them lie in the free material."""
        outside = np.maximum(self.low_m - points_m, points_m - self.high_m).max(axis=1)
        if not np.all(outside < TOLERANCE_M):
            worst = int(np.argmax(outside))
            raise ShapeError(f"point {worst} lies {1e3 * outside[worst]:.3g} mm outside the free soft material")
        return points_m


def _box(body: SoftBody) -> Block:
    rotation = body.pose.rotation.as_matrix()
    if not np.allclose(rotation, np.rint(rotation), atol=1e-6):
        raise UnsupportedSceneError(
            f"soft body {body.name!r} is not rotated by right angles: align its box with the world's axes"
        )
    half = 0.5 * np.abs(np.rint(rotation)) @ body.shape.size_m
    centre = np.asarray(body.pose.position_m)
    return Block(body=body, low_m=centre - half, high_m=centre + half)


def _world_axis(block: Block, attachment: RigidAttachment) -> tuple[int, str]:
    """Return the world axis and the side of an attached region, which is given in the body frame."""
    direction = block.body.pose.rotation.as_matrix()[:, "xyz".index(attachment.region.axis)]
    axis = int(np.argmax(np.abs(direction)))
    flipped = {"low": "high", "high": "low"}[attachment.region.side]
    return axis, attachment.region.side if direction[axis] > 0.0 else flipped


def _check_joined(first: Block, second: Block, axis: int) -> None:
    low, high = first.low_m.copy(), first.high_m.copy()
    high[axis] += second.high_m[axis] - second.low_m[axis]
    low[axis] = first.high_m[axis]
    if max(np.abs(second.low_m - low).max(), np.abs(second.high_m - high).max()) > TOLERANCE_M:
        names = f"{first.body.name!r} and {second.body.name!r}"
        raise UnsupportedSceneError(f"soft bodies {names} do not join face to face: make equal faces meet")
