"""Ropes and soft bodies in PyBullet.

A rope is a chain of rigid segments on spherical joints, by Featherstone's algorithm. The joints hold exactly, so that a
rope cannot stretch. A dynamic body to which an end is attached is part of the chain, which is one multibody in reduced
coordinates. A soft body consists of linear tetrahedra with Bullet's Neo-Hookean energy, in its deformable world.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.settings import SEGMENT_LIMIT, SOFT_CELL_M
from gauge_envs.backends.pybullet.world import BulletWorld, Link, pybullet
from gauge_envs.backends.shared.attachments import (
    attached_ends,
    points_on_axis,
    rigid_attachments,
)
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.backends.shared.soft_rows import lame_constants
from gauge_envs.errors import ShapeError
from gauge_envs.scene import Cylinder, Motion, Region, RigidBody, Rope, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.meshes import mass_properties, nodes_in, tetrahedra

SEGMENT_M = 0.0125
"""Default length of a segment [m]."""

SOFT_MARGIN_M = 0.001
"""Distance at which soft bodies touch [m]: with 0.2 mm, a cube passes through the foam."""

GROUND = -1
"""Number of the body that holds anchors in the world."""

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
    rest_m: FloatArray

    def nodes_m(self, read: Read, scale: float) -> FloatArray:
        """Return the nodes, the ends of the segments [m], shape [segment_count + 1, 3]."""
        centres, rotations = self._segments(read)
        arms = rotations.apply([0.0, 0.0, self.half])
        return np.concatenate([centres[:1] - arms[:1], centres + arms]) / scale

    def track(
        self, points_m: FloatArray, read: Read, scale: float
    ) -> Callable[[], FloatArray]:
        """Return a reader of material points, each of which moves with its segment."""
        span = self.rest_m[-1] - self.rest_m[0]
        length = length_of(span)
        along = (points_m - self.rest_m[0]) @ span / length
        if not np.all((along > -1e-5) & (along < length + 1e-5)):
            raise ShapeError(
                f"a point lies beyond an end of {self.name!r}: track points within its length"
            )
        count = len(self.links)
        segment = np.clip(np.floor(along / length * count).astype(int), 0, count - 1)
        centres_m = 0.5 * (self.rest_m[segment] + self.rest_m[segment + 1])
        start = self._segments(read)[1]
        offsets = start[segment].apply(points_m - centres_m, inverse=True)

        def points() -> FloatArray:
            centres, rotations = self._segments(read)
            return np.asarray(
                centres[segment] / scale + rotations[segment].apply(offsets)
            )

        return points

    def _segments(self, read: Read) -> tuple[FloatArray, Rotation]:
        """Return the centres [units], shape [segment_count, 3], and the rotations of the segments."""
        states = [read(self.body, link) for link in self.links]
        return np.array([state[0] for state in states]), Rotation.from_quat(
            [state[1] for state in states]
        )


@dataclass(frozen=True)
class RopeEnds:
    """Bodies on the ends of a rope.

    Attributes:
        from_low: Whether the chain starts at the low end.
        root: Body with which the chain starts, or None if its first segment is free.
        tip: Dynamic body with which the chain ends, or None.
    """

    from_low: bool
    root: RigidBody | None
    tip: RigidBody | None


def rope_ends(scene: Scene, rope: Rope) -> RopeEnds:
    """Return the bodies on the ends of a rope; the chain starts at a fixed body if there is one."""
    bodies = {
        side: scene.body(attachment.body)
        for side, attachment in attached_ends(
            rope, rigid_attachments(scene, rope.name)
        ).items()
    }
    low, high = bodies.get("low"), bodies.get("high")
    if low is None or (high is not None and high.motion is Motion.FIXED):
        return RopeEnds(from_low=high is None, root=high, tip=low)
    return RopeEnds(from_low=True, root=low, tip=high)


def add_rope(world: BulletWorld, rope: Rope, *, cell_m: float | None) -> RopePart:
    """Add a rope and the dynamic bodies on its ends, and enter these bodies in `world.handles`.

    A segment has the moments of inertia of its cylinder across the rope about all axes. The spin of a thin cylinder
    about its own axis has no effect on a limp rope, and its small inertia would only make the chain less stable.

    Args:
        world: The world.
        rope: The rope.
        cell_m: Desired length of a segment [m], or None for the default.
    """
    ends = rope_ends(world.scene, rope)
    count = max(2, min(SEGMENT_LIMIT, round(rope.length_m / (cell_m or SEGMENT_M))))
    length_m = rope.length_m / count
    mass_kg = rope.mass_kg / count
    nodes_m = points_on_axis(rope, np.linspace(-0.5, 0.5, count + 1) * rope.length_m)
    start_m, end_m = (
        (nodes_m[0], nodes_m[-1]) if ends.from_low else (nodes_m[-1], nodes_m[0])
    )
    # All segments have the same rotation at the start; z points from the first to the last one.
    rotation = Rotation.align_vectors(
        [(end_m - start_m) / rope.length_m], [[0.0, 0.0, 1.0]]
    )[0]
    across_kg_m2 = float(
        mass_properties(Cylinder(radius_m=rope.radius_m, length_m=length_m), mass_kg)[
            1
        ][0, 0]
    )
    moments = [world.scale**2 * across_kg_m2] * 3
    # In units along z of a segment whose joint is at its start.
    length = np.array([0.0, 0.0, world.scale * length_m])
    centre = 0.5 * length

    if ends.root is not None:
        base, base_moments, place = _root_of_rope(world, ends.root, start_m, rotation)
        segments = range(count)
    else:
        # The first segment is the base, link -1.
        base = _massless_base(
            world, start_m + 0.5 / count * (end_m - start_m), rotation
        ) | {"baseMass": mass_kg}
        base_moments = moments
        place = centre, Rotation.identity()
        segments = range(-1, count - 1)
    links = []
    for _ in range(segments.stop):
        links.append(
            Link(
                joint=pybullet.JOINT_SPHERICAL,
                place=place,
                mass_kg=mass_kg,
                moments=moments,
                centre=centre,
            )
        )
        place = length, Rotation.identity()
    if ends.tip is not None:
        links.append(_tip_of_rope(world, ends.tip, place[0], rotation, end_m))
    body = world.add_multibody(base, base_moments, links)

    if ends.root is not None and ends.root.motion is Motion.DYNAMIC:
        world.add_handle(ends.root, body, -1)
    if ends.tip is not None:
        world.add_handle(ends.tip, body, len(links) - 1)
    from_low = tuple(segments) if ends.from_low else tuple(reversed(segments))
    half = float(centre[2]) if ends.from_low else -float(centre[2])
    return RopePart(rope.name, body, from_low, half, nodes_m)


def _root_of_rope(
    world: BulletWorld,
    root: RigidBody,
    start_m: FloatArray,
    rotation: Rotation,
) -> tuple[dict[str, Any], list[float], tuple[FloatArray, Rotation]]:
    """Return the base on which a rope hangs: its arguments, its moments of inertia, and the rope's start in its frame.

    A body that does not move under forces is a base without mass at the start of the rope.
    """
    if root.motion is not Motion.DYNAMIC:
        return (
            _massless_base(world, start_m, rotation),
            [],
            (np.zeros(3), Rotation.identity()),
        )
    frame = world.frame(root)
    to_base = (root.pose.rotation * frame.axes).inv()
    arm_m = to_base.apply(start_m - root.pose.to_world(frame.centre_m))
    return (
        world.base_arguments(root, frame),
        frame.moments,
        (world.scale * arm_m, to_base * rotation),
    )


def _tip_of_rope(
    world: BulletWorld,
    tip: RigidBody,
    place: FloatArray,
    rotation: Rotation,
    end_m: FloatArray,
) -> Link:
    """Return the body at the end of a rope as a link.

    Args:
        world: The world.
        tip: The body.
        place: End of the last segment in its frame [units], where the joint is.
        rotation: Rotation of the segments.
        end_m: End of the rope in the world [m].
    """
    frame = world.frame(tip)
    turn = tip.pose.rotation * frame.axes
    centre_m = turn.inv().apply(tip.pose.to_world(frame.centre_m) - end_m)
    origin_m = turn.inv().apply(np.subtract(tip.pose.position_m, end_m))
    return Link(
        joint=pybullet.JOINT_SPHERICAL,
        place=(place, rotation.inv() * turn),
        mass_kg=tip.mass_kg,
        moments=frame.moments,
        centre=world.scale * centre_m,
        shape=world.shape(tip.shape, origin_m, frame),
    )


def _massless_base(
    world: BulletWorld, place_m: FloatArray, rotation: Rotation
) -> dict[str, Any]:
    """Return the arguments of a base without mass and shape."""
    position = (world.scale * place_m).tolist()
    return {
        "baseMass": 0.0,
        "basePosition": position,
        "baseOrientation": rotation.as_quat().tolist(),
    }


# --- soft bodies ------------------------------------------------------------------------------------------------------


def add_soft_body(
    world: BulletWorld,
    body: SoftBody,
    file: Path,
    *,
    cell_m: float | None,
    friction: float | None,
) -> int:
    """Add a soft body, attach its regions, and return PyBullet's number; rigid bodies exist already.

    Bullet's energy is the stable Neo-Hookean one, which equals linear elasticity at small strain for mu' = 4/3 mu and
    lambda' = lambda + 5/6 mu.

    Args:
        world: The world.
        body: The soft body.
        file: File to write its mesh to, the only form in which PyBullet takes tetrahedra.
        cell_m: Desired edge of the cells [m], or None for the default.
        friction: Coefficient of its surface, by which Bullet multiplies that of a rigid body; None without contacts.
    """
    attachments = rigid_attachments(world.scene, body.name)
    nodes_m = _write_mesh(
        file,
        body,
        [one.region for one in attachments],
        cell_m or SOFT_CELL_M,
        world.scale,
    )
    shear, lame = lame_constants(body)
    contact: dict[str, float] = {}
    if friction is not None:
        contact = {
            "useFaceContact": 1,
            "frictionCoeff": friction,
            "collisionMargin": world.scale * SOFT_MARGIN_M,
        }
    number = world.call(
        "loadSoftBody",
        str(file),
        simFileName=str(file),
        basePosition=(world.scale * np.asarray(body.pose.position_m)).tolist(),
        baseOrientation=body.pose.rotation.as_quat().tolist(),
        mass=body.mass_kg,
        useNeoHookean=1,
        # A pressure is a force over an area: its number falls with the unit of length.
        NeoHookeanMu=4.0 / 3.0 * shear / world.scale,
        NeoHookeanLambda=(lame + 5.0 / 6.0 * shear) / world.scale,
        NeoHookeanDamping=0.0,
        useSelfCollision=0,
        **contact,
    )
    for attachment in attachments:
        # An anchor keeps the node where it now is in the frame of the body.
        holder = (
            GROUND
            if attachment.motion is Motion.FIXED
            else world.handles[attachment.body].body
        )
        for node in nodes_in(nodes_m, attachment.region).tolist():
            world.call("createSoftBodyAnchor", number, node, holder, -1)
    return int(number)


def _places_m(
    edge_m: float, axis: str, regions: Sequence[Region], cell_m: float
) -> FloatArray:
    """Return the places of nodes along an edge [m], with a layer of cells for each attached region of some depth."""
    depth = {region.side: region.depth_m for region in regions if region.axis == axis}
    low, high = (
        -0.5 * edge_m + depth.get("low", 0.0),
        0.5 * edge_m - depth.get("high", 0.0),
    )
    inner = np.linspace(low, high, max(1, round((high - low) / cell_m)) + 1)
    return np.unique(np.concatenate([[-0.5 * edge_m], inner, [0.5 * edge_m]]))


def _write_mesh(
    file: Path, body: SoftBody, regions: Sequence[Region], cell_m: float, scale: float
) -> FloatArray:
    """Write a VTK file with the tetrahedra of a soft body and return its nodes in the body frame [m]."""
    axes = [
        _places_m(edge, axis, regions, cell_m)
        for edge, axis in zip(body.shape.size_m, "xyz", strict=True)
    ]
    x, y, z = axes
    nodes_m = grid_points(x, y, z)
    cells = tetrahedra((len(x), len(y), len(z)))
    lines = [
        "# vtk DataFile Version 2.0",
        "soft body",
        "ASCII",
        "DATASET UNSTRUCTURED_GRID",
    ]
    lines.append(f"POINTS {len(nodes_m)} double")
    for point in (scale * nodes_m).tolist():
        lines.append(" ".join(map(repr, point)))
    lines.append(f"CELLS {len(cells)} {5 * len(cells)}")
    for corners in cells.tolist():
        lines.append(" ".join(map(str, (4, *corners))))
    lines.append(f"CELL_TYPES {len(cells)}")
    # 10 is VTK's number of a tetrahedron.
    lines += ["10"] * len(cells)
    file.write_text("\n".join(lines) + "\n")
    return nodes_m
