"""Ropes and rods for Newton's VBD: chains of rigid segments.

Each segment is a body with the mass and inertia of its piece of the line. Newton's rod joints connect neighbouring
segments. The joints of a rod also resist bending with E I and twist with G J, both over the length of a segment. A
joint at a clamp represents half a segment and is twice as stiff. With n segments, the deflection by a load at the free
end then exceeds the theoretical value by 1 part in 2 n^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import pi

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from gauge_envs.backends.newton.parts import PartNewton, Reader
from gauge_envs.backends.newton.rigid import WORLD
from gauge_envs.backends.newton.settings import ROD_SEGMENTS, ROPE_CELL_M, SettingsLines
from gauge_envs.backends.newton.stepper import (
    Stepper,
    rotated,
    warp_transform,
)
from gauge_envs.backends.shared.attachments import (
    LINE_AXIS,
    RigidAttachment,
    attached_ends,
    places_on_line,
    points_on_axis,
)
from gauge_envs.scene import Cylinder, Pose, Rod, Rope
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.meshes import mass_properties

ROTATION_TO_AXIS = {
    "x": Rotation.from_rotvec([0.0, 0.5 * pi, 0.0]),
    "z": Rotation.identity(),
}
"""Rotation from z, the axis of Newton's capsules and rod joints, to the axis of a line."""

CLEAR_RADII = 2.5
"""Clearance along the line, in radii, below which segments never collide, since neighbours always touch."""


@dataclass(frozen=True, kw_only=True)
class _Anchor:
    """A point of a segment, or of the body that an end is attached to.

    Attributes:
        body: Index of the body; -1 for the world.
        place_m: Position of the point in the body's frame [m].
        start: Rotation of the body at the start.
    """

    body: int
    place_m: tuple[float, float, float]
    start: Rotation

    def frame(self, rotation: Rotation) -> wp.transform:
        """Return a frame at the point that has a rotation in the world at the start."""
        turned = (self.start.inv() * rotation).as_quat().tolist()
        return wp.transform(wp.vec3(*self.place_m), wp.quat(*turned))


@dataclass(frozen=True, kw_only=True, eq=False)
class LinePartNewton(PartNewton):
    """A rope or a rod among the bodies of a model.

    Attributes:
        name: Name of the line.
        rest_m: Positions of the nodes at the start, along the line's axis [m], shape [node_count, 3].
        anchors: Two points for each node, whose midpoint is the node: ends of neighbours, or one point twice.
        keeps_direction: Whether attached ends keep their direction, as those of a rod do.
        shapes: Capsules of the segments.
    """

    name: str
    rest_m: FloatArray
    anchors: tuple[tuple[_Anchor, _Anchor], ...]
    keeps_direction: bool
    shapes: tuple[int, ...]

    def nodes(self, stepper: Stepper) -> FloatArray:
        """Return the midpoints of the anchors."""
        return self._nodes(_poses(stepper))

    def track(self, points_m: FloatArray) -> Reader:
        """Return a reader of material points in or on the line, which move with their cross-section."""
        low, share, offsets = places_on_line(self.name, self.rest_m, points_m)

        def read(stepper: Stepper) -> FloatArray:
            poses = _poses(stepper)
            nodes, rotations = self._nodes(poses), self._rotations(poses)
            centres = (1.0 - share) * nodes[:, low] + share * nodes[:, low + 1]
            mean = (1.0 - share) * rotations[:, low] + share * rotations[:, low + 1]
            return centres + rotated(_unit(mean), offsets)

        return read

    def _nodes(self, poses: FloatArray) -> FloatArray:
        anchors = [anchor for pair in self.anchors for anchor in pair]
        at = poses[:, [anchor.body for anchor in anchors]]
        places_m = np.array([anchor.place_m for anchor in anchors])
        points = at[..., :3] + rotated(at[..., 3:], places_m)
        return points.reshape(len(poses), -1, 2, 3).mean(axis=2)

    def _rotations(self, poses: FloatArray) -> FloatArray:
        """Return the rotation of the line at each node since the start, x, y, z, w, shape [N, node_count, 4]."""
        anchors: list[_Anchor] = []
        for first, second in self.anchors:
            # The body that a rope's end is attached to rotates independently. The second anchor is a segment, except at
            # a tip.
            anchors += [first if self.keeps_direction else second, second]
        bodies = [anchor.body for anchor in anchors]
        current = Rotation.from_quat(poses[:, bodies, 3:].reshape(-1, 4))
        inverse = [anchor.start.inv() for anchor in anchors]
        since = current * Rotation.concatenate(inverse * len(poses))
        quaternions = since.as_quat().reshape(len(poses), -1, 4)
        # A quaternion and its negative are one rotation. The sign nearer to the previous node gives a meaningful mean.
        cosines = np.sum(quaternions[:, 1:] * quaternions[:, :-1], axis=2)
        signs = np.where(cosines < 0.0, -1.0, 1.0)
        quaternions[:, 1:] *= np.cumprod(signs, axis=1)[..., None]
        return _unit(quaternions.reshape(len(poses), -1, 2, 4).mean(axis=2))


def _unit(quaternions: FloatArray) -> FloatArray:
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)


def add_line(
    builder: newton.ModelBuilder,
    line: Rope | Rod,
    *,
    attachments: Sequence[RigidAttachment] = (),
    bodies: Mapping[str, int],
    settings: SettingsLines,
    load_n: float = 0.0,
    touches_itself: bool = False,
) -> LinePartNewton:
    """Add a rope or a rod to a model builder; it collides with every shape that is not excluded.

    The material in a grip is part of the gripping body, and its mass is omitted.

    Args:
        builder: Model builder that contains the rigid bodies.
        line: The line. A rope's Young's modulus is unused, because a rope is inextensible.
        attachments: Attachments of its ends. An attached rod keeps its direction; a rope only keeps its position.
        bodies: Model index of each rigid body, by name; -1 for fixed bodies.
        settings: Length of the segments, stiffness of the joints between them, and damping.
        load_n: Largest load of a rope [N].
        touches_itself: Whether segments collide with those that are not close along the line.
    """
    ends = attached_ends(line, attachments)
    depths_m = {side: end.region.depth_m for side, end in ends.items()}
    # The ends of the free length, as signed distances from the middle of the line.
    low_m = depths_m.get("low", 0.0) - 0.5 * line.length_m
    high_m = 0.5 * line.length_m - depths_m.get("high", 0.0)
    segments = _segment_count(line, high_m - low_m, settings)
    length_m = (high_m - low_m) / segments
    nodes_m = points_on_axis(line, low_m + length_m * np.arange(segments + 1))
    rotation = line.pose.rotation * ROTATION_TO_AXIS[LINE_AXIS[type(line)]]
    fixed = {
        0 if side == "low" else segments - 1
        for side, attachment in ends.items()
        if bodies[attachment.body] == WORLD
    }
    links = _add_segments(builder, line, nodes_m, rotation, length_m, fixed)
    shapes = _add_capsules(builder, line, links, length_m=length_m, ends=ends)
    for first, second in combinations(range(segments), 2):
        clearance_m = (second - first - 1) * length_m
        if not touches_itself or clearance_m < CLEAR_RADII * line.radius_m:
            builder.add_shape_collision_filter_pair(shapes[first], shapes[second])

    half = 0.5 * length_m
    low, high = (
        [_Anchor(body=b, place_m=(0.0, 0.0, z), start=rotation) for b in links]
        for z in (-half, half)
    )
    # The body of an attached end comes first in its pair, because Newton accepts the world only as parent.
    parents = [low[0], *high]
    for side, end in ends.items():
        node = 0 if side == "low" else -1
        parents[node] = _anchor_on(end, bodies, nodes_m[node])
    anchors = list(zip(parents, [*low, high[-1]], strict=True))
    stiffness = _stiffness(line, length_m, segments, settings, load_n)
    for index, (parent, child) in enumerate(anchors):
        if parent is not child:
            span_m = length_m if 0 < index < segments else half
            joint = builder.add_joint_rod(
                parent.body,
                child.body,
                parent_xform=parent.frame(rotation),
                child_xform=child.frame(rotation),
                rest_rotation=wp.quat_identity(),
                label=line.name,
                **{name: value / span_m for name, value in stiffness.items()},
            )
            if parent.body == WORLD:
                builder.add_articulation([joint], label=line.name)
    tips = {side: _gripped_tip(line, side, ends, bodies) for side in ("low", "high")}
    return LinePartNewton(
        name=line.name,
        rest_m=np.vstack([tips["low"][0], nodes_m, tips["high"][0]]),
        anchors=(*tips["low"][1], *anchors, *tips["high"][1]),
        keeps_direction=isinstance(line, Rod),
        shapes=shapes,
    )


def _segment_count(line: Rope | Rod, free_m: float, settings: SettingsLines) -> int:
    """Return the number of segments of the free length [m], outside the grips."""
    if isinstance(line, Rope):
        return max(2, round(line.length_m / (settings.cell_m or ROPE_CELL_M)))
    if settings.cell_m is None:
        return ROD_SEGMENTS
    return max(2, round(free_m / settings.cell_m))


def _stiffness(
    line: Rope | Rod,
    length_m: float,
    segments: int,
    settings: SettingsLines,
    load_n: float,
) -> dict[str, float]:
    """Return the stiffness and damping of the joints of a line, times their length: E A, E I and G J of a rod.

    A rope is inextensible and perfectly flexible. The largest stable stiffness of a joint limits E A.
    """
    bend = twist = damping_s = 0.0
    if isinstance(line, Rope):
        largest_n_per_m = load_n * segments / (settings.rope_strain * line.length_m)
        stretch = largest_n_per_m * length_m
    else:
        area, inertia = pi * line.radius_m**2, pi / 4.0 * line.radius_m**4
        largest_n = settings.rod_joint_stiffness_n_per_m * length_m
        stretch = min(line.young_modulus_pa * area, largest_n)
        bend = line.young_modulus_pa * inertia
        # J is twice I, and G is E / (2 + 2 nu).
        twist = line.young_modulus_pa * inertia / (1.0 + line.poisson_ratio)
        damping_s = settings.rod_damping_s
    return {
        "stretch_stiffness": stretch,
        "bend_stiffness": bend,
        "bend_damping": damping_s * bend,
        "twist_stiffness": twist,
        "twist_damping": damping_s * twist,
    }


def _gripped_tip(
    line: Rope | Rod,
    side: str,
    ends: Mapping[str, RigidAttachment],
    bodies: Mapping[str, int],
) -> tuple[FloatArray, list[tuple[_Anchor, _Anchor]]]:
    """Return the node at a gripped end of the line: its position [m], shape [0 or 1, 3], and its anchors.

    Both are empty if the end is not in a grip.
    """
    if side not in ends or ends[side].region.depth_m == 0.0:
        return np.zeros((0, 3)), []
    place_m = points_on_axis(
        line, np.array([-0.5 if side == "low" else 0.5]) * line.length_m
    )
    tip = _anchor_on(ends[side], bodies, place_m[0])
    return place_m, [(tip, tip)]


def _poses(stepper: Stepper) -> FloatArray:
    """Return the poses of all bodies, shape [N, body_count + 1, 7]; the last row, index -1, is the world."""
    poses = np.pad(stepper.poses(), ((0, 0), (0, 1), (0, 0)))
    poses[:, -1, 6] = 1.0
    return poses


def _anchor_on(
    attachment: RigidAttachment, bodies: Mapping[str, int], point_m: FloatArray
) -> _Anchor:
    """Return the point of the rigid body to which an end is attached."""
    index = bodies[attachment.body]
    if index == WORLD:
        return _Anchor(body=index, place_m=vector(point_m), start=Rotation.identity())
    return _Anchor(
        body=index,
        place_m=vector(attachment.pose.to_body(point_m)),
        start=attachment.pose.rotation,
    )


def _add_segments(
    builder: newton.ModelBuilder,
    line: Rope | Rod,
    nodes_m: FloatArray,
    rotation: Rotation,
    length_m: float,
    fixed: set[int],
) -> list[int]:
    """Add a body between each two nodes; those at a fixed end have a rod joint to the world."""
    mass = line.mass_kg * length_m / line.length_m
    _, inertia = mass_properties(
        Cylinder(radius_m=line.radius_m, length_m=length_m), mass
    )
    given = {
        "mass": mass,
        "inertia": wp.mat33(inertia),
        "lock_inertia": True,
        "label": line.name,
    }
    links = []
    for index, centre_m in enumerate(0.5 * (nodes_m[:-1] + nodes_m[1:])):
        # `add_body` also adds a free joint to the world, which excludes a rod joint to the world.
        add = builder.add_link if index in fixed else builder.add_body
        links.append(
            add(
                xform=warp_transform(Pose.from_rotation(vector(centre_m), rotation)),
                **given,
            )
        )
    return links


def _add_capsules(
    builder: newton.ModelBuilder,
    line: Rope | Rod,
    links: Sequence[int],
    *,
    length_m: float,
    ends: Mapping[str, RigidAttachment],
) -> tuple[int, ...]:
    """Add the capsules of the segments; the round end of a free end lies within the line."""
    shapes = []
    for index, link in enumerate(links):
        # Length that the round cap of a free end takes from the segment.
        low_m = line.radius_m if index == 0 and "low" not in ends else 0.0
        high_m = (
            line.radius_m if index == len(links) - 1 and "high" not in ends else 0.0
        )
        shape = builder.add_shape_capsule(
            link,
            xform=wp.transform(
                wp.vec3(0.0, 0.0, 0.5 * (low_m - high_m)), wp.quat_identity()
            ),
            radius=line.radius_m,
            half_height=max(0.5 * (length_m - low_m - high_m), 0.0),
            cfg=newton.ModelBuilder.ShapeConfig(density=0.0),
            label=line.name,
        )
        shapes.append(shape)
    return tuple(shapes)
