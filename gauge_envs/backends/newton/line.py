"""Ropes and rods for Newton's VBD: chains of rigid segments.

Each segment is a body with the mass and inertia of its piece of the line. Newton's rod joints connect neighbouring
segments. The joints of a rod also resist bending with E I and twist with G J, both over the length of a segment. A
joint at a clamp represents half a segment and is twice as stiff. With n segments, the deflection by a load at the free
end then exceeds that of theory by 1 part in 2 n^2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import pi

import newton
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.newton.pins import Pin
from gauge_envs.backends.newton.rigid import WORLD
from gauge_envs.backends.newton.stepper import warp_transform
from gauge_envs.backends.shared.attachments import LINE_AXIS, RigidAttachment, attached_ends, points_on_axis
from gauge_envs.errors import ShapeError
from gauge_envs.scene import Cylinder, Pose, Rod, Rope
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.meshes import mass_properties

ROTATION_TO_AXIS = {"x": Rotation.from_rotvec([0.0, 0.5 * pi, 0.0]), "z": Rotation.identity()}
"""Rotation from z, the axis of Newton's capsules and rod joints, to the axis of a line."""

CLEAR_RADII = 2.5
"""Clearance along the line, in radii, below which segments never collide, since they touch in every shape."""


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


@dataclass(frozen=True, kw_only=True)
class _CrossSection:
    """Stiffness of the cross-section of a line.

    Attributes:
        stretch_n: Force per strain, E A, limited by the largest stable joint stiffness [N].
        bend_n_m2: Moment per curvature, E I [N m^2].
        twist_n_m2: Torque per twist, G J [N m^2].
        damping_s: Time that multiplies the rates of curvature and twist [s].
    """

    stretch_n: float
    bend_n_m2: float
    twist_n_m2: float
    damping_s: float

    @classmethod
    def of(cls, line: Rope | Rod, *, largest_stretch_n: float, damping_s: float) -> _CrossSection:
        """Return the cross-section of a rod or a rope; a rope is inextensible and perfectly flexible."""
        if isinstance(line, Rope):
            return cls(stretch_n=largest_stretch_n, bend_n_m2=0.0, twist_n_m2=0.0, damping_s=0.0)
        area, inertia = pi * line.radius_m**2, pi / 4.0 * line.radius_m**4
        return cls(
            stretch_n=min(line.young_modulus_pa * area, largest_stretch_n),
            bend_n_m2=line.young_modulus_pa * inertia,
            # J is twice I, and G is E / (2 + 2 nu).
            twist_n_m2=line.young_modulus_pa * inertia / (1.0 + line.poisson_ratio),
            damping_s=damping_s,
        )


@dataclass(frozen=True, kw_only=True)
class LinePartNewton:
    """A rope or a rod among the bodies of a model.

    Attributes:
        name: Name of the line.
        rest_m: World positions of the nodes at the start, along the line's axis [m], shape [node_count, 3].
        anchors: Two points for each node, whose midpoint is the node: ends of neighbours, or one point twice.
        keeps_direction: Whether attached ends keep their direction, as those of a rod do.
        segments: Bodies of the segments, along the line's axis.
        shapes: Capsules of the segments.
        pins: Empty, since a line has no particles.
    """

    name: str
    rest_m: NDArray[np.float64]
    anchors: tuple[tuple[_Anchor, _Anchor], ...]
    keeps_direction: bool
    segments: tuple[int, ...]
    shapes: tuple[int, ...]
    pins: tuple[Pin, ...] = ()

    def nodes(self, state: newton.State) -> NDArray[np.float64]:
        """Return the world positions of the nodes in a state [m], shape [node_count, 3], in single precision."""
        return self._nodes(_poses(state))

    def track(self, points_m: ArrayLike) -> Callable[[newton.State], NDArray[np.float64]]:
        """Return a reader of material points in or on the line, which move with their cross-section.

        Args:
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function of a state that returns the positions of the points [m], shape [point_count, 3].
        """
        points = np.asarray(points_m, dtype=np.float64)
        span = self.rest_m[-1] - self.rest_m[0]
        axis = span / np.linalg.norm(span)
        places = (self.rest_m - self.rest_m[0]) @ axis
        along = (points - self.rest_m[0]) @ axis
        if not np.all((along > -1e-5) & (along < places[-1] + 1e-5)):
            raise ShapeError(f"a point lies beyond an end of {self.name!r}: track points within its length")
        low = np.clip(np.searchsorted(places, along) - 1, 0, len(places) - 2)
        share = ((along - places[low]) / (places[low + 1] - places[low]))[:, None]
        offsets = points - self.rest_m[0] - along[:, None] * axis

        def read(state: newton.State) -> NDArray[np.float64]:
            poses = _poses(state)
            nodes, rotations = self._nodes(poses), self._rotations(poses)
            centres = (1.0 - share) * nodes[low] + share * nodes[low + 1]
            rotation = (1.0 - share) * rotations[low] + share * rotations[low + 1]
            return np.asarray(centres + Rotation.from_quat(rotation).apply(offsets))

        return read

    def _nodes(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        bodies = np.array([[anchor.body for anchor in pair] for pair in self.anchors]).ravel()
        places = np.array([[anchor.place_m for anchor in pair] for pair in self.anchors]).reshape(-1, 3)
        ends = poses[bodies, :3] + Rotation.from_quat(poses[bodies, 3:]).apply(places)
        return np.asarray(ends.reshape(-1, 2, 3).mean(axis=1))

    def _rotations(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rotation of the line at each node since the start, as unit quaternions, shape [node_count, 4]."""
        # The holder of a rope's end rotates independently. The second anchor of a pair is a segment, except at a tip.
        anchors = [anchor for pair in self.anchors for anchor in (pair if self.keeps_direction else (pair[1], pair[1]))]
        now = Rotation.from_quat(poses[[anchor.body for anchor in anchors], 3:])
        rotations = (now * Rotation.concatenate([anchor.start for anchor in anchors]).inv()).as_quat()
        # A quaternion and its negative are one rotation. The nearer one of both along the line has a meaningful mean.
        signs = np.where(np.sum(rotations[1:] * rotations[:-1], axis=1) < 0.0, -1.0, 1.0)
        rotations[1:] *= np.cumprod(signs)[:, None]
        means = rotations.reshape(-1, 2, 4).mean(axis=1)
        return np.asarray(means / np.linalg.norm(means, axis=1, keepdims=True))


def add_line(
    builder: newton.ModelBuilder,
    line: Rope | Rod,
    *,
    attachments: Sequence[RigidAttachment] = (),
    bodies: Mapping[str, int],
    segments: int,
    joint_stiffness_n_per_m: float,
    damping_s: float = 0.0,
    touches_itself: bool = False,
) -> LinePartNewton:
    """Add a rope or a rod to a model builder; it collides with every shape that is not excluded.

    The material in a grip is part of the body that holds it, and its mass is omitted.

    Args:
        builder: Model builder that contains the rigid bodies.
        line: The line. A rope's Young's modulus is unused, because a rope is inextensible.
        attachments: Attachments of its ends. An attached rod keeps its direction; a rope only keeps its position.
        bodies: Model index of each rigid body, by name; -1 for fixed bodies.
        segments: Number of segments outside the grips.
        joint_stiffness_n_per_m: Largest stiffness of the joints between segments [N/m]; a softer rod has E A over the
            length of a segment.
        damping_s: Viscosity of a rod in bending and twist, as the time that multiplies the rate of curvature [s].
        touches_itself: Whether segments collide with those that are not close along the line.
    """
    ends = attached_ends(line, attachments)
    low_m, high_m = _free_places_m(line, ends)
    length_m = (high_m - low_m) / segments
    nodes_m = points_on_axis(line, low_m + length_m * np.arange(segments + 1))
    rotation = line.pose.rotation * ROTATION_TO_AXIS[LINE_AXIS[type(line)]]
    fixed = {
        0 if side == "low" else segments - 1 for side, attachment in ends.items() if bodies[attachment.body] == WORLD
    }
    links = [
        _add_segment(builder, line, 0.5 * (nodes_m[i] + nodes_m[i + 1]), rotation, length_m, on_world=i in fixed)
        for i in range(segments)
    ]
    shapes = _add_capsules(builder, line, links, length_m=length_m, ends=ends)
    _keep_near_apart(builder, shapes, length_m, clear_m=CLEAR_RADII * line.radius_m, all_of_it=not touches_itself)

    half = 0.5 * length_m
    low = [_Anchor(body=link, place_m=(0.0, 0.0, -half), start=rotation) for link in links]
    high = [_Anchor(body=link, place_m=(0.0, 0.0, half), start=rotation) for link in links]
    first = _held(ends["low"], bodies, nodes_m[0]) if "low" in ends else low[0]
    last = _held(ends["high"], bodies, nodes_m[-1]) if "high" in ends else high[-1]
    # The holder of an end comes first in its pair, because Newton accepts the world only as parent.
    anchors = list(zip([first, *high[:-1], last], [*low, high[-1]], strict=True))
    section = _CrossSection.of(line, largest_stretch_n=joint_stiffness_n_per_m * length_m, damping_s=damping_s)
    for index, (parent, child) in enumerate(anchors):
        if parent is not child:
            span_m = length_m if 0 < index < segments else half
            _add_joint(builder, parent, child, rotation, section, span_m=span_m, label=line.name)
    tips = {side: _gripped_tip(line, side, ends, bodies) for side in ("low", "high")}
    return LinePartNewton(
        name=line.name,
        rest_m=np.vstack([tips["low"][0], nodes_m, tips["high"][0]]),
        anchors=(*tips["low"][1], *anchors, *tips["high"][1]),
        keeps_direction=isinstance(line, Rod),
        segments=tuple(links),
        shapes=shapes,
    )


def _free_places_m(line: Rope | Rod, ends: Mapping[str, RigidAttachment]) -> tuple[float, float]:
    """Return the ends of the free length, as signed distances from the middle of the line [m]."""
    low, high = (ends[side].region.depth_m if side in ends else 0.0 for side in ("low", "high"))
    return low - 0.5 * line.length_m, 0.5 * line.length_m - high


def _gripped_tip(
    line: Rope | Rod, side: str, ends: Mapping[str, RigidAttachment], bodies: Mapping[str, int]
) -> tuple[NDArray[np.float64], list[tuple[_Anchor, _Anchor]]]:
    """Return the node at a gripped end of the line: its position [m], shape [0 or 1, 3], and its anchors.

    Both are empty if the end is not in a grip.
    """
    if side not in ends or ends[side].region.depth_m == 0.0:
        return np.zeros((0, 3)), []
    place_m = points_on_axis(line, np.array([-0.5 if side == "low" else 0.5]) * line.length_m)
    tip = _held(ends[side], bodies, place_m[0])
    return place_m, [(tip, tip)]


def _poses(state: newton.State) -> NDArray[np.float64]:
    """Return the poses of all bodies, shape [body_count + 1, 7]; the last row, index -1, is the world."""
    return np.vstack([state.body_q.numpy().astype(np.float64), [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]])


def _held(attachment: RigidAttachment, bodies: Mapping[str, int], point_m: NDArray[np.float64]) -> _Anchor:
    """Return the point of the rigid body that holds an end."""
    index = bodies[attachment.body]
    if index == WORLD:
        return _Anchor(body=index, place_m=vector(point_m), start=Rotation.identity())
    return _Anchor(body=index, place_m=vector(attachment.pose.to_body(point_m)), start=attachment.pose.rotation)


def _add_segment(
    builder: newton.ModelBuilder,
    line: Rope | Rod,
    centre_m: NDArray[np.float64],
    rotation: Rotation,
    length_m: float,
    *,
    on_world: bool,
) -> int:
    mass = line.mass_kg * length_m / line.length_m
    _, inertia = mass_properties(Cylinder(radius_m=line.radius_m, length_m=length_m), mass)

    # `add_body` also adds a free joint to the world, which a segment with a rod joint to the world must not have.
    add = builder.add_link if on_world else builder.add_body
    return add(
        xform=warp_transform(Pose.from_rotation(vector(centre_m), rotation)),
        mass=mass,
        inertia=wp.mat33(inertia),
        lock_inertia=True,
        label=line.name,
    )


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
        low = line.radius_m if index == 0 and "low" not in ends else 0.0
        high = line.radius_m if index == len(links) - 1 and "high" not in ends else 0.0
        shapes.append(
            builder.add_shape_capsule(
                link,
                xform=wp.transform(wp.vec3(0.0, 0.0, 0.5 * (low - high)), wp.quat_identity()),
                radius=line.radius_m,
                half_height=max(0.5 * (length_m - low - high), 0.0),
                cfg=newton.ModelBuilder.ShapeConfig(density=0.0),
                label=line.name,
            )
        )
    return tuple(shapes)


def _keep_near_apart(
    builder: newton.ModelBuilder, shapes: Sequence[int], length_m: float, *, clear_m: float, all_of_it: bool
) -> None:
    for one, other in combinations(range(len(shapes)), 2):
        if all_of_it or (other - one - 1) * length_m < clear_m:
            builder.add_shape_collision_filter_pair(shapes[one], shapes[other])


def _add_joint(
    builder: newton.ModelBuilder,
    parent: _Anchor,
    child: _Anchor,
    rotation: Rotation,
    section: _CrossSection,
    *,
    span_m: float,
    label: str,
) -> None:
    """Join two anchors at the same position with the stiffness of a length of the line [m]."""
    frames = [
        wp.transform(wp.vec3(*anchor.place_m), wp.quat(*(anchor.start.inv() * rotation).as_quat().tolist()))
        for anchor in (parent, child)
    ]
    joint = builder.add_joint_rod(
        parent.body,
        child.body,
        parent_xform=frames[0],
        child_xform=frames[1],
        rest_rotation=wp.quat_identity(),
        stretch_stiffness=section.stretch_n / span_m,
        bend_stiffness=section.bend_n_m2 / span_m,
        bend_damping=section.damping_s * section.bend_n_m2 / span_m,
        twist_stiffness=section.twist_n_m2 / span_m,
        twist_damping=section.damping_s * section.twist_n_m2 / span_m,
        label=label,
    )
    if parent.body == WORLD:
        builder.add_articulation([joint], label=label)
