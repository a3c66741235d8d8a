"""Ropes in PyBullet: chains of rigid segments on spherical joints, by Featherstone's algorithm.

The joints hold exactly, so that a rope cannot stretch. A dynamic body to which an end is attached is part of the chain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.settings import SEGMENT_LIMIT
from gauge_envs.backends.shared.attachments import points_on_axis
from gauge_envs.errors import ShapeError
from gauge_envs.scene import Cylinder, Rope
from gauge_envs.scene.meshes import mass_properties

SEGMENT_M = 0.0125
"""Default length of a segment [m]."""

Read = Callable[[int, int], tuple[Any, ...]]
"""Function of a body and a link that returns their position [units] and quaternion x y z w first."""


@dataclass(frozen=True)
class RopePart:
    """The segments of a rope in PyBullet.

    Attributes:
        name: Name of the rope.
        body: PyBullet's number of the chain.
        links: Links of the segments, from the low to the high end; -1 is the base.
        half: Half the length of a segment [units], from its centre to its high end along z. It is negative if z points
            to the low end.
        rest_m: Nodes at the start, from the low to the high end [m], shape [segment_count + 1, 3].
    """

    name: str
    body: int
    links: tuple[int, ...]
    half: float
    rest_m: NDArray[np.float64]

    def nodes_m(self, read: Read, scale: float) -> NDArray[np.float64]:
        """Return the nodes, the ends of the segments [m], shape [segment_count + 1, 3]."""
        centres, rotations = self._segments(read)
        arms = rotations.apply([0.0, 0.0, self.half])
        return np.concatenate([centres[:1] - arms[:1], centres + arms]) / scale

    def track(self, points_m: NDArray[np.float64], read: Read, scale: float) -> Callable[[], NDArray[np.float64]]:
        """Return a reader of material points, each of which moves with its segment."""
        span = self.rest_m[-1] - self.rest_m[0]
        length = float(np.linalg.norm(span))
        along = (points_m - self.rest_m[0]) @ span / length
        if not np.all((along > -1e-5) & (along < length + 1e-5)):
            raise ShapeError(f"a point lies beyond an end of {self.name!r}: track points within its length")
        count = len(self.links)
        segment = np.clip(np.floor(along / length * count).astype(int), 0, count - 1)
        centres_m = 0.5 * (self.rest_m[segment] + self.rest_m[segment + 1])
        start = self._segments(read)[1]
        offsets = start[segment].apply(points_m - centres_m, inverse=True)

        def points() -> NDArray[np.float64]:
            centres, rotations = self._segments(read)
            return np.asarray(centres[segment] / scale + rotations[segment].apply(offsets))

        return points

    def _segments(self, read: Read) -> tuple[NDArray[np.float64], Rotation]:
        """Return the centres [units], shape [segment_count, 3], and the rotations of the segments."""
        states = [read(self.body, link) for link in self.links]
        return np.array([state[0] for state in states]), Rotation.from_quat([state[1] for state in states])


@dataclass(frozen=True)
class Chain:
    """Segments of a rope from one end to the other, as PyBullet's links.

    Attributes:
        count: Number of segments.
        length: Length of a segment [units].
        rotation: Rotation of all segments at the start; z points from the first to the last one.
        start_m: End of the first segment at the start [m].
        end_m: End of the last segment at the start [m].
        mass_kg: Mass of a segment [kg].
        moments: Moments of inertia of a segment [kg units^2].
        from_low: Whether the first segment is that of the low end.
        rest_m: Nodes at the start, from the low to the high end [m], shape [count + 1, 3].
    """

    count: int
    length: float
    rotation: Rotation
    start_m: NDArray[np.float64]
    end_m: NDArray[np.float64]
    mass_kg: float
    moments: list[float]
    from_low: bool
    rest_m: NDArray[np.float64]

    def part(self, name: str, body: int, first_link: int) -> RopePart:
        """Return the rope, given the link of its first segment."""
        links = tuple(range(first_link, first_link + self.count))
        half = 0.5 * self.length
        return RopePart(
            name, body, links if self.from_low else links[::-1], half if self.from_low else -half, self.rest_m
        )


def chain_of(rope: Rope, *, cell_m: float | None, from_low: bool, scale: float) -> Chain:
    """Return the segments of a rope.

    A segment has the moments of inertia of its cylinder across the rope about all axes. The spin of a thin cylinder
    about its own axis has no effect on a limp rope, and its small inertia would only make the chain less stable.

    Args:
        rope: The rope.
        cell_m: Desired length of a segment [m], or None for the default.
        from_low: Whether the chain starts at the low end.
        scale: Units per metre.
    """
    count = max(2, min(SEGMENT_LIMIT, round(rope.length_m / (cell_m or SEGMENT_M))))
    length_m = rope.length_m / count
    nodes_m = points_on_axis(rope, np.linspace(-0.5, 0.5, count + 1) * rope.length_m)
    ends = (nodes_m[0], nodes_m[-1]) if from_low else (nodes_m[-1], nodes_m[0])
    direction = (ends[1] - ends[0]) / rope.length_m
    mass_kg = rope.mass_kg / count
    across = mass_properties(Cylinder(radius_m=rope.radius_m, length_m=length_m), mass_kg)[1][0, 0]
    return Chain(
        count=count,
        length=scale * length_m,
        rotation=Rotation.align_vectors([direction], [[0.0, 0.0, 1.0]])[0],
        start_m=ends[0],
        end_m=ends[1],
        mass_kg=mass_kg,
        moments=[scale**2 * float(across)] * 3,
        from_low=from_low,
        rest_m=nodes_m,
    )
