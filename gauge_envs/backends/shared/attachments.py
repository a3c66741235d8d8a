"""Attachments of deformable bodies to rigid bodies and to each other, and the ends of ropes and rods."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gauge_envs.errors import ShapeError, UnsupportedSceneError
from gauge_envs.scene import (
    Cloth,
    Motion,
    Pose,
    Region,
    Rod,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.geometry import FloatArray, IntArray, length_of

LINE_AXIS = {Rope: "x", Rod: "z"}
"""Axis of its frame along which a line lies."""

BEYOND_M = 1e-5
"""Distance beyond an end of a line at which a point still belongs to it [m]."""


@dataclass(frozen=True, kw_only=True)
class RigidAttachment:
    """A region of a deformable body that moves with a rigid body.

    Attributes:
        region: The attached material, in the deformable body's frame.
        body: Name of the rigid body.
        motion: How the rigid body moves.
        pose: Start pose of the rigid body.
    """

    region: Region
    body: str
    motion: Motion
    pose: Pose


def rigid_attachments(scene: Scene, name: str) -> list[RigidAttachment]:
    """Return the attachments of a deformable body to rigid bodies, in scene order."""
    rigid = {body.name: body for body in scene.bodies}
    return [
        RigidAttachment(
            region=a.region, body=a.to, motion=rigid[a.to].motion, pose=rigid[a.to].pose
        )
        for a in scene.attachments
        if a.deformable == name and a.to in rigid
    ]


def bonded_soft_bodies(scene: Scene) -> list[list[SoftBody]]:
    """Return the soft bodies of a scene in groups; bodies that are attached to each other share a group."""
    groups = {
        body.name: [body] for body in scene.deformables if isinstance(body, SoftBody)
    }
    for attachment in scene.attachments:
        first, second = groups.get(attachment.deformable), groups.get(attachment.to)
        if first is not None and second is not None and first is not second:
            first.extend(second)
            groups |= {body.name: first for body in second}
    return list({id(group): group for group in groups.values()}.values())


def attachment_problems(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each attachment that no backend builds."""
    rigid = {body.name: body for body in scene.bodies}
    deformable = {body.name: body for body in scene.deformables}
    for attachment in scene.attachments:
        body = deformable.get(attachment.deformable)
        to = rigid.get(attachment.to)
        between = f"{attachment.deformable!r} is attached to {attachment.to!r}"
        if to is None:
            bonded = deformable.get(attachment.to)
            if not (isinstance(body, SoftBody) and isinstance(bonded, SoftBody)):
                yield f"{between}, which is not a rigid body"
        elif to.motion is Motion.DYNAMIC and isinstance(body, Cloth | SoftBody):
            yield f"{between}, which moves under forces"
        elif isinstance(body, Cloth) and attachment.region.axis == "z":
            yield f"{between} by its face, not by an edge"
    for line in scene.deformables:
        if isinstance(line, Rope | Rod):
            try:
                attached_ends(line, rigid_attachments(scene, line.name))
            except UnsupportedSceneError as error:
                yield str(error)


def points_on_axis(line: Rope | Rod, places_m: NDArray[np.floating]) -> FloatArray:
    """Return the world positions of points on a line at the start [m], shape [place_count, 3].

    Args:
        line: The rope or rod.
        places_m: Signed distances of the points from the middle of the line [m], shape [place_count].
    """
    points = np.zeros((len(places_m), 3))
    points[:, "xyz".index(LINE_AXIS[type(line)])] = places_m
    return line.pose.to_world(points)


def places_on_line(
    name: str, nodes_m: FloatArray, points_m: ArrayLike
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return where points of a rope or rod lie at the start.

    Args:
        name: Name of the line.
        nodes_m: Nodes along its axis at the start [m], shape [node_count, 3].
        points_m: The points [m], shape [point_count, 3].

    Returns:
        Segment of each point, shape [point_count]; its share between the two nodes, shape [point_count, 1]; and its
        distance from the axis [m], shape [point_count, 3].

    Raises:
        ShapeError: A point lies beyond an end.
    """
    span_m = nodes_m[-1] - nodes_m[0]
    axis = span_m / length_of(span_m)
    arms_m = points_m - nodes_m[0]
    along_m = arms_m @ axis
    places_m = (nodes_m - nodes_m[0]) @ axis
    if not np.all((along_m > -BEYOND_M) & (along_m < places_m[-1] + BEYOND_M)):
        raise ShapeError(
            f"a point lies beyond an end of {name!r}: track points within its length"
        )
    segments = np.searchsorted(places_m[1:-1], along_m, side="right")
    shares = (along_m - places_m[segments]) / np.diff(places_m)[segments]
    return segments, shares[:, None], arms_m - along_m[:, None] * axis


def attached_ends(
    line: Rope | Rod, attachments: Sequence[RigidAttachment]
) -> dict[str, RigidAttachment]:
    """Return the attachments of the ends of a line, by side: `low` or `high`."""
    ends: dict[str, RigidAttachment] = {}
    for attachment in attachments:
        if (
            attachment.region.axis != LINE_AXIS[type(line)]
            or attachment.region.side in ends
        ):
            raise UnsupportedSceneError(
                f"{line.name!r} is attached elsewhere than at its two ends: attach each end once"
            )
        ends[attachment.region.side] = attachment
    depth_m = sum(attachment.region.depth_m for attachment in ends.values())
    if isinstance(line, Rope) and depth_m > 0.0:
        raise UnsupportedSceneError(
            f"rope {line.name!r} is attached over a length: set the region's depth_m to 0"
        )
    if depth_m >= line.length_m:
        raise UnsupportedSceneError(
            f"{line.name!r} is attached over all of its length: reduce the regions' depth_m"
        )
    return ends
