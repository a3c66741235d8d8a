"""What deformable bodies are glued to, whatever the engine."""

from __future__ import annotations

from dataclasses import dataclass

from gauge_envs.scene import Motion, Pose, Region, Scene, SoftBody

__all__ = [
    "RigidAttachment",
    "bonded_rows",
    "rigid_attachments",
]


@dataclass(frozen=True, kw_only=True)
class RigidAttachment:
    """A region of a deformable body that is part of a rigid one.

    Attributes:
        region: Which material, in the deformable body's frame.
        body: Name of the rigid body.
        motion: How the rigid body moves.
        pose: Start pose of the rigid body.
    """

    region: Region
    body: str
    motion: Motion
    pose: Pose


def rigid_attachments(scene: Scene, name: str) -> list[RigidAttachment]:
    """What a deformable body of a scene is glued to among the rigid ones."""
    rigid = {body.name: body for body in scene.bodies}
    return [
        RigidAttachment(region=a.region, body=a.to, motion=rigid[a.to].motion, pose=rigid[a.to].pose)
        for a in scene.attachments
        if a.deformable == name and a.to in rigid
    ]


def bonded_rows(scene: Scene) -> list[list[SoftBody]]:
    """Soft bodies of a scene, those that are glued to each other together."""
    rows = {body.name: [body] for body in scene.deformables if isinstance(body, SoftBody)}
    for attachment in scene.attachments:
        first, second = rows.get(attachment.deformable), rows.get(attachment.to)
        if first is not None and second is not None and first is not second:
            first.extend(second)
            rows |= {body.name: first for body in second}
    return list({id(row): row for row in rows.values()}.values())
