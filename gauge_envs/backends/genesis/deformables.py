"""Deformable bodies of a scene: which are supported, their presets, and their parts of the Genesis scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gauge_envs.backends.genesis.foam_settings import SettingsFEM, SettingsMPM, soft_presets
from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.pbd_settings import SettingsPBD, pbd_presets
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.attachments import attachment_problems, attachments_by_body, bonded_soft_bodies
from gauge_envs.backends.shared.soft_rows import SoftRow
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, Motion, Rod, Rope, Scene, SoftBody


def deformable_presets(scene: Scene) -> Mapping[str, SettingsGenesis]:
    """Return the presets of a scene with deformable bodies, by name; one of them is `default`."""
    if any(isinstance(body, Cloth) for body in scene.deformables):
        return pbd_presets(scene)
    if any(isinstance(body, SoftBody) for body in scene.deformables):
        return soft_presets(scene)
    return {"default": SettingsGenesis(preset="default", timestep_s=1 / 1800)}


def unsupported_deformables(scene: Scene, settings: SettingsGenesis) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of the deformable bodies of a scene."""
    lines = [body.name for body in scene.deformables if isinstance(body, Rope | Rod)]
    if lines:
        yield f"{_first_of(lines)} is a line: Genesis has no solver of ropes and rods"
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
            f"{_first_of(loads)} is dynamic and touches cloth: Genesis moves particles out of a body and gives it only "
            "their momentum, so that cloth does not carry it"
        )


def _unsupported_solids(scene: Scene) -> Iterator[str]:
    solids = {body.name for body in scene.deformables if isinstance(body, SoftBody)}
    cloths = [body.name for body in scene.deformables if isinstance(body, Cloth)]
    if solids and cloths:
        yield f"{min(solids)!r} is beside cloth {cloths[0]!r}: this backend builds one of both kinds in a scene"
    for bodies in bonded_soft_bodies(scene):
        try:
            SoftRow.of(bodies, attachments_by_body(scene, bodies))
        except UnsupportedSceneError as error:
            yield str(error)
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            if {first, second} <= solids:
                yield f"{first!r} may touch {second!r}: Genesis's finite elements do not collide with each other"
                return


def deformable_parts(scene: Scene, settings: SettingsGenesis) -> list[DeformablePart]:
    """Return the parts of the deformable bodies of a scene; none for a rigid scene."""
    if isinstance(settings, SettingsPBD):
        from gauge_envs.backends.genesis.cloth import ClothPart

        return [ClothPart(scene, settings)]
    if isinstance(settings, SettingsFEM):
        from gauge_envs.backends.genesis.foam_fem import FEMPart

        return [FEMPart(scene, settings)]
    if isinstance(settings, SettingsMPM):
        from gauge_envs.backends.genesis.foam_mpm import MPMPart

        return [MPMPart(scene, settings)]
    return []


def _first_of(names: list[str]) -> str:
    more = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
    return f"{names[0]!r}{more}"
