"""Parts of a MuJoCo model for the deformable bodies of a scene, with their attachments and contacts."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import mujoco

from gauge_envs.backends.mujoco.cloth import ClothPartMuJoCo, add_cloth
from gauge_envs.backends.mujoco.contacts import (
    IMPEDANCE_SHAPE,
    contact_constants,
    given_constants,
)
from gauge_envs.backends.mujoco.flex import FlexPart
from gauge_envs.backends.mujoco.line import LinePartMuJoCo, add_rod, add_rope
from gauge_envs.backends.mujoco.settings import CLOTH_CELL_M, SettingsMuJoCo
from gauge_envs.backends.mujoco.soft import add_soft
from gauge_envs.backends.shared.attachments import (
    attachment_problems,
    bonded_soft_bodies,
    rigid_attachments,
)
from gauge_envs.backends.shared.soft_rows import soft_rows
from gauge_envs.scene import Cloth, Contact, Rope, Scene, SoftBody

Geoms = Mapping[str, Sequence[mujoco.MjsGeom]]
"""Geoms of each rigid body in the editable model, by name."""


def add_deformables(
    spec: mujoco.MjSpec, scene: Scene, settings: SettingsMuJoCo
) -> dict[str, FlexPart]:
    """Add all deformable bodies to an editable model that contains the rigid bodies.

    Returns:
        The part of each deformable body, by name; bonded soft bodies share a part.
    """
    parts: dict[str, FlexPart] = {}
    for body in scene.deformables:
        attachments = rigid_attachments(scene, body.name)
        if isinstance(body, Cloth):
            touches_itself = any(
                body.name in {*c.first} & {*c.second} for c in scene.contacts
            )
            parts[body.name] = add_cloth(
                spec,
                body,
                attachments=attachments,
                cell_m=settings.cell_m or CLOTH_CELL_M,
                bending_stiffness_n_m=body.bend_stiffness_n_m_per_rad,
                contact_radius_m=settings.cloth_fold_radius_m
                if touches_itself
                else None,
            )
        elif isinstance(body, Rope):
            parts[body.name] = add_rope(
                spec, body, attachments=attachments, cell_m=settings.cell_m
            )
        elif not isinstance(body, SoftBody):
            parts[body.name] = add_rod(
                spec, body, attachments=attachments, cell_m=settings.cell_m
            )
    for soft_row in soft_rows(scene):
        part = add_soft(
            spec,
            soft_row,
            grip_mass_kg=settings.kinematic_mass_kg,
            timestep_s=settings.timestep_s,
            cell_m=settings.cell_m,
        )
        parts |= dict.fromkeys(soft_row.names, part)
    return parts


def unsupported_features(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each feature of the scene's deformable bodies that this backend does not support."""
    yield from attachment_problems(scene)
    yield from _frictions_in_conflict(scene)


def add_flex_contact(
    scene: Scene,
    contact: Contact,
    parts: Mapping[str, FlexPart],
    geoms: Geoms,
    settings: SettingsMuJoCo,
    *,
    bit: int,
) -> None:
    """Let the deformable bodies of a contact collide through MuJoCo's broad phase.

    A flex, or the spheres of a rod, offer the contact's bit and carry its constants with priority over the rigid geoms.
    Rigid geoms only accept the bit, so rigid bodies that touch the same cloth do not collide with each other. A flex
    has one friction. If a contact has another friction, its rigid geoms carry the constants with priority over the
    flex. Each kind of body has its own solref and solimp, unless the settings define those of all contacts.
    """
    constants = contact_constants(contact, settings)
    _, sliding, torsional, rolling, _ = constants.friction
    rigid = [geom for name in _rigid_names(scene, contact) for geom in geoms[name]]
    for name in _deformable_names(scene, contact):
        part = parts[name]
        colliders = (
            part.geoms
            if isinstance(part, LinePartMuJoCo) and part.geoms
            else [part.flex]
        )
        for collider in colliders:
            collider.contype |= bit
        if isinstance(part, ClothPartMuJoCo):
            part.flex.solref = list(settings.cloth_solref)
            part.flex.solimp = _cloth_solimp(part, settings)
        for collider, (key, value) in product(
            colliders, given_constants(settings).items()
        ):
            setattr(collider, key, value)
        carries_friction = contact.friction == _flex_friction(scene, name)
        for carrier in colliders if carries_friction else rigid:
            carrier.condim = constants.condim
            carrier.friction = [sliding, torsional, rolling]
            carrier.priority = 1 if carries_friction else 2
            carrier.solref, carrier.solimp = (
                list(colliders[0].solref),
                list(colliders[0].solimp),
            )
        if name in contact.first and name in contact.second:
            part.flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_AUTO
            # MuJoCo silently skips self-contact unless the flex both offers and accepts the same bit.
            part.flex.conaffinity |= bit
    for geom in rigid:
        geom.conaffinity |= bit


def _cloth_solimp(part: ClothPartMuJoCo, settings: SettingsMuJoCo) -> list[float]:
    if settings.cloth_solimp is not None:
        return [*settings.cloth_solimp, *IMPEDANCE_SHAPE]
    assert settings.cloth_softness_m2_per_kg is not None, (
        "the settings validator checks this"
    )
    impedance = 1.0 / (
        1.0 + settings.cloth_softness_m2_per_kg * part.cloth.areal_density_kg_per_m2
    )
    # The width has no effect, because the impedance is constant in depth.
    return [impedance, impedance, 0.001, *IMPEDANCE_SHAPE]


def _deformable_names(scene: Scene, contact: Contact) -> set[str]:
    return {*contact.first, *contact.second} & {body.name for body in scene.deformables}


def _rigid_names(scene: Scene, contact: Contact) -> set[str]:
    """Return the rigid bodies that collide with the deformable bodies of a contact."""
    # A body does not collide with the body that it is attached to: they would touch all along the seam.
    seams = {
        a.to
        for a in scene.attachments
        if a.deformable in (*contact.first, *contact.second)
    }
    return {*contact.first, *contact.second} - _deformable_names(scene, contact) - seams


def _flex_friction(scene: Scene, name: str) -> float:
    """Return the friction of a deformable body's flex: that of its self-contact, or of its first contact."""
    groups = [{body.name for body in bodies} for bodies in bonded_soft_bodies(scene)]
    members = next((group for group in groups if name in group), {name})
    touching = [c for c in scene.contacts if members & {*c.first, *c.second}]
    return next(
        (c for c in touching if members & {*c.first} & {*c.second}), touching[0]
    ).friction


def _frictions_in_conflict(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each contact whose friction neither a flex nor a rigid geom can carry."""
    for contact in scene.contacts:
        soft = _deformable_names(scene, contact)
        if all(contact.friction == _flex_friction(scene, name) for name in soft):
            continue
        if len(soft) > 1:
            yield f"{sorted(soft)} touch each other and other bodies with different friction: make it equal"
        for name in sorted(_rigid_names(scene, contact)):
            touching = [
                c
                for c in scene.contacts
                if name in _rigid_names(scene, c) and _deformable_names(scene, c)
            ]
            if len({c.friction for c in touching}) > 1:
                yield f"{name!r} touches deformable bodies with several frictions, and so do these bodies: use one"
