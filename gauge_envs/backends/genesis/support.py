"""Features of a scene that the Genesis backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from gauge_envs.backends.genesis.document import unsupported_contacts
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.attachments import attachment_problems
from gauge_envs.backends.shared.bundled import first_of
from gauge_envs.backends.shared.soft_rows import soft_row_problems
from gauge_envs.scene import Cloth, Hinge, Motion, Rod, Rope, Scene, SoftBody


def unsupported_features(scene: Scene, settings: SettingsGenesis) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of a scene."""
    hinges = Counter(joint.body for joint in scene.joints if isinstance(joint, Hinge))
    for name, count in hinges.items():
        if count > 1:
            yield f"{name!r} hangs on {count} hinges: this backend builds one hinge per body"
            break
    for joint in scene.joints:
        if scene.body(joint.body).motion is not Motion.DYNAMIC:
            motion = scene.body(joint.body).motion.value
            yield f"{joint.body!r} hangs on a {type(joint).__name__} and is {motion}: only dynamic bodies have joints"
            break
    yield from unsupported_contacts(scene, settings)
    yield from unsupported_deformables(scene)


def unsupported_deformables(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of the deformable bodies of a scene."""
    lines = [body.name for body in scene.deformables if isinstance(body, Rope | Rod)]
    if lines:
        yield f"{first_of(lines)} is a line: Genesis has no solver of ropes and rods"
    yield from attachment_problems(scene, not_to_dynamic=Cloth | SoftBody)
    yield from _unsupported_cloth(scene)
    yield from _unsupported_solids(scene)


def _unsupported_cloth(scene: Scene) -> Iterator[str]:
    cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
    for attachment in scene.attachments:
        if attachment.deformable in cloths and attachment.region.axis == "z":
            yield f"cloth {attachment.deformable!r} is attached to {attachment.to!r} by its face, not by an edge"
            break
    dynamic = {body.name for body in scene.bodies if body.motion is Motion.DYNAMIC}
    loads = sorted(
        name
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
        for name, other in (pair, pair[::-1])
        if name in dynamic and other in cloths
    )
    if loads:
        yield (
            f"{first_of(loads)} is dynamic and touches cloth: Genesis moves particles out of a body and gives it only "
            "their momentum, so that cloth does not carry it"
        )


def _unsupported_solids(scene: Scene) -> Iterator[str]:
    solids = {body.name for body in scene.deformables if isinstance(body, SoftBody)}
    cloths = [body.name for body in scene.deformables if isinstance(body, Cloth)]
    if solids and cloths:
        yield f"{min(solids)!r} is beside cloth {cloths[0]!r}: this backend builds one of both kinds in a scene"
    yield from soft_row_problems(scene)
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            if {first, second} <= solids:
                yield f"{first!r} may touch {second!r}: Genesis's finite elements do not collide with each other"
                return
