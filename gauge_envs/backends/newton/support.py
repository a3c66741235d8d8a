"""What of a scene Newton cannot do. Needs no engine, so that a list of experiments is quick."""

from __future__ import annotations

from collections.abc import Iterator

from gauge_envs.backends.newton.contacts import undoable_contacts
from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp, SettingsVBD, settings_for
from gauge_envs.backends.newton.surface import undoable_surface_contacts
from gauge_envs.backends.shared.attachments import bonded_rows, rigid_attachments
from gauge_envs.backends.shared.lines import attached_ends
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, ContactMode, Hinge, Motion, Rod, Rope, Scene, Tether

__all__ = [
    "undoable",
]


def undoable(scene: Scene) -> Iterator[str]:
    """What of a scene Newton cannot do, a sentence each."""
    for joint in scene.joints:
        if isinstance(joint, Tether):
            yield f"{joint.body!r} hangs on a string: Newton's MuJoCo solver has no distance joints"
    if not scene.deformables:
        settings = settings_for(scene)
        if isinstance(settings, SettingsMuJoCoWarp):
            yield from undoable_contacts(scene, settings)
        return
    settings = settings_for(scene)
    per_body = isinstance(settings, SettingsVBD) and not settings.full_surface
    yield from undoable_surface_contacts(scene, per_body=per_body)
    yield from _undoable_lines(scene)
    yield from _undoable_solids(scene)


def _undoable_lines(scene: Scene) -> Iterator[str]:
    lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
    others = [body.name for body in scene.deformables if not isinstance(body, Rope | Rod)]
    names = {line.name for line in lines}
    if lines and others:
        yield f"{lines[0].name!r} is beside {others[0]!r}: this backend builds ropes and rods among rigid bodies alone"
    for attachment in scene.attachments:
        if {attachment.deformable, attachment.to} & names and attachment.to not in {body.name for body in scene.bodies}:
            yield f"{attachment.deformable!r} is glued to {attachment.to!r}, which is no rigid body"
    for contact in scene.contacts:
        touching = names & {*contact.first, *contact.second}
        if touching and contact.restitution > 0.0 and contact.mode is ContactMode.IMPACT:
            yield f"{min(touching)!r} rebounds: Newton's vertex block descent has no restitution"
    for line in lines:
        try:
            attached_ends(line, rigid_attachments(scene, line.name))
        except UnsupportedSceneError as error:
            yield str(error)


def _undoable_solids(scene: Scene) -> Iterator[str]:
    """What vertex block descent lacks for rigid bodies beside cloth and foam, and glue that it cannot do."""
    rigid = {body.name: body for body in scene.bodies}
    soft = {body.name: body for body in scene.deformables}
    for joint in scene.joints:
        if isinstance(joint, Hinge):
            yield f"{joint.body!r} turns on a hinge beside deformable bodies, which this backend does not build yet"
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            if contact.restitution > 0.0 and contact.mode == "impact" and not {first, second} & set(soft):
                yield f"{first!r} rebounds from {second!r}: Newton's vertex block descent has no restitution"
    for attachment in scene.attachments:
        glued, to = soft.get(attachment.deformable), rigid.get(attachment.to)
        if glued is None or (to is None and attachment.to not in soft):
            yield f"{attachment.deformable!r} is glued to {attachment.to!r}, and one of them is not in the scene"
        elif to is not None and to.motion is Motion.DYNAMIC and isinstance(glued, Cloth):
            yield f"{glued.name!r} is glued to {to.name!r}, which moves under forces"
        elif attachment.region.axis == "z" and isinstance(glued, Cloth):
            yield f"cloth {glued.name!r} is glued to {attachment.to!r} by its face, not by an edge"
    for row in bonded_rows(scene):
        try:
            SoftRow.of(row, {body.name: rigid_attachments(scene, body.name) for body in row})
        except UnsupportedSceneError as error:
            yield str(error)
